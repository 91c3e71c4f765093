"""Every example of docs/scenarios.md loads against the shipped network, plays, and passes."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.messages.database import load_database
from hev_can_emu.scenario.expression_compiler import FUNCTIONS
from hev_can_emu.scenario.signals import Signals

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "scenarios.md").read_text()
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def clutch(t: float) -> float:
    return 0.0 if t < 2.2 else 1.0 if t < 3.0 else 2.0


BUS = {
    "VehicleSpeed": lambda t: 6.0 * t,
    "WheelSpeedFL": lambda t: 6.0 * t,
    "WheelSpeedFR": lambda t: 6.0 * t + 0.1,
    "EM1Speed": 1000.0,
    "EM2Speed": lambda t: 100.0 * t,
    "ClutchState": clutch,
    "ClutchSlipSpeed": lambda t: 800.0 * math.exp(-5.0 * max(t - 2.2, 0.0)),
    "Gear": 1.0,
    "DrivingMode": lambda t: 1.0 if t < 2.2 else 0.0 if t < 3.0 else 2.0,
}


@pytest.fixture(scope="module")
def network() -> Signals:
    return Signals(load_database(ROOT / "dbc" / "hev.dbc").messages)


def test_the_page_has_examples() -> None:
    assert len(EXAMPLES) == 5


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_example(number: int, network: Signals, bench: Any) -> None:
    bench.signals = network
    player = bench.play(EXAMPLES[number], BUS)
    bad = [verdict for verdict in player.verdicts() if verdict.outcome.value != "pass"]
    assert bad == []
    assert len(player.verdicts()) >= 5


def test_speed_matching_follows_the_wheel(network: Signals, bench: Any) -> None:
    bench.signals = network
    bench.play(EXAMPLES[2], BUS)
    sent = {ms: value for ms, name, value in bench.sent if name == "EM1SpeedRequest"}
    assert sent[2000] == pytest.approx(12 / 3.6 / 0.32 * 9.1 * 30 / math.pi)


def test_counters_and_checksums_are_not_a_scenarios_to_set(network: Signals, bench: Any) -> None:
    bench.signals = network
    with pytest.raises(InputError) as caught:
        bench.load("duration: 1 s\nsteps:\n- {at: 0 s, set: {HCU_HVRequest_Counter: 3}}")
    assert str(caught.value).endswith(
        "expected a signal to set, got 'HCU_HVRequest_Counter'; "
        "the protection of HCU_HVRequest writes it"
    )


def test_the_page_tells_every_function() -> None:
    for name in FUNCTIONS:
        assert f"`{name}(" in PAGE


def test_the_complaint_on_the_page_is_the_real_one(network: Signals, bench: Any) -> None:
    bench.signals = network
    text = EXAMPLES[0].replace("EM2TorqueRequest: 0 Nm", "EM2TorqeRequest: 0 Nm")
    with pytest.raises(InputError) as caught:
        bench.load(text)
    told = re.search(r"```text\n(.*?)\n```", PAGE, re.DOTALL)
    assert told is not None
    assert str(caught.value) == told[1].replace("launch.yaml", "s.yaml").replace("\n", " ")
