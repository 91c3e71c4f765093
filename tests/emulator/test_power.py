"""Ignition, boot, precharge, afterrun: what is on the bus when, and what acts."""

from __future__ import annotations

import numpy as np
from can_bench import Bench

from hev_can_emu.runtime.setup import Setup

OFF = Setup(model="4dof", start="off")
READY = Setup(model="4dof")


def senders(bench: Bench, start_ms: float = 0, stop_ms: float = 1e9) -> set[str]:
    """Return the nodes whose frames were on the bus in a window."""
    found = set()
    for message in bench.database.messages:
        t, _ = bench.series(message.signals[0].name)
        if ((t >= start_ms - 1e-6) & (t < stop_ms - 1e-6)).any():
            found.add(message.sender)
    return found


def ignite(bench: Bench, state: str) -> None:
    """Turn the key of the played VEH."""
    signal = bench.database.signal("IgnitionState")
    raw = next(raw for raw, label in signal.labels.items() if label == state)
    bench.emulator.set_value(signal.index, float(raw))


UNITS = {"EMS", "MCU1", "MCU2", "TCU", "BMS", "ESC"}


def test_asleep_only_the_driver_and_the_emulator_send() -> None:
    bench = Bench(OFF)
    bench.ask_and_run(500, EM2TorqueRequest=100.0)
    assert senders(bench) == {"VEH", "EMU"}
    assert bench.label("IgnitionState") == "Off"
    assert bench["VehicleSpeed"] != bench["VehicleSpeed"]  # nobody tells
    assert bench.emulator.truth("em2_torque") == 0.0


def test_accessory_wakes_nobody() -> None:
    bench = Bench(OFF)
    ignite(bench, "Accessory")
    bench.run(300)
    assert senders(bench) == {"VEH", "EMU"}


def test_boot_tells_not_available_then_values_then_high_voltage() -> None:
    bench = Bench(OFF).run(100)
    ignite(bench, "On")
    bench.ask_and_run(1000, EM2TorqueRequest=100.0)
    assert senders(bench, 100) == UNITS | {"VEH", "EMU"}
    on = next(t for t, v in zip(*bench.series("IgnitionState"), strict=True) if v == 2)
    for name in ("EM2Speed", "EngineSpeed", "StateOfCharge", "WheelSpeedFL", "ClutchSlipSpeed"):
        t, values = bench.series(name)
        period = bench.database.message(bench.database.signal(name).message).cycle_time_ns / 1e6
        assert on < t[0] <= on + 1 + period
        booting = t < on + 101
        assert np.isnan(values[booting]).all()
        assert booting.sum() >= 100 / period - 1
        assert not np.isnan(values[~booting]).any()
    assert bench.labels("EM2State") == ["Init", "Standby", "Torque"]
    assert bench.labels("ContactorState")[-2:] == ["Precharge", "Closed"]
    precharge = bench.first("ContactorState", "Closed") - bench.first("ContactorState", "Precharge")
    assert 80 <= precharge <= 140
    t, voltage = bench.series("EM2DCVoltage", on + 101)
    rising = voltage[t < bench.first("ContactorState", "Closed")]
    assert len(rising) >= 4
    assert (np.diff(rising) > 0.0).all()
    # No torque before the contactors are closed, the requested one after.
    t, torque = bench.series("EM2Torque", on + 101)
    closed = bench.first("ContactorState", "Closed") - 20  # sent every 20 ms
    assert (torque[t < closed] == 0.0).all()
    assert torque[-1] > 99.0


def test_a_booting_unit_does_not_act() -> None:
    bench = Bench(OFF).run(100)
    ignite(bench, "On")
    bench.run(95)
    assert bench.emulator.truth("contactor_phase") == 0.0
    bench.run(20)
    assert bench.emulator.truth("contactor_phase") == 1.0


