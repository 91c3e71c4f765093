"""A whole control-unit millisecond beside its peers, in one run: python benchmarks/tick.py

The peers are what one would write today: python-can's virtual bus, cantools, an exact NumPy step of the
same 16-DOF plant.  Both sides receive and decode seven requests each 10 ms and send every status message of
hev.dbc at its period; only ours also checks and writes counters and CRCs and runs machines, battery,
shift and supervision.  Rounds are interleaved; the figure is the median.
"""

from __future__ import annotations

import statistics
import time

import can
import cantools
import numpy as np

from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.plant.linear import state_space
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order
from hev_can_emu.resources import folder
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup, load_car

ROUNDS = 7
PEER_MS = 300
OUR_MS = 3000
REQUESTS = {
    "HCU_EngineRequest": {"EngineRunRequest": 0, "EngineTorqueRequest": 0.0},
    "HCU_EM1Request": {"EM1ControlMode": 0, "EM1TorqueRequest": 0.0, "EM1SpeedRequest": 0.0},
    "HCU_EM2Request": {"EM2ControlMode": 1, "EM2TorqueRequest": 50.0, "EM2SpeedRequest": 0.0},
    "HCU_ClutchRequest": {"ClutchTorqueCapacityRequest": 0.0},
    "HCU_SynchronizerRequest": {"GearRequest": 0, "ShiftForceRequest": 0},
    "HCU_BrakeRequest": {"BrakeTorqueRequest": 0.0},
    "HCU_HVRequest": {"ContactorRequest": 1},
}


class Peers:
    """python-can virtual + cantools + NumPy."""

    def __init__(self) -> None:
        self.database = cantools.database.load_file(str(folder("dbc") / "hev.dbc"))
        parameters, _, _, _ = load_car("dai2024")
        a, b = state_space(full_order(parameters), CONFIGURATIONS["electric_neutral"])
        from scipy.linalg import expm

        nx, nu = b.shape
        block = np.zeros((nx + nu, nx + nu))
        block[:nx, :nx], block[:nx, nx:] = a * 1e-3, b * 1e-3
        step = expm(block)
        self.ad, self.bd = step[:nx, :nx].copy(), step[:nx, nx:].copy()
        self.x, self.u = np.zeros(nx), np.zeros(nu)
        self.messages = []
        for message in self.database.messages:
            if message.senders[0] == "HCU" or not message.cycle_time:
                continue
            values = {
                s.name: s.offset
                if s.minimum is None
                else max(s.minimum, min(0.0, s.maximum or 0.0))
                for s in message.signals
            }
            self.messages.append((message, values, message.cycle_time))
        self.tx = can.Bus(interface="virtual", channel="bench")
        self.rx = can.Bus(interface="virtual", channel="bench")
        codec = NamedCodec(Emulator(Setup()).database)
        self.requests = [
            can.Message(
                arbitration_id=self.database.get_message_by_name(name).frame_id,
                data=codec.encode_message(name, values),
                is_extended_id=False,
            )
            for name, values in REQUESTS.items()
        ]
        self.now = 0

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            if self.now % 10 == 0:
                for message in self.requests:
                    self.rx.send(message)
            while (received := self.tx.recv(0)) is not None:
                decoded = self.database.decode_message(received.arbitration_id, received.data)
                self.u[2] = decoded.get("EM2TorqueRequest", self.u[2])
            self.x = self.ad @ self.x + self.bd @ self.u
            for phase, (message, values, period) in enumerate(self.messages):
                if (self.now + phase) % period == 0:
                    data = message.encode(values, strict=False)
                    self.tx.send(
                        can.Message(
                            arbitration_id=message.frame_id, data=data, is_extended_id=False
                        )
                    )
            while self.rx.recv(0) is not None:
                pass
            self.now += 1


class Ours:
    """The emulator; requests arrive as frames with counter and CRC, made ahead of time."""

    def __init__(self) -> None:
        player = Emulator(Setup(nodes={"HCU": "emulated"}))
        for name, values in REQUESTS.items():
            for signal, value in values.items():
                player.set_value(player.database.signal_index(name, signal), value)
        sent = player.advance((ROUNDS + 2) * 2 * OUR_MS * 1_000_000)
        ids = [player.database.message(name).can_id for name in REQUESTS]
        self.frames = sent[np.isin(sent["id"], ids)].copy()
        self.frames["flags"] = 0
        self.instants = self.frames["t_ns"].copy()
        self.emulator = Emulator(Setup())
        self.emulator.advance(0)
        self.at = 0

    def _next(self, until_ns: int) -> np.ndarray:
        end = int(np.searchsorted(self.instants, until_ns))
        part = self.frames[self.at : end]
        self.at = end
        return part

    def one_call_per_ms(self, milliseconds: int) -> None:
        emulator = self.emulator
        for _ in range(milliseconds):
            until = emulator.now_ns + 1_000_000
            part = self._next(until)
            emulator.advance(until, part, len(part))

    def one_call(self, milliseconds: int) -> None:
        until = self.emulator.now_ns + milliseconds * 1_000_000
        part = self._next(until)
        self.emulator.advance(until, part, len(part))


def main() -> None:
    """Print microseconds per simulated millisecond, and the ratios."""
    peers, ours = Peers(), Ours()
    peers.run(20)
    ours.one_call(100)
    rows: dict[str, list[float]] = {"peers": [], "call per ms": [], "one call": []}
    for _ in range(ROUNDS):
        for name, run, count in (
            ("peers", peers.run, PEER_MS),
            ("call per ms", ours.one_call_per_ms, OUR_MS),
            ("one call", ours.one_call, OUR_MS),
        ):
            start = time.perf_counter()
            run(count)
            rows[name].append((time.perf_counter() - start) / count * 1e6)
    base = statistics.median(rows["peers"])
    for name, values in rows.items():
        cost = statistics.median(values)
        print(
            f"{name:<14} {cost:9.2f} us per ms {1000 / cost:9.1f} x real time {base / cost:8.1f} x peers"
        )
    peers.tx.shutdown()
    peers.rx.shutdown()


if __name__ == "__main__":
    main()
