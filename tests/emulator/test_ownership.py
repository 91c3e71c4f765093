"""Emulated, external, silent: who sends, whose frames drive the car, and what happens when they stop."""

from __future__ import annotations

import numpy as np
import pytest
from can_bench import IDLE, MS, Bench

from hev_can_emu.runtime.setup import Setup


def bench_with(**nodes: str) -> Bench:
    """Return a 4-DOF car with some nodes external or silent."""
    return Bench(Setup(model="4dof", nodes=nodes))


def drop(data: bytearray, count: int) -> None:
    return None


def ids_of(bench: Bench, sender: str) -> set[int]:
    return {m.can_id for m in bench.database.messages if m.sender == sender}


@pytest.mark.parametrize("node", ["EMS", "MCU1", "MCU2", "TCU", "BMS", "ESC", "VEH", "EMU"])
@pytest.mark.parametrize("owner", ["external", "silent"])
def test_nobody_but_its_owner_sends_a_message(node: str, owner: str) -> None:
    bench = bench_with(**{node: owner})
    bench.run(300)
    sent = set(bench.frames["id"].tolist())
    others = {m.can_id for m in bench.database.messages if m.sender not in (node, "HCU")}
    assert sent == others
    assert not sent & ids_of(bench, node)


def test_an_external_motor_drives_the_car_and_its_emulation_is_passive() -> None:
    bench = bench_with(MCU2="external")
    bench.ask_and_run(500, EM2TorqueRequest=200.0)  # nobody obeys: the real unit has not spoken
    assert bench.emulator.truth("em2_torque") == 0.0
    assert bench["VehicleSpeed"] == 0.0
    bench.ask(EM2State="Torque", EM2Speed=0.0, EM2Torque=80.0, EM2LimitReason="None",
              EM2RequestStatus="OK", EM2ControlModeEcho="Torque")  # fmt: skip
    bench.run(3000)
    assert bench.emulator.truth("em2_torque") == pytest.approx(80.0)
    assert bench["VehicleSpeed"] > 6.0
    assert bench["BatteryCurrent"] < -1.0  # its power comes from the emulated battery
    assert bench["EM2Torque"] == 80.0
    bench.ask_and_run(100, EM2Torque=-30.0)
    assert bench["BatteryCurrent"] > 0.0


def test_an_external_motor_that_falls_silent_gives_no_torque() -> None:
    bench = bench_with(MCU2="external")
    bench.ask(EM2TorqueRequest=200.0, EM2Torque=80.0)
    bench.run(500)
    bench.tamper["MCU2_Status"] = drop
    last = bench.now_ms - 10
    bench.run(last + 30 - bench.now_ms + 1)
    assert bench.emulator.truth("em2_torque") == pytest.approx(80.0)
    bench.run(1)
    assert bench.emulator.truth("em2_torque") == 0.0
    assert [event.text for event in bench.events if event.kind == "lost"] == [
        "MCU2_Status: timed out"
    ]
    bench.tamper.clear()
    bench.run(50)
    assert bench.emulator.truth("em2_torque") == pytest.approx(80.0)


def test_an_external_motor_that_says_not_available_gives_no_torque() -> None:
    bench = bench_with(MCU2="external")
    bench.ask_and_run(300, EM2Torque=80.0, EM2TorqueRequest=200.0)
    bench.ask_and_run(20, EM2Torque=None)
    assert bench.emulator.truth("em2_torque") == 0.0


def test_a_damaged_frame_of_an_external_unit_is_not_obeyed() -> None:
    bench = bench_with(MCU2="external")
    bench.ask_and_run(300, EM2Torque=80.0)

    def damage(data: bytearray, count: int) -> bytearray:
        data[5] ^= 0xFF
        return data

    bench.tamper["MCU2_Status"] = damage
    bench.run(20)
    assert bench.emulator.truth("em2_torque") == pytest.approx(80.0)
    bench.run(100)
    assert bench.emulator.truth("em2_torque") == 0.0
    assert bench["RejectedFrames"] > 5
    assert bench["RequestsFailed"] == 0  # these are not requests


