"""A recording's requests give the same answers again, from every format; a bus gets all frames in order."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.bus.open import open_bus
from hev_can_emu.cli import main
from hev_can_emu.messages.frame import SENT, frame, make_frames
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.recording import network_of
from hev_can_emu.runtime.replay import BusPlayer, FedBus, frames_of_senders, requesting_setup
from hev_can_emu.runtime.replay import requests_of as requests_to
from hev_can_emu.runtime.service import Service
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.telemetry.reading import read_recording
from hev_can_emu.telemetry.recorder import ENDINGS

SCENARIO = """\
version: 1
name: pull on a hill
duration: 600 ms
model: 4dof
steps:
- at: 100 ms
  set: {ContactorRequest: Closed, EM2ControlMode: Torque, EM2TorqueRequest: 100 Nm, RoadGrade: 4 %}
- at: 400 ms
  set: {EM2TorqueRequest: 20 Nm}
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder with one run in every format, ``run.*``."""
    folder = tmp_path_factory.mktemp("replay")
    path = folder / "run.yaml"
    path.write_text(SCENARIO)
    kinds = [word for ending in ENDINGS for word in ("--record", ending)]
    assert main(["scenario", "run", str(path), "--out", str(folder), "--no-plot", *kinds]) == 0
    return folder


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_car_answers_as_recorded(
    ending: str, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "again.log"
    log = str(recorded / f"run{ending}")
    code = main(
        ["replay", log, "--as-requests", "--compare", "--model", "4dof", "--record", str(again)]
    )
    out = capsys.readouterr().out
    assert code == 0, out
    assert "frames of the car are as recorded" in out
    network = network_of(Emulator(Setup(model="4dof")))
    before, after = read_recording(recorded / "run.log", network), read_recording(again, network)
    for frames in (before, after):
        frames.sort(order=["t_ns", "id"])
    assert np.array_equal(before["data"], after["data"])
    assert np.array_equal(before["t_ns"], after["t_ns"])


def test_another_car_answers_otherwise(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = str(recorded / "run.log")
    assert main(["replay", log, "--as-requests", "--compare"]) == 1
    out = capsys.readouterr().out
    assert "messages differ from the recording" in out
    assert "MCU2_Status: recorded" in out
    assert main(["replay", log, "--as-requests"]) == 0


def test_the_recorded_controller_driver_and_road_take_the_place_of_ours(recorded: Path) -> None:
    setup = Setup(model="4dof")
    frames = read_recording(recorded / "run.log", network_of(Emulator(setup)))
    wanted = requesting_setup(setup, frames)
    assert wanted.nodes == {"VEH": "external"}  # HCU is by itself
    assert requesting_setup(Setup(nodes={"VEH": "emulated"}), frames).nodes == {"VEH": "emulated"}
    requests = requests_to(Emulator(wanted), frames)
    assert set(requests["id"].tolist()) == {0xA0, 0xB0, 0xC0, 0xD0, 0xE0, 0xF0, 0x100, 0x120, 0x400}
    assert not (requests["flags"] & SENT).any()


def test_a_part_and_a_sender_are_chosen(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(recorded / "run.log")
    again = tmp_path / "part.log"
    part = ["--from", "0.2", "--to", "0.3 s", "--record", str(again)]
    assert main(["replay", log, "--as-requests", "--model", "4dof", *part]) == 0
    assert "0.100 s of car time" in capsys.readouterr().out
    network = network_of(Emulator(Setup(model="4dof")))
    frames = read_recording(log, network)
    only = frames_of_senders(network.database, frames, ["BMS"])
    assert set(only["id"].tolist()) == {512, 520}


def complaints() -> Iterator[tuple[list[str], str]]:
    yield ["none.log"], "none.log: expected a recording, got no such file"
    yield ["run.yaml"], "expected a file ending of .log"
    yield ["run.log", "--sender", "HCX"], "--sender: expected one of BMS, EMS"
    yield ["run.log", "--from", "7"], "expected frames in what is asked for, got none"
    yield ["run.log", "--factor", "0"], "expected a number from 0.001 to 1000, got '0'"
    yield ["run.log", "--compare"], "--compare: expected --as-requests beside it, got none"
    yield ["run.log", "--as-requests", "--factor", "2"], "offline there is no pace"
    yield (
        ["run.log", "--as-requests", "--sender", "BMS"],
        "replay --as-requests: expected frames of HCU, got none in the recording",
    )
    yield (
        ["run.log", "--as-requests", "--compare", "--bus", "loopback"],
        "--compare: expected no --bus beside it",
    )


@pytest.mark.parametrize(("arguments", "complaint"), list(complaints()))
def test_misuse_is_told_in_one_line(
    arguments: list[str],
    complaint: str,
    recorded: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(recorded)
    try:
        code = main(["replay", *arguments])
    except SystemExit as end:
        code = end.code
    assert code == 2
    err = capsys.readouterr().err
    assert complaint in err
    assert err.count("\n") == 1


def three_frames() -> np.ndarray:
    return np.concatenate([frame(0x100 + n, bytes([n]), n * 20_000_000) for n in range(3)])


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_a_bus_gets_every_frame_in_order_and_none_too_soon(factor: float) -> None:
    async def play() -> tuple[np.ndarray, float]:
        hub = LoopbackHub()
        clock = asyncio.get_running_loop().time
        reader = hub.endpoint(lambda: round(clock() * 1e9))
        async with reader, hub.endpoint(lambda: 0) as bus:
            player = BusPlayer(bus, three_frames(), factor)
            await player.play()
            assert player.sent == player.lateness.total == 3
            got = make_frames(10)
            return got[: reader.drain(got, 10)], player.lateness.largest_us

    got, latest_us = asyncio.run(play())
    assert got["id"].tolist() == [0x100, 0x101, 0x102]
    # The first frame may have been late, the last one was not early.
    span_us = (got["t_ns"][2] - got["t_ns"][0]) * 1e-3
    assert span_us >= 40_000 / factor - latest_us - 1000


def test_beside_a_bus_the_recording_is_one_more_node(recorded: Path) -> None:
    """The car obeys it, and another program on the bus sees requests and answers."""
    setup = Setup(model="4dof")
    frames = read_recording(recorded / "run.log", network_of(Emulator(setup)))
    car = Emulator(requesting_setup(setup, frames))
    car.advance(0)
    requests = requests_to(car, frames)

    async def serve() -> tuple[Service, np.ndarray]:
        listener = open_bus("loopback:fed", lambda: 0)
        async with listener:
            service = Service(
                car,
                lambda now_ns: FedBus(open_bus("loopback:fed", now_ns), now_ns, requests),
                duration_ns=300_000_000,
            )
            await service.run()
            seen = make_frames(5000)
            return service, seen[: listener.drain(seen, 5000)]

    service, seen = asyncio.run(serve())
    assert service.bus.counters.received >= 150
    assert car.signal("EM2TorqueRequest") == 100.0
    ids = seen["id"].tolist()
    assert ids.count(0xC0) >= 25
    assert ids.count(0x158) >= 25
