"""The JSON Schema of scenario files, by which editors complete and check; made for one network.

What it cannot know it lets pass: whether a text is a quantity that fits, an expression, a parameter's name.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from hev_can_emu.ecu.faults import Fault
from hev_can_emu.messages.definitions import MessageDef
from hev_can_emu.runtime.setup import MODELS
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.signals import Signal, Signals
from hev_can_emu.scenario.window_compiler import WINDOWS

DIALECT = "http://json-schema.org/draft-07/schema#"
_VALUE = {"integer", "number", "string", "boolean"}
#: Keys of a step whose entries are named by signals.
_BY_SIGNAL = ("set", "ramp", "follow", "sine", "chirp", "train", "profile")
_HOVER = {
    "Step": {
        "at": "the time at which the step comes, from the scenario's start: 2 s",
        "when": "the condition that the step waits for: VehicleSpeed > 20 km/h",
        "after": "the time from the step before: 500 ms",
        "timeout": "how long to wait for the condition: 10 s",
        "held": "how long the condition must hold: 100 ms",
        "on_timeout": "whether the scenario goes on where the condition has not come in time",
        "set": "signals to constants: a number in the signal's unit, 20 km/h, a label, not available",
        "ramp": "signals to straight lines",
        "follow": "signals to expressions, anew at every tick",
        "sine": "signals to sines",
        "chirp": "signals to sines whose frequency sweeps",
        "train": "signals to trains of steps",
        "profile": "signals to columns of CSV files",
        "hold": "signals that stay as they are",
        "release": "signals that go back to their initial values",
        "silence": "messages no longer sent",
        "resume": "messages sent again",
        "send": "raw frames",
        "inject": "faults that begin",
        "clear": "names of faults that end",
    },
    "Expectation": {
        "always": "a condition that holds at every tick of the window",
        "never": "a condition that holds at no tick of the window",
        "becomes": "a condition that comes to hold in the window",
        "at": "the instant: 5 s, end, step NAME, step NAME + 1 s",
        "from": "where the window begins: 5 s, step NAME, step NAME + 1 s",
        "to": "where the window ends: 5 s, end, step NAME",
        "for": "the window's length: 2 s",
        "within": "the time from the window's beginning to the deadline: 2 s",
        "hold": "how long the value must stay settled after the deadline: 1 s",
    },
    "Scenario": {
        "version": "of the language",
        "duration": "of the steps; setup and teardown come before and after: 12 s",
        "bus": "where it is played in wall time: socketcand, loopback, socketcan:vcan0",
        "seed": "of everything random, which is faults",
        "nodes": "who sends a node's messages, where it is not its default",
        "plays": "the nodes whose signals the steps set",
        "parameters": "named numbers and quantities",
        "matrix": "lists of values of parameters and of vehicle, model, start, seed; every combination runs",
        "setup": "steps before the scenario's time begins",
        "teardown": "steps after its end, whatever happened",
    },
}


def scenario_schema(messages: Iterable[MessageDef]) -> dict[str, Any]:
    """Return the schema of scenarios on this network (JSON Schema, draft 7)."""
    whole = msgspec.json.schema(Scenario)
    defs: dict[str, Any] = whole["$defs"]
    for name, words in _HOVER.items():
        for key, text in words.items():
            defs[name]["properties"][key]["description"] = text
    faults = msgspec.json.schema(Fault)
    defs |= faults.pop("$defs")
    faults.pop("discriminator")
    defs["Fault"] = {"description": "a fault; 'fault' names its kind", **faults}
    defs["Step"]["properties"]["inject"]["items"] = {"$ref": "#/$defs/Fault"}
    defs = _simple(defs)
    defs["Value"] = {
        "description": "a number in the unit of what it is for, a quantity (20 km/h), a label, "
        "or a parameter's name",
        "type": ["number", "string"],
    }
    _name_signals(defs, Signals(messages))
    _include(defs["Scenario"], defs)
    defs["Scenario"]["properties"]["model"]["examples"] = list(MODELS)
    defs["Step"]["oneOf"] = [
        {"required": ["at"]},
        {"required": ["after"]},
        {"required": ["when", "timeout"]},
        {"required": ["repeat"]},
        {"required": ["include"]},
    ]
    defs["Expectation"]["oneOf"] = [{"required": [kind]} for kind in (*WINDOWS, "include")]
    return {
        "$schema": DIALECT,
        "title": "A scenario of hev-can-emu, version 1",
        "$ref": "#/$defs/Scenario",
        "$defs": defs,
    }


def schema_text(messages: Iterable[MessageDef]) -> str:
    """Return the schema as it is shipped and printed."""
    return (
        msgspec.json.format(msgspec.json.encode(scenario_schema(messages)), indent=1).decode()
        + "\n"
    )


def _simple(node: Any) -> Any:
    """Return the schema with one name for values, and without ``null`` for what is left out."""
    if isinstance(node, list):
        return [_simple(each) for each in node]
    if not isinstance(node, dict):
        return node
    options = node.get("anyOf")
    if isinstance(options, list):
        kept = [each for each in options if each != {"type": "null"}]
        rest = {key: value for key, value in node.items() if key not in ("anyOf", "default")}
        if {each.get("type") for each in kept} == _VALUE and all(len(each) == 1 for each in kept):
            # Beside a reference draft 7 reads nothing else.
            return {**rest, "allOf": [{"$ref": "#/$defs/Value"}]} if rest else _reference("Value")
        if len(kept) == 1:
            return {**rest, **_simple(kept[0])}
    return {key: _simple(value) for key, value in node.items()}


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/$defs/{name}"}


def _name_signals(defs: dict[str, Any], signals: Signals) -> None:
    """Let the keys of stimuli be the network's signals, and messages its messages."""
    playable = {
        name: found
        for name in signals.names()
        if (found := signals.find(name)) is not None and not found.protected
    }
    step = defs["Step"]["properties"]
    for key in _BY_SIGNAL:
        shape = step[key].pop("additionalProperties")
        if key == "set":
            step[key]["additionalProperties"] = False
            step[key]["properties"] = {
                name: _value_of(signal) for name, signal in playable.items() if "." not in name
            }
            qualified = [name for name in playable if "." in name]
            step[key]["patternProperties"] = _one_of(qualified, shape)
        else:
            step[key]["propertyNames"] = {"enum": list(playable)}
            step[key]["additionalProperties"] = shape
    for key, names in (
        ("hold", list(playable)),
        ("release", list(playable)),
        ("silence", list(signals.messages)),
        ("resume", list(signals.messages)),
    ):
        step[key]["items"] = {"enum": names}
    defs["Period"]["properties"]["message"] = {"enum": list(signals.messages)}


