"""Sensors alone: filter, dead zone, resolution, and what a bindings file may not say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.sensors import Sensors, measure, resolve_sensors
from hev_can_emu.ecu.sensors_file import Sensor
from hev_can_emu.errors import InputError


def resolved(port: str = "em2_speed", **sensor: str) -> Sensors:
    return resolve_sensors({port: Sensor(**sensor)}, lambda steps: ".".join(map(str, steps)))


def measured(sensors: Sensors, values: list[float]) -> list[float]:
    memory = np.full(1, np.nan)
    statuses = np.zeros(len(ports.STATUSES))
    found = []
    for value in values:
        statuses[:] = value
        measure(sensors, memory, statuses)
        assert statuses[ports.S_EM1_SPEED] == value or math.isnan(value)  # has no sensor
        found.append(float(statuses[ports.S_EM2_SPEED]))
    return found


def test_the_filter_is_of_first_order() -> None:
    found = measured(resolved(filter="20 ms"), [0.0] + [10.0] * 40)
    np.testing.assert_allclose(found, 10.0 * (1.0 - np.exp(-np.arange(41) / 20.0)), atol=1e-12)


def test_the_filter_starts_with_the_first_value_and_passes_gaps() -> None:
    assert measured(resolved(filter="1 s"), [math.nan, 7.0, math.nan, 7.0])[1::2] == [7.0, 7.0]


def test_dead_zone_and_resolution() -> None:
    found = measured(
        resolved(dead_zone="3 rad/s", resolution="2 rad/s"), [-2.9, -3.1, 2.9, 3.1, 8.9]
    )
    assert found == [0.0, -4.0, 0.0, 4.0, 8.0]
    step = 2.0 * math.pi / 60.0
    assert measured(resolved(resolution="1 rpm"), [5.4 * step]) == pytest.approx([5.0 * step])


def test_a_step_of_temperature_has_no_offset() -> None:
    for text in ("0.5 K", "0.5 degC"):
        assert resolved("em2_temperature", resolution=text).resolution == pytest.approx([0.5])


@pytest.mark.parametrize(
    ("port", "sensor", "complaint"),
    [
        ("em2_sped", {}, "sensors.em2_sped: expected a status port, got 'em2_sped'; did you mean"),
        (
            "em2_speed",
            {"filter": "20 V"},
            "sensors.em2_speed.filter: expected a number with a unit such as '1 s', got '20 V'",
        ),
        ("em2_speed", {"filter": "-1 s"}, "sensors.em2_speed.filter: expected 0 s to 60 s, got"),
        (
            "em2_speed",
            {"dead_zone": "2 Nm"},
            "sensors.em2_speed.dead_zone: expected a number with a unit such as '1 rad/s'",
        ),
        (
            "em2_speed",
            {"resolution": "-2 rpm"},
            "sensors.em2_speed.resolution: expected 0 or more, got '-2 rpm'",
        ),
        (
            "state_of_charge",
            {"resolution": "2 V"},
            "sensors.state_of_charge.resolution: expected a pure number, got '2 V'",
        ),
    ],
)
def test_what_is_refused(port: str, sensor: dict[str, str], complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        resolved(port, **sensor)
    assert str(refused.value).startswith(complaint)
