"""Whatever stands in a scenario file: it plays, or one InputError says why not."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenario_bench import make_messages

from hev_can_emu import config
from hev_can_emu.errors import InputError
from hev_can_emu.scenario.player import Player
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.script import GO_ON
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.sources import Sources

SIGNALS = Signals(make_messages())
SEED = config.parse(
    """
version: 1
name: seed
duration: 2 s
plays: [HCU, VEH]
nodes: {EMS: silent}
parameters: {a: 3 Nm, b: 4, c: 1 s}
steps:
- {name: one, at: 0 s, set: {EM2TorqueRequest: a, EM2ControlMode: Torque}}
- {name: two, after: 0.1 s, ramp: {EM2TorqueRequest: {from: 0, to: 20 Nm, over: 0.1 s}}}
- {when: VehicleSpeed > b, timeout: c, held: 1 ms, on_timeout: continue, silence: [VEH_Driver]}
- {after: 1 ms, follow: {EM1SpeedRequest: "EM1Speed * 2 + 3 rpm"}, hold: [EM2TorqueRequest]}
- after: 1 ms
  sine: {EM2TorqueRequest: {amplitude: 3, frequency: 2 Hz, offset: 1, phase: 1 deg}}
  release: [EM1SpeedRequest]
  resume: [VEH_Driver]
expectations:
- {always: VehicleSpeed >= 0, from: step one, for: 1 s}
- {never: ClutchState == Open, to: 1 s}
- {becomes: ClutchState == Locked, within: 1 s}
- {settles: {value: EM1Speed, to: 3, band: 1 rpm}, within: 1 s, hold: 0.5 s}
- {equals: {value: EM1Speed, to: 3, tolerance: 1}, at: step two + 0.1 s}
- {sequence: {value: DrivingMode, of: [Series, Transition], exactly: true}}
"""
).data

WORDS = (
    *("1 s", "step one", "end", "EM2TorqueRequest", "EM1Speed", "VehicleSpeed > 3", "t", "Locked"),
    *("", "nan", "1e999 s", "not available", "a", "HCU_EM2Request", "3 rpm", "1/0", "- 1 s", "%"),
)
JUNK = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**12), 10**12)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.sampled_from(WORDS)
    | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from([*WORDS, "to", "over", "value", "of", "at"]), inner)
    ),
    max_leaves=5,
)


def paths(value: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [here]
    if isinstance(value, dict | list):
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in entries:
            found += paths(inner, (*here, key))
    return found


PATHS = paths(SEED)[1:]


def play(data: Any) -> None:
    text = msgspec.json.encode(data).decode()
    try:
        document = config.parse(text)
        player = Player(document.convert(Scenario), Sources(SIGNALS), document.where)
    except InputError as error:
        told = str(error)
    else:
        told = ""
        run(player, data)
    assert "\n" not in told


def run(player: Player, data: Any) -> None:
    values, on_bus, truth = np.zeros(20), np.zeros(20), np.zeros(4)
    seen = np.zeros(20, dtype=np.int64)
    t_ns = 0
    for _ in range(200):
        for _ in range(200):
            player.due(t_ns, values)
            if player.finished or player.look(t_ns, on_bus, seen, truth, values) == GO_ON:
                break
            player.observe()
        if player.ending(t_ns):
            player.end(t_ns)
        later = player.horizon_ns(t_ns)
        assert later > t_ns
        t_ns = min(later, t_ns + 20_000_000) // 1_000_000 * 1_000_000
    player.finish(t_ns, "enough")
    assert len(player.verdicts()) == len(data.get("steps", [])) + len(data.get("expectations", []))


def test_the_seed_plays() -> None:
    play(SEED)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(PATHS), JUNK)
def test_one_wrong_entry(path: tuple[Any, ...], junk: Any) -> None:
    data = copy.deepcopy(SEED)
    node: Any = data
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = junk
    play(data)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(PATHS))
def test_one_missing_entry(path: tuple[Any, ...]) -> None:
    data = copy.deepcopy(SEED)
    node: Any = data
    for key in path[:-1]:
        node = node[key]
    del node[path[-1]]
    play(data)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes(tmp_path_factory: Any, raw: bytes) -> None:
    path = Path(tmp_path_factory.getbasetemp()) / "any.yaml"
    path.write_bytes(raw)
    told = str(path)
    try:
        config.load(path, Scenario)
    except InputError as error:
        told = str(error)
    assert told.startswith(str(path))
