"""A scenario file checked against a network: every text finds its meaning.

All errors that a scenario can have are found here, before anything is played.
"""

from __future__ import annotations

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario import schema
from hev_can_emu.scenario.expectation_compiler import ExpectationCompiler
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import Program, Tables
from hev_can_emu.scenario.sources import Sources
from hev_can_emu.scenario.step_compiler import StepCompiler
from hev_can_emu.scenario.stimulus_compiler import StimulusCompiler
from hev_can_emu.scenario.values import Values
from hev_can_emu.scenario.window_compiler import WindowCompiler


def compile_scenario(
    scenario: schema.Scenario, sources: Sources, place: Place, tick_ns: int
) -> Program:
    """Check ``scenario`` against what there is and return it ready to play.

    Raises:
        InputError: at ``place`` and below: the first thing that cannot be.
    """
    values = Values(sources, scenario.parameters, place / "parameters")
    duration_ns = values.time(scenario.duration, place / "duration")
    if duration_ns == 0:
        raise (place / "duration").refuse("a time above 0 s", f"'{scenario.duration}'")
    if scenario.plays != schema.DEFAULT_PLAYS:
        senders = set(sources.signals.messages.values())
        for number, node in enumerate(scenario.plays):
            if node not in senders:
                hint = did_you_mean(node, sorted(senders))
                raise (place / "plays" / number).refuse("a node that sends", f"'{node}'", hint)
    tables = Tables()
    stimuli = StimulusCompiler(values, scenario.plays, tables)
    phases = {}
    for key, length_ns in (("setup", None), ("steps", duration_ns), ("teardown", None)):
        phases[key] = StepCompiler(values, stimuli, tables, length_ns)
        phases[key].take(getattr(scenario, key), place / key)
    windows = WindowCompiler(values, phases["steps"], duration_ns)
    compiler = ExpectationCompiler(values, windows, tick_ns)
    watches = tuple(
        compiler.watch(number, each, place / "expectations" / number)
        for number, each in enumerate(scenario.expectations)
    )
    for name in scenario.parameters:
        if name in values.unused:
            hint = "remove it"
            raise (place / "parameters" / name).refuse("a parameter in use", f"'{name}'", hint)
    return Program(
        name=scenario.name,
        duration_ns=duration_ns,
        setup=tuple(phases["setup"].steps),
        steps=tuple(phases["steps"].steps),
        teardown=tuple(phases["teardown"].steps),
        watches=watches,
        columns=values.scope.columns,
        tables=tables,
    )
