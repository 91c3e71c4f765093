"""Controllers for benches: the C example's law in Python, and a bare partner on a socket."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping

import numpy as np

from hev_can_emu.messages.frame import frame, make_frames

PERIOD_NS = 10_000_000


def protect(data_id: int, signals: int, counter: int) -> bytes:
    data = bytearray((signals | (counter % 15) << 8).to_bytes(8, "little"))
    crc = 0
    for byte in (*data_id.to_bytes(2, "little"), *data[1:]):
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    data[0] = crc
    return bytes(data)


class HoldSpeed:
    """Holds EM2 at 30 km/h, byte for byte as examples/lockstep.c does."""

    def __init__(self) -> None:
        self.steps = 0
        self.speed = 0.0

    def exchange(self, t_ns: int, received: np.ndarray) -> np.ndarray:
        for record in received[received["id"] == 0x190]:
            self.speed = int.from_bytes(record["data"][2:4].tobytes(), "little") * 0.01 - 100.0
        torque = min(max(20.0 * (30.0 - self.speed), -120.0), 120.0)
        raw = int((torque + 800.0) * 10.0 + 0.5)
        signals = 1 << 12 | raw << 16 | 16000 << 30 | 511 << 46 | 511 << 55
        sent = [frame(0xC0, protect(8384, signals, self.steps))]
        if self.steps % 2 == 0:
            sent.append(frame(0x100, protect(8448, 1 << 12, self.steps // 2)))
        self.steps += 1
        return np.concatenate(sent)

    def snapshot(self) -> object:
        return self.steps, self.speed

    def restore(self, state: object) -> None:
        self.steps, self.speed = state  # type: ignore[misc]


class Follow:
    """The same law with signals."""

    def step(self, t_s: float, read: Callable[[str], float]) -> Mapping[str, float | str]:
        speed = read("VehicleSpeed")
        torque = 20.0 * (30.0 - (0.0 if speed != speed else speed))
        return {
            "ContactorRequest": "Closed",
            "EM2ControlMode": "Torque",
            "EM2TorqueRequest": min(max(torque, -120.0), 120.0),
        }


class Silent:
    def exchange(self, t_ns: int, received: np.ndarray) -> np.ndarray:
        return make_frames(0)


class Partner:
    """A client of the embedded server that keeps time, as another program would."""

    def __init__(self, port: int, name: str) -> None:
        self.name = name
        self.heard: list[str] = []
        self._port = port

    async def join(self) -> None:
        self._reader, self._writer = await asyncio.open_connection("127.0.0.1", self._port)
        for line in ("< open vcan0 >", "< rawmode >", f"< lockstep {self.name} >"):
            await self.hear()
            self.say(line)

    def say(self, text: str) -> None:
        self._writer.write(text.encode())

    async def hear(self) -> str:
        text = (await self._reader.readuntil(b">")).decode().strip()
        self.heard.append(text)
        return text

    async def now(self) -> int:
        """Return the next instant at which it is this partner's turn."""
        while not (text := await self.hear()).startswith("< now"):
            pass
        return int(text.split()[2])

    async def settle(self) -> None:
        """Return once all that was said before has been taken."""
        self.say("< echo >")
        while await self.hear() != "< echo >":
            pass

    async def leave(self) -> None:
        self._writer.close()
        with contextlib.suppress(ConnectionError):
            await self._writer.wait_closed()