def test_ignition_off_ends_torque_then_opens_contactors_then_silence() -> None:
    bench = Bench(READY).ask_and_run(600, EM2TorqueRequest=150.0, ClutchTorqueCapacityRequest=100.0)
    off = bench.now_ms
    ignite(bench, "Off")
    bench.run(2000)
    t, torque = bench.series("EM2Torque", off)
    gone = t[np.argmax(torque == 0.0)]
    assert gone - off < 80
    assert bench.labels("ContactorState", off) == ["Closed", "Opening", "Open"]
    assert bench.first("ContactorState", "Open", off) > gone
    assert bench.labels("EM2State", off) == ["Torque", "Standby"]
    assert bench.labels("ClutchState", off)[-1] == "Open"
    t, voltage = bench.series("EM2DCVoltage", bench.first("ContactorState", "Open", off))
    assert voltage[-1] < 0.6 * voltage[0]  # the link empties
    assert senders(bench, off + 560) == {"VEH", "EMU"}
    t, _ = bench.series("EM2Torque", off)
    assert 500 <= t[-1] - off <= 545


def test_ignition_off_while_requests_go_on_keeps_everything_off() -> None:
    bench = Bench(READY).ask_and_run(300, EM2TorqueRequest=150.0)
    ignite(bench, "Off")
    bench.run(1000)
    assert bench.emulator.truth("em2_torque") == 0.0
    assert bench.emulator.truth("contactor_phase") == 0.0
    start = bench.now_ms
    ignite(bench, "On")
    bench.run(800)
    assert bench.labels("EM2State", start) == ["Init", "Standby", "Torque"]
    assert bench["EM2Torque"] > 149.0


def test_contactors_stay_open_after_a_restart_until_somebody_asks() -> None:
    bench = Bench(READY).run(300)

    def drop(data: bytearray, count: int) -> None:
        return None

    for name in bench.sending:
        bench.tamper[name] = drop
    bench.run(200)
    assert bench.label("ContactorState") == "Closed"  # a lost request changes nothing
    ignite(bench, "Off")
    bench.run(1000)
    ignite(bench, "On")
    bench.run(500)
    assert bench.label("ContactorState") == "Open"
    assert bench.label("HVRequestStatus") == "Timeout"
    bench.tamper.clear()
    bench.run(500)
    assert bench.label("ContactorState") == "Closed"


def test_a_short_look_at_off_needs_no_new_boot() -> None:
    bench = Bench(READY).run(200)
    ignite(bench, "Off")
    bench.run(200)
    start = bench.now_ms
    ignite(bench, "On")
    bench.run(600)
    assert "NotAvailable" not in bench.labels("EM2State", start)
    assert bench.label("ContactorState") == "Closed"


def test_the_sleeve_and_the_brake_pedal_work_without_ignition() -> None:
    setup = Setup(model="4dof", nodes={"VEH": "external"})
    bench = Bench(setup)
    bench.ask(SelectorPosition="P", AcceleratorPedal=0.0, BrakePedal=0.0, IgnitionState="On")
    bench.ask_and_run(300, GearRequest="G1", ShiftForceRequest=800.0)
    assert bench.label("Gear") == "G1"
    bench.ask_and_run(900, IgnitionState="Off", BrakePedal=50.0, GearRequest="Neutral")
    assert bench.emulator.truth("gear") == 1.0
    assert abs(bench.emulator.truth("brake_torque") - 3250.0) < 10.0


def test_a_ready_car_is_ready() -> None:
    bench = Bench(READY, sending={}).run(100)
    assert senders(bench) == UNITS | {"VEH", "EMU"}
    for message in bench.database.messages:
        if message.sender in UNITS:
            t, _ = bench.series(message.signals[0].name)
            assert t[0] < message.cycle_time_ns / 1e6 + 1
    assert bench.labels("ContactorState") == ["Closed"]
    assert bench.labels("EM2State") == ["Standby"]
    assert bench.label("IgnitionState") == "On"
