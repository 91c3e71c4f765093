"""Where a run is split changes no bit."""

from __future__ import annotations

import numpy as np
import pytest

from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

NAN = float("nan")


def launched() -> Bench:
    """EM1 cranks the engine through C1 while EM2 pulls: slips, locks, kiss point and fill are due."""
    car = Bench()
    car.command(
        em1_mode=2.0, em1_speed=160.0, em1_torque_min=NAN, em1_torque_max=NAN,
        em2_mode=1.0, em2_torque=120.0, em2_torque_min=NAN, em2_torque_max=NAN,
        clutch_capacity=150.0, engine_run=1.0,
    )  # fmt: skip
    return car


@pytest.mark.parametrize("parts", [(1,) * 300, (7, 93, 1, 199), (299, 1)])
def test_a_car_on_the_bench(parts: tuple[int, ...]) -> None:
    whole, split = launched(), launched()
    whole.advance(300)
    for part in parts:
        split.advance(part)
    assert whole.truth("engine_speed") > 20.0
    assert whole.x.tobytes() == split.x.tobytes()
    assert whole.n.tobytes() == split.n.tobytes()
    assert whole.events == split.events
    assert len(whole.events) >= 3


def test_a_car_on_its_bus() -> None:
    def frames(parts: tuple[int, ...]) -> bytes:
        emulator = Emulator(Setup(model="detailed", nodes={"HCU": "emulated"}))
        for name, signal, value in (
            ("HCU_EM2Request", "EM2ControlMode", 1.0),
            ("HCU_EM2Request", "EM2TorqueRequest", 90.0),
            ("HCU_HVRequest", "ContactorRequest", 1.0),
            ("HCU_ClutchRequest", "ClutchTorqueCapacityRequest", 80.0),
        ):
            emulator.set_value(emulator.database.signal_index(name, signal), value)
        sent = [emulator.advance(emulator.now_ns + part * 1_000_000).copy() for part in parts]
        return np.concatenate(sent).tobytes()

    whole = frames((400,))
    assert len(whole) > 80 * 500
    assert whole == frames((1,) * 50 + (123, 27, 200))
