"""Tyre slip in a whole car: asked for by the vehicle file, every joule of it in the ledger."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.plant.structure import EM2, INERTIAS, LEFT, N_PORTS, ROAD
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

RADIUS, MS = 0.356033146, 1_000_000
SLIPPERY = """  tyre_slip:
    slip_stiffness: {value: 22, unit: "1", source: plausible}
    friction: {value: 0.3, unit: "1", source: plausible, note: "snow"}
    front_load: {value: 60, unit: "%", source: plausible}
"""


@pytest.fixture(scope="module")
def slippery(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    text = (repository / "vehicles" / "dai2024.yaml").read_text(encoding="utf-8")
    assert "tyre_slip" not in text  # off, unless a vehicle asks for it
    file = tmp_path_factory.mktemp("tyres") / "slippery.yaml"
    file.write_text(text + SLIPPERY, encoding="utf-8")
    return str(file)


class Driven:
    """A car whose HCU plays what it is told, watched at every millisecond."""

    def __init__(self, vehicle: str) -> None:
        self.emulator = Emulator(
            Setup(model="detailed", vehicle=vehicle, nodes={"HCU": "emulated"})
        )
        self.send(ContactorRequest=1.0, EM2ControlMode=1.0, EM2TorqueRequest=200.0)

    def send(self, **signals: float) -> None:
        for name, value in signals.items():
            self.emulator.set_value(self.emulator.database.signal(name).index, value)

    def advance(self, ticks: int, *watch: str) -> NDArray[np.float64]:
        trace = np.empty((ticks, len(watch)))
        for row in trace:
            self.emulator.advance(self.emulator.now_ns + MS)
            row[:] = [self.emulator.truth(name) for name in watch]
        return trace


def test_a_hard_launch_spins_the_front_wheels_and_a_hard_stop_locks_all(slippery: str) -> None:
    car = Driven(slippery)
    watched = ("body_speed", "wheel_left_speed", "wheel_rear_speed", "acceleration")
    body, front, rear, acceleration = car.advance(1300, *watched).T
    # mu times the front axle's load, less rolling resistance; no more, whatever the motor gives.
    inertia = car.emulator.constants.plant.bank.inertia
    mass, rear_mass = inertia[INERTIAS.index("Jv")] / RADIUS**2, inertia[-1] / RADIUS**2
    expected = 9.80665 * (0.3 * 0.6 - 0.009) * mass / (mass + rear_mass)
    assert RADIUS * (body[900] - body[500]) / 0.4 == pytest.approx(expected, rel=0.02)
    assert acceleration[500:900].mean() == pytest.approx(expected, rel=0.02)
    assert front[-1] > 4.0 * body[-1]
    assert rear[-1] == pytest.approx(body[-1], rel=0.01)
    launched = car.emulator.ledger()
    # Slip heat is torque at the limit times the way that ran off.
    slid = float((front - body).sum()) * 1e-3
    assert launched["tyres"] == pytest.approx(0.3 * 0.6 * mass * 9.80665 * RADIUS * slid, rel=0.02)
    assert abs(launched.residue) < 1e-6 * launched.moved

    car.send(EM2ControlMode=0.0, EM2TorqueRequest=0.0, BrakeTorqueRequest=6500.0)
    body, front, rear, _ = car.advance(300, *watched).T
    assert not front[200:].any()
    assert not rear[200:].any()
    assert RADIUS * (body[200] - body[299]) / 0.099 == pytest.approx(9.80665 * 0.309, rel=0.03)
    # A brake just above what the tyre carries keeps the wheel locked: no damper tears it away.
    car.send(BrakeTorqueRequest=1450.0)
    car.advance(100)
    car.emulator.take_events()
    assert not car.advance(50, "wheel_left_speed").any()
    assert car.emulator.truth("body_speed") > 2.5
    assert not [event for event in car.emulator.take_events() if "brake" in event.text]
    stopped = car.emulator.ledger()
    assert stopped["tyres"] > launched["tyres"]
    assert abs(stopped.residue) < 1e-6 * stopped.moved


def test_a_car_whose_file_asks_for_none_does_not_slip() -> None:
    car = Bench()
    car.command(em2_mode=1.0, em2_torque=200.0)
    car.run(200)
    ledger = car.ledger()
    assert ledger is not None
    assert ledger["tyres"] == 0.0


def test_slip_is_part_of_what_a_snapshot_keeps(slippery: str) -> None:
    whole, other = Driven(slippery).emulator, Driven(slippery).emulator
    whole.advance(600 * MS)
    assert whole.truth("wheel_left_speed") > 2.0 * whole.truth("body_speed")
    kept = whole.snapshot()
    ahead = whole.advance(700 * MS).tobytes()
    other.restore(kept)
    assert other.advance(700 * MS).tobytes() == ahead


def test_bad_slip_is_refused_by_its_place(slippery: str, tmp_path: Path) -> None:
    text = Path(slippery).read_text(encoding="utf-8")
    for old, new, place in (
        ("{value: 0.3,", "{value: 0,", r"detailed\.tyre_slip\.friction"),
        ('{value: 60, unit: "%"', "{value: 60, unit: m", r"detailed\.tyre_slip\.front_load"),
        ("slip_stiffness", "slip_stifness", "slip_stifness"),
    ):
        head, tail = text.split("  tyre_slip:")
        bad = tmp_path / "bad.yaml"
        bad.write_text(head + "  tyre_slip:" + tail.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError, match=place):
            Bench(Setup(model="detailed", vehicle=str(bad)))


def test_told_speeds_are_those_of_the_states_after_the_tyres_have_crept(slippery: str) -> None:
    bench = Bench(Setup(model="detailed", vehicle=slippery))
    bench.command(em2_mode=1.0, em2_torque=200.0)
    bench.run(40)
    speeds = np.asarray(bench.plant.bank.speeds)
    exact = speeds.T @ bench.driveline[: len(speeds)]
    assert bench.truth("wheel_left_speed") == pytest.approx(exact[N_PORTS + LEFT], rel=1e-13)
    assert bench.truth("body_speed") == pytest.approx(exact[ROAD], rel=1e-13)
    assert bench.truth("em2_speed") == pytest.approx(exact[EM2], rel=1e-13)
    assert exact[N_PORTS + LEFT] > 1.0
