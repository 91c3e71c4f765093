"""Supervision rests while nothing can change; a car whose supervision never rests does the same."""

from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.ecu import supervision
from hev_can_emu.ecu.faults import SensorFailure
from hev_can_emu.messages.frame import SENT, make_frames
from hev_can_emu.resources import folder
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

SENDER = ("HCU",)
COMPARED = (
    "requests",
    "kept",
    "effective",
    "share",
    "limited",
    "statuses",
    "codes",
    "command",
    "on_bus",
)


def requests_of_a_controller(seconds: int) -> np.ndarray:
    """Return what an emulated HCU sends, with stretches of silence and of broken frames."""
    car = Emulator(Setup(nodes=dict.fromkeys(SENDER, "emulated")))
    for name, value in (("ContactorRequest", 1), ("EM2ControlMode", 1), ("EM2TorqueRequest", 40)):
        car.set_value(car.database.signal(name).index, value)
    ids = [m.can_id for m in car.database.messages if m.sender in SENDER]
    frames = car.advance(seconds * 1_000_000_000)
    frames = frames[np.isin(frames["id"], ids)].copy()
    frames["flags"] &= 255 - SENT
    random = np.random.default_rng(5)
    kept = np.ones(len(frames), dtype=bool)
    for begin_ms in random.integers(0, seconds * 1000, 12):
        during = (frames["t_ns"] >= begin_ms * 10**6) & (frames["t_ns"] < (begin_ms + 150) * 10**6)
        one = during & (frames["id"] == random.choice(ids))
        if random.random() < 0.5:
            kept &= ~one
        else:
            frames["data"][one, 1] ^= 0x40
    return frames[kept]


PLAIN = Setup()
LOST = SensorFailure(sensor="em1_request_status")
STUCK = SensorFailure(sensor="em1_request_status", mode="stuck")


def measured(tmp_path: Path, port: str) -> Setup:
    """Return a setup whose bindings measure what supervision or a request tells."""
    text = (folder("dbc") / "hev.bindings.yaml").read_text()
    path = tmp_path / "hev.bindings.yaml"
    sensor = f"sensors:\n  {port}: {{filter: 20 ms}}\n"
    path.write_text(text.replace("sensors:\n", sensor, 1))
    return Setup(dbc=str(folder("dbc") / "hev.dbc"), bindings=str(path))


MEASURED = {"status measured": "em1_request_status", "echo measured": "em2_torque_echo"}


@pytest.mark.parametrize("case", ["plain", "codes cleared", "lost", "stuck", *MEASURED])
def test_a_resting_supervision_changes_nothing(case: str, tmp_path: Path) -> None:
    frames = requests_of_a_controller(4)
    setup = measured(tmp_path, MEASURED[case]) if case in MEASURED else PLAIN
    fault = {"lost": LOST, "stuck": STUCK}.get(case)
    resting, restless = Emulator(setup), Emulator(setup)
    at, rested = 0, 0
    events: list[list] = [[], []]
    for t_ms in range(4000):
        end = int(np.searchsorted(frames["t_ns"], t_ms * 10**6, side="right"))
        given = frames[at:end].copy() if end > at else make_frames(1)
        count, at = end - at, end
        rested += int(resting.state.scalars[tick.CALM_NS] >= t_ms * 10**6)
        restless.state.scalars[tick.CALM_NS] = -1
        restless.state.supervision[:, supervision.CALM_NS] = supervision.NEVER_NS
        for car, told in zip((resting, restless), events, strict=True):
            if case == "codes cleared" and t_ms == 2000:
                car.clear_trouble_codes()
            if fault is not None and t_ms == 1300:
                car.inject(fault)
            if fault is not None and t_ms == 2600:
                car.clear(car.faults[0].name)
            car.advance((t_ms + 1) * 10**6, given, count)
            told += car.take_events()
        for name in COMPARED:
            np.testing.assert_array_equal(
                getattr(resting.state, name), getattr(restless.state, name)
            )
        np.testing.assert_array_equal(
            np.delete(resting.state.supervision, supervision.CALM_NS, axis=1),
            np.delete(restless.state.supervision, supervision.CALM_NS, axis=1),
        )
    assert events[0] == events[1]
    assert {each.kind for each in events[0]} >= {"lost", "healed"}
    assert rested > 400 or case in ("lost", "stuck")
