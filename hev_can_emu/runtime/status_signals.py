"""Which signal carries a status port on this network, and back: what pictures and reports look up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.messages.definitions import SignalDef
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.signal_log import SignalLog
from hev_can_emu.units import unit

_PLACES = {port.name: place for place, port in enumerate(ports.STATUSES)}


def status_signal(emulator: Emulator, port: str) -> SignalDef | None:
    """Return the signal that carries a status port; None where no message does."""
    found = np.flatnonzero(emulator.constants.ties.tx_port == _PLACES[port])
    if not found.size:
        return None
    return emulator.database.signals[int(emulator.constants.ties.tx_signal[found[0]])]


def status_on_grid(
    emulator: Emulator, log: SignalLog, port: str, t_s: npt.NDArray[np.float64], unit_name: str
) -> npt.NDArray[np.float64]:
    """Return a status port at given instants as the bus told it; see :func:`status_in`."""
    signal = status_signal(emulator, port)
    if signal is None:
        return np.full(len(t_s), np.nan)
    return status_in(emulator, port, log.on_grid(signal.qualified_name, t_s), unit_name)


def status_in(
    emulator: Emulator, port: str, told: npt.NDArray[np.float64], unit_name: str
) -> npt.NDArray[np.float64]:
    """Return the values of a port's signal in a unit, or as the port's codes whatever the network calls them.

    NaN where the bus told nothing, or no signal carries the port.
    """
    ties = emulator.constants.ties
    found = np.flatnonzero(ties.tx_port == _PLACES[port])
    if not found.size:
        return np.full(len(told), np.nan)
    tie = int(found[0])
    start, stop = int(ties.tx_map_start[tie]), int(ties.tx_map_stop[tie])
    if start == stop:
        wanted = unit(unit_name)
        gain, offset = ties.tx_gain[tie] * wanted.gain, ties.tx_offset[tie]
        # In the network's own unit the values stay as they are, to the last bit.
        same = abs(gain - 1.0) < 1e-12 and offset == -wanted.offset / wanted.gain
        return told if same else np.asarray((told - offset) / gain - wanted.offset / wanted.gain)
    codes = np.full(len(told), np.nan)
    for i in range(start, stop):
        codes[told == ties.map_value[i]] = ties.map_code[i]
    return codes
