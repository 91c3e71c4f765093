"""From a scenario file to the runs that it asks for: includes, overrides, the matrix."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from hev_can_emu.config import Document, Steps
from hev_can_emu.config.include import Parts, read_with_includes
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.scenario.expectation_schema import Value
from hev_can_emu.scenario.schema import Scenario

MAX_RUNS = 1000  #: of one file's matrix
#: What of a scenario's head a matrix can vary.
HEAD = ("vehicle", "model", "start", "seed")
INCLUDED = Parts(
    mappings=("parameters",),
    lists=("setup", "steps", "teardown", "expectations"),
    ignored=("version", "description"),
)


class Run(NamedTuple):
    """One run of a scenario file.

    Attributes:
        document: the file, with what it includes.
        scenario: its content; parameters and head are those of this run.
        label: what sets it apart from the other runs of the matrix; empty where there is one.
        locate: turns a path in the scenario into its place in the file.
    """

    document: Document
    scenario: Scenario
    label: str
    locate: Callable[[Steps], str]


def read_scenario(path: Path) -> tuple[Document, Scenario]:
    """Read a scenario file with what it includes; raises InputError."""
    document = read_with_includes(path, INCLUDED)
    return document, document.convert(Scenario)


def setup_of(scenario: Scenario, base: Setup | None = None) -> Setup:
    """Return the setup that a scenario's head asks for; what it leaves open is the base's, or the default."""
    owners: dict[str, str] = dict.fromkeys(scenario.plays, "emulated")
    changes: dict[str, Any] = {
        key: value for key in ("vehicle", "model", "start") if (value := getattr(scenario, key))
    }
    return msgspec.structs.replace(base or Setup(), nodes=owners | scenario.nodes, **changes)


def read_runs(
    path: Path, parameters: Mapping[str, str] | None = None, head: Collection[str] = ()
) -> list[Run]:
    """Read a scenario file and return its runs, in the order of the matrix, its last key fastest.

    Args:
        path: of the file.
        parameters: values that replace those of the file, and take their names out of the matrix.
        head: fields of the head that are told elsewhere; they leave the matrix, too.

    Raises:
        InputError: the file cannot be used; a parameter that it does not have.
    """
    document, scenario = read_scenario(path)
    given = parameters or {}
    for name in given:
        if name not in scenario.parameters:
            hint = did_you_mean(name, scenario.parameters)
            raise InputError("--set", f"a parameter of {path}", f"'{name}'", hint)
    _check(document, scenario, scenario.matrix)
    told = {*given, *head}
    matrix = {key: values for key, values in scenario.matrix.items() if key not in told}
    runs = []
    for numbers in itertools.product(*(range(len(values)) for values in matrix.values())):
        chosen = dict(zip(matrix, numbers, strict=True))
        picked = {key: matrix[key][number] for key, number in chosen.items()}
        label = ", ".join(f"{key}={value}" for key, value in picked.items())
        changed = _changed(document, scenario, {**given, **picked}, label, chosen)
        locate = _locator(document, chosen, given)
        runs.append(Run(document, changed, label, locate))
    return runs


def _check(document: Document, scenario: Scenario, matrix: Mapping[str, tuple[Value, ...]]) -> None:
    count = 1
    for key, values in matrix.items():
        count *= len(values)
        if key not in scenario.parameters and key not in HEAD:
            known = [*scenario.parameters, *HEAD]
            hint = did_you_mean(key, known) or f"of the head: {', '.join(HEAD)}"
            where = document.where(("matrix", key))
            raise InputError(where, "a parameter or a field of the head", f"'{key}'", hint)
        for number, value in enumerate(values):
            if value in values[:number]:
                where = document.where(("matrix", key, number))
                raise InputError(where, "each value once", f"'{value}' again")
    if count > MAX_RUNS:
        where = document.where(("matrix",))
        raise InputError(where, f"at most {MAX_RUNS} runs", f"{count}", "split the matrix")


def _changed(
    document: Document,
    scenario: Scenario,
    values: Mapping[str, Value],
    label: str,
    chosen: Mapping[str, int],
) -> Scenario:
    """Return the scenario with these parameters and fields of the head."""
    parameters = dict(scenario.parameters)
    head: dict[str, Value] = {}
    for key, value in values.items():
        if key in parameters:
            parameters[key] = value
        else:
            head[key] = value
    for key, value in head.items():
        fits = isinstance(value, int if key == "seed" else str) and not isinstance(value, bool)
        if not fits or (key == "start" and value not in ("ready", "off")):
            where = document.where(("matrix", key, chosen[key]))
            wanted = {"seed": "a whole number", "start": "one of ready, off"}.get(key, "text")
            raise InputError(where, wanted, f"'{value}'")
    name = f"{scenario.name} [{label}]" if label else scenario.name
    changes: dict[str, object] = {"parameters": parameters, "name": name, **head}
    return msgspec.structs.replace(scenario, **changes)


def _locator(
    document: Document, chosen: Mapping[str, int], given: Mapping[str, str]
) -> Callable[[Steps], str]:
    """Return ``document.where``, but for what stands in the matrix or on the command line."""

    def locate(steps: Steps) -> str:
        name = steps[1] if len(steps) > 1 and steps[0] == "parameters" else None
        if isinstance(name, str) and name in given:
            return f"--set {name}"
        if isinstance(name, str) and name in chosen:
            return document.where(("matrix", name, chosen[name]))
        if len(steps) == 1 and steps[0] in chosen:
            return document.where(("matrix", steps[0], chosen[str(steps[0])]))
        return document.where(steps)

    return locate