def test_an_external_engine_turns_em1_through_c1() -> None:
    bench = bench_with(EMS="external")
    bench.ask(EngineTorque=30.0, EngineRunRequest="Run", EngineTorqueRequest=100.0)
    bench.ask_and_run(600, ClutchTorqueCapacityRequest=200.0)
    assert bench.emulator.truth("engine_torque") == pytest.approx(30.0)
    assert bench["EM1Speed"] > 500.0
    assert bench["ClutchTorqueTransmitted"] > 2.0
    bench.tamper["EMS_Status"] = drop
    bench.run(100)
    assert -30.0 < bench.emulator.truth("engine_torque") < 0.0  # unfuelled: its drag is left
    speed = bench["EM1Speed"]
    bench.run(500)
    assert bench["EM1Speed"] < speed - 50.0


def test_an_external_gearbox_shifts_and_clutches() -> None:
    bench = bench_with(TCU="external")
    bench.ask(Gear="Neutral", SleevePosition=0.0, ClutchTorqueCapacity=0.0)
    bench.ask(GearRequest="G2", ShiftForceRequest=900.0, ClutchTorqueCapacityRequest=300.0)
    bench.run(400)
    assert bench.emulator.truth("gear") == 0.0  # the HCU's request is for the real unit
    assert bench.emulator.truth("clutch_capacity") == 0.0
    bench.ask_and_run(400, Gear="G1", SleevePosition=9.0, ClutchTorqueCapacity=120.0)
    assert bench.emulator.truth("gear") == 1.0
    assert bench.emulator.truth("clutch_capacity") == pytest.approx(120.0)
    for name in ("TCU_Clutch", "TCU_Synchronizer"):
        bench.tamper[name] = drop
    bench.run(400)
    assert bench.emulator.truth("clutch_capacity") == 0.0  # C1 opens
    assert bench.emulator.truth("gear") == 1.0  # the sleeve stays


def test_an_external_battery_sets_voltage_and_limits() -> None:
    bench = bench_with(BMS="external")
    bench.ask(BatteryVoltage=300.0, ContactorState="Closed", StateOfCharge=50.0,
              BatteryCurrent=0.0, ChargePowerLimit=20.0, DischargePowerLimit=5.0,
              BatteryTemperature=25.0)  # fmt: skip
    bench.ask_and_run(1500, EM2TorqueRequest=200.0)
    assert bench["EM2DCVoltage"] == pytest.approx(300.0, abs=0.5)
    assert bench["EM2DCPower"] <= 5.0 + 0.02
    assert bench.label("EM2LimitReason") == "BatteryPower"
    assert bench["EM2TorqueEcho"] == 200.0
    assert bench["EM2TorqueSetpoint"] < 200.0
    bench.tamper["BMS_Status"] = bench.tamper["BMS_Limits"] = drop
    bench.run(500)
    assert bench["EM2DCVoltage"] > 330.0  # the emulated battery's own again
    assert bench["EM2DCPower"] > 10.0


def test_external_brakes_hold_the_car_and_fall_back_to_the_pedal() -> None:
    bench = bench_with(ESC="external")
    bench.ask_and_run(300, BrakeTorqueRequest=2000.0)
    assert bench.emulator.truth("brake_torque") == 0.0  # the real unit has not braked
    bench.ask(BrakeTorque=1500.0)
    bench.ask_and_run(500, EM2TorqueRequest=100.0)
    assert bench.emulator.truth("brake_torque") == pytest.approx(1500.0)
    assert bench.emulator.truth("vehicle_speed") == 0.0
    bench.tamper["ESC_Brake"] = drop
    bench.run(300)
    assert bench.emulator.truth("brake_torque") == pytest.approx(0.0, abs=1.0)
    assert bench.emulator.truth("vehicle_speed") > 0.0