def _one_of(names: Iterable[str], shape: Any) -> dict[str, Any]:
    """Return a pattern for exactly these names."""
    by_message: dict[str, list[str]] = {}
    for name in names:
        message, _, signal = name.partition(".")
        by_message.setdefault(message, []).append(signal)
    return {rf"^{message}\.({'|'.join(found)})$": shape for message, found in by_message.items()}


def _value_of(signal: Signal) -> dict[str, Any]:
    """Return what a signal can be set to, with hover text and its labels to choose from."""
    number: dict[str, Any] = {"type": "number"}
    span = ""
    if signal.minimum > float("-inf"):
        number |= {"minimum": signal.minimum, "maximum": signal.maximum}
        span = f"{signal.minimum:g} to {signal.maximum:g} {signal.unit}".strip()
    told = f"{span or signal.unit or 'a number'}; {signal.sender} sends it in {signal.message}"
    options: list[dict[str, Any]] = [{"enum": list(signal.labels)}] if signal.labels else []
    return {"description": told, "anyOf": [*options, number, {"type": "string"}]}


def _include(scenario: dict[str, Any], defs: dict[str, Any]) -> None:
    """Let files be included at the top and in the lists."""
    file = {"type": "string", "minLength": 1}
    scenario["properties"]["include"] = {
        "description": "other files, whose lists come before these and whose parameters count as defaults",
        "anyOf": [file, {"type": "array", "items": file}],
    }
    for name in ("Step", "Expectation"):
        told = "in place of this entry: what a file has under the same key"
        defs[name]["properties"]["include"] = {"description": told, **file}
