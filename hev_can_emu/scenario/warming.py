"""Calls the scenario kernels that Python itself calls, so that they are compiled."""

from __future__ import annotations

import numpy as np

from hev_can_emu.plant.events import EVENT
from hev_can_emu.scenario.evaluation import CONSTANT, build
from hev_can_emu.scenario.expression import over_rows
from hev_can_emu.scenario.script import bind_perform, mark_events, no_script
from hev_can_emu.scenario.weighting import weigh, weighting_filter


def warm_scenario_kernels() -> None:
    """Compile them, or load them from the cache."""
    script, vector = no_script(), np.zeros(1)
    bind_perform(script)
    mark_events(script, np.zeros(1, dtype=EVENT), 0, 0)
    code = build([(CONSTANT, 1.0)])
    over_rows(code, np.zeros((1, 1)))
    sections = weighting_filter("Wk", 1e-3)
    weigh(sections, np.zeros((len(sections), 2)), vector)
