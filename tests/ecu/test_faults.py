"""Faults as records: what can be named, and what is refused with one line."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from hev_can_emu.ecu.faults import CATALOGUE, COMMON, Fault, parse
from hev_can_emu.errors import InputError


def test_the_catalogue_tells_what_each_fault_does_and_takes() -> None:
    for name, kind in CATALOGUE.items():
        assert kind.name == name
        assert kind.does.endswith(".")
        parameters = {parameter.name: parameter for parameter in kind.parameters}
        assert set(COMMON) <= set(parameters)
        for parameter in parameters.values():
            assert parameter.meaning, f"{name}.{parameter.name}"
        assert parameters["duration"].unit == "s"


def test_a_fault_survives_being_written_down() -> None:
    fault = parse({"fault": "jitter", "message": "M", "jitter": "30 ms", "seed": 5, "frames": 3})
    assert msgspec.json.decode(msgspec.json.encode(fault), type=Fault) == fault
    assert fault.label == "jitter M"
    assert parse({"fault": "drop", "message": "M", "name": "lost"}).label == "lost"


@pytest.mark.parametrize(
    ("mapping", "complaint"),
    [
        ({"fault": "dorp"}, "f.fault: expected a kind of fault, got 'dorp'; did you mean 'drop'?"),
        ({"message": "M"}, "f: expected a mapping with the key 'fault', got only 'message'"),
        ([], "f: expected a mapping with the key 'fault', got a list"),
        ({"fault": "drop"}, "f: expected the parameter 'message' of drop, got none"),
        ({"fault": "drop", "message": 3}, "f.message: expected text, got 3"),
        ({"fault": "drop", "message": ""}, "f.message: expected text of length >= 1, got ''"),
        (
            {"fault": "delay", "message": "M", "dealy": 1},
            "f: expected a parameter of delay, got 'dealy'; did you mean 'delay'?",
        ),
        (
            {"fault": "delay", "message": "M", "delay": "5 V"},
            "f.delay: expected a number with a unit such as '1 s', got '5 V'; the unit does not fit",
        ),
        (
            {"fault": "delay", "message": "M", "delay": "20 s"},
            "f.delay: expected 1 ms to 10 s, got '20 s'",
        ),
        (
            {"fault": "drop", "message": "M", "after": -1},
            "f.after: expected a time from 0 s to 86400 s, got '-1'",
        ),
        (
            {"fault": "drop", "message": "M", "duration": 0},
            "f.duration: expected a time above 0 s, got '0'",
        ),
        (
            {"fault": "drop", "message": "M", "frames": -1},
            "f.frames: expected a whole number >= 0, got -1",
        ),
        (
            {"fault": "drop", "message": "M", "chance": 1.5},
            "f.chance: expected a number <= 1.0, got 1.5",
        ),
        (
            {"fault": "drop", "message": "M", "resume": "stoped"},
            "f.resume: expected one of running, stopped, got 'stoped'; did you mean 'stopped'?",
        ),
        (
            {"fault": "babbling_node", "rate": "10 Hz"},
            "f.rate: expected 1000 to 20000 frames a second, got '10 Hz'",
        ),
        (
            {"fault": "babbling_node", "id": 0x800},
            "f.id: expected 0 to 0x7FF, or extended: true, got 0x800",
        ),
    ],
)
def test_what_is_refused(mapping: Any, complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        parse(mapping, "f")
    assert str(refused.value) == complaint
