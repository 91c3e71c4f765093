"""A scenario file checked against a network: every text finds its meaning.

All errors that a scenario can have are found here, before anything is played.
"""

from __future__ import annotations

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario import schema
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import Program
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.step_compiler import StepCompiler
from hev_can_emu.scenario.values import Values
from hev_can_emu.scenario.window_compiler import WindowCompiler


def compile_scenario(scenario: schema.Scenario, signals: Signals, place: Place) -> Program:
    """Check ``scenario`` against the network and return it ready to play.

    Raises:
        InputError: at ``place`` and below: the first thing that cannot be.
    """
    values = Values(signals, scenario.parameters, place / "parameters")
    duration_ns = values.time(scenario.duration, place / "duration")
    if duration_ns == 0:
        raise (place / "duration").refuse("a time above 0 s", f"'{scenario.duration}'")
    if scenario.plays != schema.DEFAULT_PLAYS:
        senders = set(signals.messages.values())
        for number, node in enumerate(scenario.plays):
            if node not in senders:
                hint = did_you_mean(node, sorted(senders))
                raise (place / "plays" / number).refuse("a node that sends", f"'{node}'", hint)
    step_compiler = StepCompiler(values, scenario.plays, duration_ns)
    steps = tuple(
        step_compiler.step(number, step, place / "steps" / number)
        for number, step in enumerate(scenario.steps)
    )
    window_compiler = WindowCompiler(values, step_compiler, duration_ns)
    watches = tuple(
        window_compiler.watch(number, each, place / "expectations" / number)
        for number, each in enumerate(scenario.expectations)
    )
    for name in scenario.parameters:
        if name in values.unused:
            hint = "remove it"
            raise (place / "parameters" / name).refuse("a parameter in use", f"'{name}'", hint)
    return Program(scenario.name, duration_ns, steps, watches)
