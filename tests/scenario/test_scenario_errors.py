"""Each way in which a scenario can be wrong, with the exact message."""

from __future__ import annotations

from typing import Any

import pytest

from hev_can_emu.errors import InputError

HEAD = "version: 1\nname: test\nduration: 10 s\n"

CASES: list[tuple[str, str]] = [
    # Shape
    (
        "duration: 10 s\nversion: 1\n",
        "s.yaml:1: $: expected the key 'name', got only 'duration', 'version'",
    ),
    (
        HEAD + "step: []\n",
        "s.yaml:4: $.step: expected a known key, got 'step'; did you mean 'steps' or 'setup' or 'seed'?",
    ),
    (
        HEAD + "name: again\n",
        "s.yaml:4:1: expected each key once, got 'name' again; first in line 2",
    ),
    ("version: 2\nname: x\nduration: 1 s\n", "s.yaml:1: $.version: expected 1, got 2"),
    (
        HEAD + "steps:\n- at: 0 s\n  sett: {}\n",
        "s.yaml:6: $.steps[0].sett: expected a known key, got 'sett'; "
        "did you mean 'set' or 'sine' or 'send'?",
    ),
    (
        HEAD + "nodes: {EMS: absent}\n",
        "s.yaml:4: $.nodes.EMS: expected one of emulated, external, silent, got 'absent'; "
        "did you mean 'silent'?",
    ),
    # Times
    (
        "version: 1\nname: x\nduration: 10\n",
        "s.yaml:3: $.duration: expected a number with a unit such as '1 s', got '10'; "
        "the unit does not fit",
    ),
    (
        "version: 1\nname: x\nduration: 10 rpm\n",
        "s.yaml:3: $.duration: expected a number with a unit such as '1 s', got '10 rpm'; "
        "the unit does not fit",
    ),
    (
        "version: 1\nname: x\nduration: 0 s\n",
        "s.yaml:3: $.duration: expected a time above 0 s, got '0 s'",
    ),
    (
        HEAD + "steps:\n- at: -1 s\n",
        "s.yaml:5: $.steps[0].at: expected a time of 0 s or more, got '-1 s'",
    ),
    # What other readers of YAML take for something else
    (
        "version: 1\nname: x\nduration: 1e-3\n",
        "s.yaml:3: $.duration: expected a number with a unit such as '1 s', got '0.001'; "
        "the unit does not fit",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2ControlMode: on}\n",
        "s.yaml:6: $.steps[0].set.EM2ControlMode: expected a number or a label, got 'on'; "
        "labels: Off, Torque, Speed, NotAvailable",
    ),
    (
        HEAD + "expectations:\n- sequence: {value: DrivingMode, of: [1], exactly: on}\n",
        "s.yaml:5: $.expectations[0].sequence.exactly: expected true or false, got 'on'",
    ),
    (
        HEAD + "seed: 1_000\n",
        "s.yaml:4: $.seed: expected a whole number, got '1_000'",
    ),
    # Steps
    (
        HEAD + "steps:\n- name: x\n",
        "s.yaml:5: $.steps[0]: expected one of 'at', 'when', 'after', got none",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  after: 2 s\n",
        "s.yaml:5: $.steps[0]: expected one of 'at', 'when', 'after', got 'at' and 'after'",
    ),
    (
        HEAD + "steps:\n- at: 5 s\n- at: 4 s\n",
        "s.yaml:6: $.steps[1].at: expected steps in the order of their times, got '4 s'; "
        "the step before comes at 5 s or later",
    ),
    (
        HEAD + "steps:\n- at: 5 s\n- after: 6 s\n",
        "s.yaml:6: $.steps[1].after: expected a time up to the scenario's end, 10 s, got 11 s; "
        "raise duration or move it",
    ),
    (
        HEAD + "steps:\n- when: t > 3 s\n",
        "s.yaml:5: $.steps[0]: expected 'timeout' beside 'when', got none; "
        "say how long to wait, such as timeout: 10 s",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  timeout: 3 s\n",
        "s.yaml:6: $.steps[0].timeout: expected 'when' beside it, got 'timeout' without it",
    ),
    (
        HEAD + "steps:\n- when: VehicleSpeed\n  timeout: 3 s\n",
        "s.yaml:5: $.steps[0].when: expected a condition, got 'VehicleSpeed'; "
        "compare it with something",
    ),
    (
        HEAD + "steps:\n- when: VehiclSpeed > 3\n  timeout: 3 s\n",
        "s.yaml:5: $.steps[0].when: expected a signal or parameter, got 'VehiclSpeed' in "
        "'VehiclSpeed > 3'; did you mean 'VehicleSpeed' or 'EM2Speed' or 'EM1Speed'?",
    ),
    (
        HEAD + "steps:\n- when: t > 1 s\n  timeout: 1 s\n  held: 2 s\n",
        "s.yaml:7: $.steps[0].held: expected at most the timeout, 1 s, got '2 s'",
    ),
    (
        HEAD + "steps:\n- {at: 1 s, name: a}\n- {at: 1 s, name: a}\n",
        "s.yaml:6: $.steps[1].name: expected each name once, got 'a' again; first in $.steps[0]",
    ),
    # Stimuli
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2TorqeRequest: 1}\n",
        "s.yaml:6: $.steps[0].set.EM2TorqeRequest: expected a signal, got 'EM2TorqeRequest'; "
        "did you mean 'EM2TorqueRequest' or 'EM1SpeedRequest'?",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2TorqueRequest: 3 rpm}\n",
        "s.yaml:6: $.steps[0].set.EM2TorqueRequest: expected a number in Nm, got '3 rpm'; "
        "HCU_EM2Request.EM2TorqueRequest is in Nm",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2TorqueRequest: 3 Nmm2}\n",
        "s.yaml:6: $.steps[0].set.EM2TorqueRequest: expected a unit, got 'Nmm2'; "
        "did you mean 'Nm'?",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2TorqueRequest: 1.5 kNm}\n",
        "s.yaml:6: $.steps[0].set.EM2TorqueRequest: expected -400 to 400 Nm, got 1.5 kNm; "
        "the range of HCU_EM2Request.EM2TorqueRequest",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2TorqueRequest: -401}\n",
        "s.yaml:6: $.steps[0].set.EM2TorqueRequest: expected -400 to 400 Nm, got -401 Nm; "
        "the range of HCU_EM2Request.EM2TorqueRequest",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2ControlMode: Sped}\n",
        "s.yaml:6: $.steps[0].set.EM2ControlMode: expected a number or a label, got 'Sped'; "
        "did you mean 'Speed'?",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2ControlMode: true}\n",
        "s.yaml:6: $.steps[0].set.EM2ControlMode: expected a number or a label, got true; "
        "labels: Off, Torque, Speed, NotAvailable",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {Odd: 3 m}\n",
        "s.yaml:6: $.steps[0].set.Odd: unit of VEH_Driver.Odd: expected a unit, got 'furlong'",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM1Speed: 3}\n",
        "s.yaml:6: $.steps[0].set.EM1Speed: expected a signal sent by HCU or VEH, got 'EM1Speed'; "
        "MCU1 sends it in MCU1_Status",
    ),
    (
        HEAD + "plays: [VEH]\nsteps:\n- at: 1 s\n  set: {EM2TorqueRequest: 3}\n",
        "s.yaml:7: $.steps[0].set.EM2TorqueRequest: expected a signal sent by VEH, "
        "got 'EM2TorqueRequest'; HCU sends it in HCU_EM2Request",
    ),
    (
        HEAD + "plays: [VEHH]\n",
        "s.yaml:4: $.plays[0]: expected a node that sends, got 'VEHH'; did you mean 'VEH'?",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  set: {EM2TorqueRequest: 3}\n  hold: [EM2TorqueRequest]\n",
        "s.yaml:7: $.steps[0].hold[0]: expected each signal once in a step, "
        "got 'EM2TorqueRequest' in 'set' and 'hold'",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  ramp: {EM2TorqueRequest: {to: 500, over: 1 s}}\n",
        "s.yaml:6: $.steps[0].ramp.EM2TorqueRequest.to: expected -400 to 400 Nm, got 500 Nm; "
        "the range of HCU_EM2Request.EM2TorqueRequest",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  ramp: {EM2TorqueRequest: {to: 50}}\n",
        "s.yaml:6: $.steps[0].ramp.EM2TorqueRequest: expected the key 'over', got only 'to'",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  ramp:\n    EM2TorqueRequest: 50\n",
        "s.yaml:7: $.steps[0].ramp.EM2TorqueRequest: expected a mapping, got 50",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  follow: {EM1SpeedRequest: VehicleSpeed * 30}\n",
        "s.yaml:6: $.steps[0].follow.EM1SpeedRequest: expected a value in rpm, "
        "got km/h from 'VehicleSpeed * 30'; EM1SpeedRequest is in rpm; number(...) drops a unit",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  follow: {EM1SpeedRequest: t > 1}\n",
        "s.yaml:6: $.steps[0].follow.EM1SpeedRequest: expected a number, got the condition 't > 1'",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  sine: {EM2TorqueRequest: {amplitude: 50, frequency: 2 s}}\n",
        "s.yaml:6: $.steps[0].sine.EM2TorqueRequest.frequency: expected a number with a unit such "
        "as '1 Hz', got '2 s'; the unit does not fit",
    ),
    (
        HEAD
        + "steps:\n- at: 1 s\n  sine: {EM2TorqueRequest: "
        + "{amplitude: 300, offset: 200, frequency: 2 Hz}}\n",
        "s.yaml:6: $.steps[0].sine.EM2TorqueRequest: expected -400 to 400 Nm, got 500.0 Nm; "
        "the range of HCU_EM2Request.EM2TorqueRequest",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  silence: [HCU_EM2]\n",
        "s.yaml:6: $.steps[0].silence[0]: expected a message, got 'HCU_EM2'; "
        "did you mean 'HCU_EM2Request' or 'HCU_EM1Request'?",
    ),
    (
        HEAD + "steps:\n- at: 1 s\n  resume: [MCU1_Status]\n",
        "s.yaml:6: $.steps[0].resume[0]: expected a message sent by HCU or VEH, "
        "got 'MCU1_Status'; MCU1 sends it",
    ),
    # Parameters
    (
        HEAD + "parameters: {EM1Speed: 3}\n",
        "s.yaml:4: $.parameters.EM1Speed: expected a name of its own, got 'EM1Speed'; "
        "a signal is called so",
    ),
    (
        HEAD + "parameters: {min: 3}\n",
        "s.yaml:4: $.parameters.min: expected a name of its own, got 'min'; "
        "expressions have a word for this",
    ),
    (
        HEAD + "parameters: {a-b: 3}\n",
        "s.yaml:4: $.parameters.a-b: expected a name of letters, digits and _, got 'a-b'",
    ),
    (
        HEAD + "parameters: {a: fast}\n",
        "s.yaml:4: $.parameters.a: expected a number with a unit, got 'fast'",
    ),
    (
        HEAD + "parameters: {a: 3}\n",
        "s.yaml:4: $.parameters.a: expected a parameter in use, got 'a'; remove it",
    ),
    # Expectations
    (
        HEAD + "expectations:\n- from: 1 s\n",
        "s.yaml:5: $.expectations[0]: expected one of always, never, becomes, until, settles, "
        "equals, overshoot, rise_time, monotone, sequence, follows, count, period, jerk, "
        "vibration_dose, got none",
    ),
    (
        HEAD + "expectations:\n- always: t > 1 s\n  to: 11 s\n",
        "s.yaml:6: $.expectations[0].to: expected a time up to the scenario's end, 10 s, got 11 s; "
        "raise duration or move it",
    ),
    (
        HEAD + "expectations:\n- always: t > 1 s\n  from: 9 s\n  for: 2 s\n",
        "s.yaml:7: $.expectations[0].for: expected a time up to the scenario's end, 10 s, "
        "got 11 s; raise duration or move it",
    ),
    (
        HEAD + "steps:\n- {name: go, at: 9 s}\nexpectations:\n"
        "- becomes: t > 1 s\n  from: step go\n  within: 2 s\n",
        "s.yaml:9: $.expectations[0].within: expected a time up to the scenario's end, 10 s, "
        "got 11 s; raise duration or move it",
    ),
    (
        HEAD + "expectations:\n- always: t > 1 s\n  from: 3 s\n  to: 2 s\n",
        "s.yaml:7: $.expectations[0].to: expected a window that ends after it begins, got '2 s'",
    ),
    (
        HEAD + "expectations:\n- always: t > 1 s\n  for: 3 s\n  to: 2 s\n",
        "s.yaml:5: $.expectations[0]: expected one end of the window, got 'to' and 'for'",
    ),
    (
        HEAD + "expectations:\n- always: t > 1 s\n  within: 3 s\n",
        "s.yaml:6: $.expectations[0].within: expected no 'within' beside 'always', got one; "
        "always takes from, to, for",
    ),
    (
        HEAD + "steps:\n- {name: launch, at: 1 s}\nexpectations:\n"
        "- always: t > 1 s\n  from: step lunch\n",
        "s.yaml:8: $.expectations[0].from: expected a step's name, got 'lunch'; "
        "did you mean 'launch'?",
    ),
    (
        HEAD + "expectations:\n- becomes: t > 1 s\n",
        "s.yaml:5: $.expectations[0]: expected 'within' beside 'becomes', got none; "
        "say by when: within: 2 s",
    ),
    (
        HEAD + "expectations:\n- equals: {value: EM1Speed, to: 3}\n",
        "s.yaml:5: $.expectations[0]: expected 'at' beside 'equals', got none; "
        "say when, such as at: 5 s",
    ),
    (
        HEAD + "expectations:\n- settles: {value: EM1Speed, to: 3, band: 2 Nm}\n  within: 1 s\n",
        "s.yaml:5: $.expectations[0].settles.band: expected a number with a unit such as '1 rpm', "
        "got '2 Nm'; the unit does not fit",
    ),
    (
        HEAD + "expectations:\n- sequence: {value: DrivingMode, of: [Series, Paralel]}\n",
        "s.yaml:5: $.expectations[0].sequence.of[1]: expected a number or a label, got 'Paralel'; "
        "did you mean 'ParallelG1' or 'Parallel G2'?",
    ),
    (
        HEAD + "expectations:\n- sequence: {value: DrivingMode, of: [Series, 1]}\n",
        "s.yaml:5: $.expectations[0].sequence.of[1]: expected another value than the one before, "
        "got '1' twice",
    ),
]


def test_what_looks_like_a_number_is_one(bench: Any) -> None:
    bench.play("duration: 1 s\nsteps:\n- {at: 0 s, set: {EM2TorqueRequest: 1e-3}}")
    assert bench.sent == [(0, "EM2TorqueRequest", 0.001)]


@pytest.mark.parametrize(("text", "message"), CASES, ids=range(len(CASES)))
def test_one_line_says_what_is_wrong(text: str, message: str, bench: Any) -> None:
    with pytest.raises(InputError) as caught:
        bench.load(text)
    assert str(caught.value) == message
