"""A car's frames on the bus over two seconds, and what decoded signals of it mean."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hev_can_emu.messages.codec import build_codec
from hev_can_emu.messages.database import load_database
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.recording import network_of
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.telemetry.table import Network

DBC = Path(__file__).parents[2] / "dbc" / "hev.dbc"


class Recorded(NamedTuple):
    """Frames, and the truth every 10 ms: instants and samples."""

    network: Network
    frames: np.ndarray
    truth_ns: np.ndarray
    truth: np.ndarray


@cache
def network() -> Network:
    """Return what the shipped network's signals mean, without a car."""
    database = load_database(DBC)
    return Network(database, build_codec(database))


@cache
def recorded() -> Recorded:
    """Return what a car says while EM2 pulls; every node is emulated or played."""
    car = Emulator(Setup(model="4dof", nodes={"HCU": "emulated"}))
    signal = car.database.signal
    car.set_value(signal("ContactorRequest").index, 1)
    car.set_value(signal("EM2ControlMode").index, 1)
    car.set_value(signal("EM2TorqueRequest").index, 80.0)
    parts, instants, samples = [], [], []
    for step in range(1, 201):
        parts.append(car.advance(step * 10_000_000).copy())
        instants.append(car.now_ns)
        samples.append(car.state.truth.copy())
    return Recorded(network_of(car), np.concatenate(parts), np.array(instants), np.array(samples))
