"""Lateness in constant memory: quantiles within a bin of the truth."""

from __future__ import annotations

import numpy as np
import pytest

from hev_can_emu.runtime.statistics import Histogram, Statistics


@pytest.mark.parametrize("scale", [5e3, 3e5, 4e7], ids=["us", "ms", "s"])
def test_quantiles_are_within_a_bin(scale: float) -> None:
    durations = np.random.default_rng(1).exponential(scale, 5000).astype(int)
    histogram = Histogram()
    for duration in durations.tolist():
        histogram.add(duration)
    assert histogram.total == 5000
    assert histogram.largest_us == durations.max() * 1e-3
    for share in (0.1, 0.5, 0.99, 1.0):
        true = float(np.quantile(durations, share, method="inverted_cdf")) * 1e-3
        assert histogram.quantile_us(share) == pytest.approx(true, rel=0.0325, abs=1.0)


def test_nothing_negative_and_huge_durations_are_counted() -> None:
    histogram = Histogram()
    assert (histogram.quantile_us(0.5), histogram.largest_us) == (0.0, 0.0)
    for duration in (-5, 0, 10**18):
        histogram.add(duration)
    assert histogram.total == 3
    assert histogram.quantile_us(0.5) < 1.0
    assert histogram.largest_us == 1e15


def test_description_tells_of_stalls_only_if_there_were_any() -> None:
    statistics = Statistics(ticks=3)
    statistics.lateness.add(2_000_000)
    assert "stalls" not in statistics.describe()
    assert "2000 us (most)" in statistics.describe()
    statistics.stalls, statistics.stalled_ns = 2, 3_000_000_000
    assert "2 stalls (3.0 s)" in statistics.describe()
