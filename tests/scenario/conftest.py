from __future__ import annotations

import pytest
from scenario_bench import Bench, make_messages

from hev_can_emu.scenario.signals import Signals


@pytest.fixture(scope="session")
def signals() -> Signals:
    return Signals(make_messages())


@pytest.fixture
def bench(signals: Signals) -> Bench:
    return Bench(signals)
