"""Turns msgspec's validation errors into expected, got and hint, with the exact path."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect

from hev_can_emu.errors import InputError, did_you_mean

Steps = tuple[str | int, ...]

_ANY_KEY = "[...]"
_PATH = re.compile(r"(?s)(?P<text>.*?)(?: - at `(?P<key>key in )?\$(?P<path>[^`]*)`)?")
_STEP = re.compile(r"\.(?P<field>[^.\[]+)|\[(?P<index>\d+)\]|(?P<any>\[\.\.\.\])")
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "object": "a mapping",
    "array": "a list",
}


class Complaint(NamedTuple):
    """What is wrong at ``steps``."""

    steps: Steps
    expected: str
    got: str
    hint: str


def describe(value: object) -> str:
    """Return a value as it would stand in a file, short."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        line = " ".join(value.split())
        return f"'{line}'" if len(line) <= 60 else f"'{line[:57]}...'"
    if isinstance(value, dict):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list):
        return "a list" if value else "an empty list"
    return str(value)


def translate(error: msgspec.ValidationError, data: Any, type_: Any) -> Complaint:
    """Return the complaint behind ``error``, which converting ``data`` to ``type_`` raised."""
    match = _PATH.fullmatch(str(error))
    if match is None:
        return Complaint((), "a valid file", str(error), "")
    text = match["text"]
    steps = _exact(match["path"] or "", error, data, type_)
    value = _at(data, steps)
    cause = error.__cause__
    if isinstance(cause, InputError):
        return Complaint(steps, cause.expected, cause.got, cause.hint)
    if (unknown := re.fullmatch(r"(?s)Object contains unknown field `(.*)`", text)) is not None:
        name = unknown[1]
        known = _fields(type_, steps)
        hint = did_you_mean(name, known) or f"known: {', '.join(known)}"
        return Complaint((*steps, name), "a known key", describe(name), hint)
    if (missing := re.fullmatch(r"(?s)Object missing required field `(.*)`", text)) is not None:
        keys = ", ".join(f"'{key}'" for key in value) if isinstance(value, dict) else ""
        return Complaint(steps, f"the key '{missing[1]}'", f"only {keys}" if keys else "none", "")
    if text.startswith(("Invalid enum value", "Invalid value")):
        choices = _choices(type_, steps)
        hint = did_you_mean(value, choices) if isinstance(value, str) else ""
        expected = "one of " + ", ".join(choices) if len(choices) != 1 else choices[0]
        return Complaint(steps, expected, describe(value), hint)
    if (
        kind := re.fullmatch(r"(?s)Expected `([^`]*)`(?P<rest>.*?)(, got `[^`]*`)?", text)
    ) is not None:
        kinds = [part for part in kind[1].split(" | ") if part != "null"]
        if "float" in kinds and "int" in kinds:
            kinds.remove("int")
        wanted = [_WORDS.get(part, part) for part in kinds]
        return Complaint(steps, " or ".join(wanted) + kind["rest"], describe(value), _hint(value))
    return Complaint(steps, "a usable entry", text, "")


def _hint(value: object) -> str:
    if isinstance(value, bool):
        return "quote it where the text is meant"
    return ""


def _exact(path: str, error: msgspec.ValidationError, data: Any, type_: Any) -> Steps:
    """Resolve msgspec's ``[...]`` ("some key") by keeping one entry at a time."""
    steps: list[str | int] = []
    for match in _STEP.finditer(path):
        if match["field"] is not None:
            steps.append(match["field"])
        elif match["index"] is not None:
            steps.append(int(match["index"]))
        else:
            node = _at(data, tuple(steps))
            if not isinstance(node, dict):
                break
            for key in node:
                data_with_one = _replaced(data, tuple(steps), {key: node[key]})
                if _message(data_with_one, type_) == str(error):
                    steps.append(key)
                    break
            else:
                break
    return tuple(steps)


def _message(data: Any, type_: Any) -> str:
    try:
        msgspec.convert(data, type_, strict=True, str_keys=True)
    except msgspec.ValidationError as error:
        return str(error)
    return ""


def _at(data: Any, steps: Steps) -> Any:
    for step in steps:
        try:
            data = data[step]
        except (LookupError, TypeError):
            return None
    return data


def _replaced(data: Any, steps: Steps, value: Any) -> Any:
    if not steps:
        return value
    head, rest = steps[0], steps[1:]
    copy = data.copy()
    copy[head] = _replaced(data[head], rest, value)
    return copy


def _types(type_: Any, steps: Steps) -> Iterator[inspect.Type]:
    """Yield the possible types at ``steps``."""
    yield from _descend(inspect.type_info(type_), steps)


def _descend(kind: inspect.Type, steps: Steps) -> Iterator[inspect.Type]:
    if isinstance(kind, inspect.UnionType):
        for part in kind.types:
            yield from _descend(part, steps)
    elif isinstance(kind, inspect.Metadata):
        yield from _descend(kind.type, steps)
    elif not steps:
        yield kind
    elif isinstance(kind, inspect.StructType):
        for field in kind.fields:
            if field.encode_name == steps[0]:
                yield from _descend(field.type, steps[1:])
    elif isinstance(kind, inspect.DictType):
        yield from _descend(kind.value_type, steps[1:])
    elif isinstance(kind, inspect.ListType | inspect.VarTupleType):
        yield from _descend(kind.item_type, steps[1:])


def _fields(type_: Any, steps: Steps) -> list[str]:
    names: dict[str, None] = {}
    for kind in _types(type_, steps):
        if isinstance(kind, inspect.StructType):
            names.update((field.encode_name, None) for field in kind.fields)
    return list(names)


def _choices(type_: Any, steps: Steps) -> list[str]:
    choices: list[str] = []
    for kind in _types(type_, steps):
        if isinstance(kind, inspect.LiteralType):
            choices += [str(value) for value in kind.values]
        elif isinstance(kind, inspect.EnumType):
            choices += [str(member.value) for member in kind.cls]
    return choices
