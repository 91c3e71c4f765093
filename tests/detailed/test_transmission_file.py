"""The TCU's tuning comes from the vehicle file; what that leaves out is the default car's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hev_can_emu.ecu.transmission_file import TransmissionTuning, transmission_tuning
from hev_can_emu.errors import InputError
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.car import Car
from hev_can_emu.runtime.setup import Setup, load_car


@pytest.fixture(scope="module")
def tuned(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """Write the shipped car with a section ``transmission_unit`` of so many lines, or without."""
    text = (repository / "vehicles" / "dai2024.yaml").read_text(encoding="utf-8")
    begin = text.index("transmission_unit:\n")
    end = text.index("# Of --model detailed only", begin)

    def write(section: str) -> str:
        file = tmp_path_factory.mktemp("vehicle") / "car.yaml"
        file.write_text(text[:begin] + section + text[end:], encoding="utf-8")
        return str(file)

    return write


def test_the_shipped_file_says_what_is_left_out_otherwise(tuned: Callable[[str], str]) -> None:
    for vehicle in ("dai2024", tuned(""), tuned("transmission_unit: {shift: {}}\n")):
        *_, file, path = load_car(vehicle)
        assert transmission_tuning(file, path) == TransmissionTuning()


def _until_engaged(vehicle: str) -> int:
    car = Bench(Setup(model="detailed", vehicle=vehicle))
    car.command(external_gear=1.0)
    while car.truth("gear") != 1.0:
        car.run(1)
        assert car.t_ns < 1_000_000_000
    return car.t_ns // 1_000_000


def test_a_gentler_shift_takes_longer(tuned: Callable[[str], str]) -> None:
    gentle = """transmission_unit:
  shift:
    travel_force: {value: 0.2, unit: kN, source: test}
    dog_force: {value: 0.2, unit: kN, source: test}
"""
    assert _until_engaged(tuned(gentle)) > 1.3 * _until_engaged("dai2024")


@pytest.mark.parametrize(
    ("section", "told"),
    [
        ("shift: {timeot: {value: 1, unit: s, source: x}}", r"did you mean 'timeout'"),
        ("shift: {timeout: {value: 1, unit: N, source: x}}", r"shift\.timeout\.unit: expected a"),
        (
            "shift: {timeout: {value: 0, unit: s, source: x}}",
            r"shift\.timeout: expected a number g",
        ),
        (
            "hydraulics: {pump_on: {value: 60, unit: bar, source: x}}",
            r"\$\.transmission_unit\.hydraulics\.pump_off: expected more than pump_on",
        ),
        ("gears: {}", r"expected a known key, got 'gears'"),
    ],
    ids=["unknown", "unit", "value", "order", "group"],
)
def test_bad_tuning_is_refused_on_one_line(
    tuned: Callable[[str], str], section: str, told: str
) -> None:
    with pytest.raises(InputError, match=told) as caught:
        Car(Setup(model="detailed", vehicle=tuned(f"transmission_unit:\n  {section}\n")))
    assert "\n" not in str(caught.value)
