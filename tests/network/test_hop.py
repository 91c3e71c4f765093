"""Port to signal to frame to signal to port: what a hop over the bus costs in accuracy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hev_can_emu import config
from hev_can_emu.ecu import ports, ties
from hev_can_emu.ecu.bindings import (
    Bindings,
    requests_from_signals,
    resolve,
    signals_from_statuses,
)
from hev_can_emu.messages.codec import build_codec, decode, encode
from hev_can_emu.messages.database import load_database

ROOT = Path(__file__).parents[2] / "dbc"
NETWORK = load_database(ROOT / "hev.dbc")
CODEC = build_codec(NETWORK)
RESOLVED = resolve(config.load(ROOT / "hev.bindings.yaml", Bindings), NETWORK)


def over_the_bus(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return what a receiver of every message reads, and how many values were clipped."""
    received = np.full(values.size, -1.0)
    scratch = np.empty(values.size)
    clipped = 0
    for message in NETWORK.messages:
        data = np.zeros(8, dtype=np.uint8)
        clipped += encode(CODEC, message.index, values, data, scratch)
        decode(CODEC, message.index, data, received)
    return received, clipped


def test_every_status_arrives_within_half_a_step() -> None:
    generator = np.random.default_rng(20)
    statuses = np.empty(len(ports.STATUSES))
    for _ in range(20):
        for tie, port in enumerate(RESOLVED.tx_port):
            signal = NETWORK.signals[RESOLVED.tx_signal[tie]]
            assert signal.minimum is not None
            assert signal.maximum is not None
            value = generator.uniform(signal.minimum, signal.maximum)
            if len(signal.labels) > 1:
                value = np.round(value)
            statuses[port] = (value - RESOLVED.tx_offset[tie]) / RESOLVED.tx_gain[tie]
        values = np.zeros(len(NETWORK.signals))
        signals_from_statuses(RESOLVED, statuses, values)
        received, clipped = over_the_bus(values)
        assert clipped == 0
        for index in RESOLVED.tx_signal:
            signal = NETWORK.signals[index]
            assert abs(received[index] - values[index]) <= 0.5 * signal.scale + 1e-9, signal.name


def test_not_available_arrives_as_not_available_in_every_port() -> None:
    values = np.full(len(NETWORK.signals), np.nan)
    statuses = np.full(len(ports.STATUSES), np.nan)
    signals_from_statuses(RESOLVED, statuses, values)
    received, _ = over_the_bus(values)
    requests = np.zeros(len(ports.REQUESTS))
    outside = RESOLVED._replace(
        node_ownership=np.full_like(RESOLVED.node_ownership, ties.OWNER_EXTERNAL)
    )
    for message in NETWORK.messages:
        requests_from_signals(outside, message.index, received, requests)
    carried = [port for port in range(len(requests)) if port not in ports.TESTER_REQUESTS]
    assert np.isnan(requests[carried]).all()


def test_excess_is_clipped_never_not_available() -> None:
    for excess in (-1e9, 1e9):
        statuses = np.full(len(ports.STATUSES), excess)
        values = np.zeros(len(NETWORK.signals))
        signals_from_statuses(RESOLVED, statuses, values)
        received, clipped = over_the_bus(values)
        assert clipped == len(ports.STATUSES)
        for index in RESOLVED.tx_signal:
            signal = NETWORK.signals[index]
            limit = signal.minimum if excess < 0 else signal.maximum
            assert abs(received[index] - limit) < 1e-9, signal.name