def test_an_external_driver_switches_the_ignition_and_stays_as_last_seen() -> None:
    bench = Bench(Setup(model="4dof", start="off", nodes={"VEH": "external"}))
    bench.run(300)
    assert set(bench.frames["id"].tolist()) == ids_of(bench, "EMU")
    bench.ask(IgnitionState="On", SelectorPosition="D", AcceleratorPedal=0.0, BrakePedal=20.0)
    bench.ask_and_run(600, RoadGrade=10.0, AmbientTemperature=5.0)
    assert bench.label("EM2State") == "Torque"
    assert bench.emulator.truth("grade") == pytest.approx(0.10)
    bench.tamper["VEH_Driver"] = bench.tamper["VEH_Road"] = drop
    bench.run(1000)
    assert bench.label("EM2State") == "Torque"  # the car does not die with the message
    assert bench.emulator.truth("grade") == pytest.approx(0.10)
    bench.tamper.clear()
    bench.ask_and_run(1000, IgnitionState=None, BrakePedal=None)
    assert bench.label("EM2State") == "Torque"


def test_what_we_send_and_somebody_else_too_is_told_once_and_never_obeyed() -> None:
    bench = bench_with()
    bench.ask(EM2Torque=200.0, EM2Speed=5000.0, IgnitionState="Off")
    bench.run(500)
    assert bench.emulator.truth("em2_torque") == 0.0
    assert bench["EM2Torque"] == 0.0
    assert bench["EM2Speed"] == 0.0
    assert bench.label("EM2State") == "Torque"
    conflicts = [event for event in bench.events if event.kind == "conflict"]
    told = [event.text.split()[0] for event in conflicts]
    assert sorted(told) == ["MCU2_Status", "VEH_Driver"]  # each once


def test_a_silent_unit_works_but_says_nothing() -> None:
    bench = bench_with(MCU2="silent")
    bench.ask_and_run(1000, EM2TorqueRequest=100.0)
    assert np.isnan(bench["EM2Torque"])
    assert bench["VehicleSpeed"] > 2.0


def test_frames_for_a_silent_node_drive_nothing() -> None:
    bench = bench_with(MCU2="silent")
    bench.ask_and_run(300, EM2Torque=150.0)
    assert bench.emulator.truth("em2_torque") == 0.0


def test_the_emulator_can_play_the_controller_itself() -> None:
    bench = Bench(Setup(model="4dof", nodes={"HCU": "emulated"}), sending={}).run(100)
    assert bench["RequestsFailed"] == 0
    emulator = bench.emulator
    for name, value in (
        ("EM2ControlMode", 1.0), ("EM2TorqueRequest", 60.0), ("ContactorRequest", 1.0),
    ):  # fmt: skip
        emulator.set_value(bench.database.signal(name).index, value)
    bench.run(500)
    assert bench["EM2Torque"] == pytest.approx(60.0, abs=0.1)
    emulator.send_message(bench.database.message("HCU_EM2Request").index, False)
    bench.run(400)
    assert bench.label("EM2RequestStatus") == "Timeout"
    assert bench["EM2Torque"] == 0.0
    assert ids_of(bench, "HCU") & set(bench.frames["id"].tolist())
    assert bench.database.message("HCU_EM2Request").can_id not in bench.frames["id"]


def test_a_driver_that_stops_sending_leaves_the_car_as_it_is() -> None:
    bench = bench_with().ask_and_run(300, EM2TorqueRequest=50.0)
    bench.emulator.send_message(bench.database.message("VEH_Driver").index, False)
    bench.run(1000)
    assert bench["EM2Torque"] == pytest.approx(50.0, abs=0.1)
    lost = [event.text for event in bench.events if event.kind == "lost"]
    assert lost == ["VEH_Driver: timed out"]


def test_both_units_external_need_no_request() -> None:
    bench = Bench(Setup(model="4dof", nodes={"MCU1": "external", "MCU2": "external"}), IDLE)
    bench.ask_and_run(400, EM1Torque=20.0, EM2Torque=20.0)
    assert bench.emulator.truth("em1_torque") == pytest.approx(20.0)
    assert bench.emulator.truth("em2_torque") == pytest.approx(20.0)
    assert bench.emulator.now_ns == 400 * MS
