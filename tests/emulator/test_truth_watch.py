"""The plant's truth at every tenth tick, whatever calls a run is made of."""

import numpy as np

from hev_can_emu.plant.powertrain import TRUTH
from hev_can_emu.runtime.emulator import TRUTH_NS, Emulator
from hev_can_emu.runtime.setup import Setup

MS = 1_000_000


def watched(calls_ms: list[int]) -> tuple[np.ndarray, np.ndarray]:
    car = Emulator(Setup(nodes={"HCU": "emulated"}))
    for name, value in (("ContactorRequest", 1), ("EM2ControlMode", 1), ("EM2TorqueRequest", 40)):
        car.set_value(car.database.signal(name).index, value)
    times, values = [], []

    def see(t_ns: np.ndarray, truth: np.ndarray) -> None:
        times.append(t_ns)
        values.append(truth)

    end = car.watch_truth(see)
    for until in calls_ms:
        car.advance(until * MS)
    end()
    car.advance((calls_ms[-1] + 100) * MS)  # nobody looks any more
    return np.concatenate(times), np.concatenate(values)


def test_samples_do_not_depend_on_calls() -> None:
    times, values = watched([12_000])
    assert times.tolist() == [*range(0, 12_000 * MS, TRUTH_NS), 12_000 * MS]
    again, same = watched([*range(1, 300, 7), 5_000, 12_000])
    assert again.tolist() == times.tolist()
    np.testing.assert_array_equal(values, same)
    speed = values[:, TRUTH.index("vehicle_speed")]
    assert speed[0] == 0.0
    assert speed[-1] > 3.0


def test_a_sample_is_the_truth_of_its_time() -> None:
    times, values = watched([2_000])
    car = Emulator(Setup(nodes={"HCU": "emulated"}))
    for name, value in (("ContactorRequest", 1), ("EM2ControlMode", 1), ("EM2TorqueRequest", 40)):
        car.set_value(car.database.signal(name).index, value)
    for t_ns, row in zip(times.tolist(), values, strict=True):
        car.advance(t_ns)
        np.testing.assert_array_equal(row, car.state.truth)
