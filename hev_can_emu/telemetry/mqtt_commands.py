"""Commands that come by MQTT: which there are, what each takes, and how one is refused.

A command's body is a JSON object; unknown fields are refused like those of a scenario.  ``id`` is free: the
answer carries it back, for clients that do not speak MQTT 5 and its correlation data.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec

from hev_can_emu.errors import HevError, InputError, did_you_mean
from hev_can_emu.telemetry.mqtt_link import Request

Value = float | int | str


class Command(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fields that every command may have."""

    id: str | int | None = None


class ScenarioStart(Command, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Begin a scenario.

    Attributes:
        scenario: name of a shipped one, or of a file in the folder that ``--mqtt-scenarios`` names.
        parameters: by name, in place of the scenario's own.
    """

    scenario: str
    parameters: dict[str, Value] = {}


class ScenarioStop(Command, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """End the scenario that runs; what is undecided becomes inconclusive."""


class FaultInject(Command, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Inject a fault, written as in a scenario's ``inject``."""

    inject: dict[str, Any]


class FaultClear(Command, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """End the fault of this name; all that are live without one."""

    clear: str | None = None


class Input(Command, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Set a signal that this program plays, such as the driver's pedals or the road's grade.

    Attributes:
        signal: name, or ``Message.Signal``.
        value: number in the signal's unit, a quantity with its unit, or a label of its value table.
    """

    signal: str
    value: Value


class Parameter(Command, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Set a parameter of the scenarios that are started from now on and have it; null takes that back."""

    name: str
    value: Value | None


VERBS: Mapping[str, type[Command]] = {
    "scenario/start": ScenarioStart,
    "scenario/stop": ScenarioStop,
    "fault/inject": FaultInject,
    "fault/clear": FaultClear,
    "input": Input,
    "parameter": Parameter,
}

Action = Callable[[Any], Awaitable[dict[str, Any]]]


async def obey(request: Request, actions: Mapping[str, Action]) -> dict[str, Any]:
    """Carry a request out and return the answer.

    Args:
        request: as it came.
        actions: what to do, by verb; takes the command, returns the answer's fields, and raises HevError
            for what cannot be done.

    Returns:
        ``ok``, ``id`` where one was given, then the action's fields, or ``error`` in one line.
    """
    where = f"command/{request.verb}"
    answer: dict[str, Any] = {"ok": False}
    try:
        kind = VERBS.get(request.verb)
        if kind is None or request.verb not in actions:
            hint = did_you_mean(request.verb, actions)
            expected = f"one of {', '.join(sorted(actions))}"
            raise InputError("command", expected, f"'{request.verb}'", hint)
        command = _read(kind, request.body, where, answer)
        answer |= await actions[request.verb](command)
        answer["ok"] = True
    except HevError as error:
        answer["error"] = " ".join(str(error).split())
    return answer


def _read(kind: type[Command], body: bytes, where: str, answer: dict[str, Any]) -> Command:
    try:
        data = msgspec.json.decode(body or b"{}")
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(where, "a JSON object", f"{body[:40]!r}", str(error)) from error
    if not isinstance(data, dict):
        raise InputError(where, "a JSON object", f"{body[:40]!r}")
    if isinstance(data.get("id"), str | int):
        answer["id"] = data["id"]
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        fields = ", ".join(kind.__struct_fields__)
        raise InputError(where, f"the fields {fields}", str(error)) from error
