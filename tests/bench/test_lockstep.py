"""Controllers in other processes step with the car: C, races, and partners that fail."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from controllers import HoldSpeed, Partner

from hev_can_emu.bus.open import open_lockstep_bus
from hev_can_emu.bus.socketcand import SocketcandBus
from hev_can_emu.cli import main
from hev_can_emu.errors import BusError, InputError
from hev_can_emu.runtime.testbench import SyncTestbench, Testbench

COMMAND = Path(sys.executable).parent / "hev-can-emu"
EXAMPLE = Path(__file__).parents[2] / "examples" / "lockstep.c"


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the C example, compiled."""
    compiler = shutil.which("gcc")
    assert compiler, "tests need gcc"
    made = tmp_path_factory.mktemp("c") / "controller"
    flags = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-D_POSIX_C_SOURCE=200809L"]
    subprocess.run([compiler, *flags, "-o", made, EXAMPLE], check=True)
    return made


async def run_with(program: Path, seconds: float) -> tuple[str, float, str]:
    """Return trace, speed and what the controller printed, after so long a drive."""
    async with Testbench(model="4dof", partners=1) as bench:
        child = await asyncio.create_subprocess_exec(
            program, str(bench.port), stdout=asyncio.subprocess.PIPE
        )
        await bench.advance(seconds)
        trace, speed = bench.trace, bench["VehicleSpeed"]
    out, _ = await child.communicate()
    assert child.returncode == 0
    return trace, speed, out.decode()


def test_the_c_example_gives_what_the_same_law_gives_in_this_process(controller: Path) -> None:
    trace, speed, out = asyncio.run(run_with(controller, 4.0))
    with SyncTestbench(model="4dof", controller=HoldSpeed()) as bench:
        bench.advance(4.0)
        assert bench.trace == trace
        assert bench["VehicleSpeed"] == speed
    assert speed > 10.0
    assert re.fullmatch(r"40[01] steps, 1\d\.\d\d km/h at the end\n", out)
    assert asyncio.run(run_with(controller, 4.0))[0] == trace


def test_a_scenario_judges_a_controller_in_another_process(
    controller: Path, tmp_path: Path
) -> None:
    path = tmp_path / "hold.yaml"
    path.write_text(
        "version: 1\nname: hold\nduration: 3 s\nmodel: 4dof\nplays: [VEH]\n"
        "expectations: [{becomes: VehicleSpeed > 9 km/h, within: 3 s}]\n"
    )
    arguments = ["scenario", "run", path, "--clock", "lockstep", "--bus", "socketcand:127.0.0.1:0"]
    run = subprocess.Popen(
        [COMMAND, *arguments, "--out", tmp_path / "out", "--no-plot"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert run.stdout is not None
    port = re.search(r"127\.0\.0\.1:(\d+)", run.stdout.readline())
    assert port
    subprocess.run([controller, port[1]], check=True, timeout=60, capture_output=True)
    out = run.stdout.read()
    assert run.wait(60) == 0, out
    assert "hold: PASS" in out
    run.stdout.close()
    told = json.loads((tmp_path / "out" / "hold.json").read_text())
    assert told["clock"] == "lockstep (socketcand:127.0.0.1:0)"
    assert told["car_time_s"] == pytest.approx(3.0, abs=0.002)
    assert len(told["trace"]) == 64


Scene = Callable[[Testbench, list[Partner]], Awaitable[None]]


def play(scene: Scene, *names: str, patience_s: float = 10.0) -> tuple[Testbench, list[Partner]]:
    """Let partners of these names and a bench act out a scene."""

    async def act() -> tuple[Testbench, list[Partner]]:
        async with Testbench(model="4dof", partners=len(names), patience_s=patience_s) as bench:
            partners = [Partner(bench.port, name) for name in names]
            for partner in partners:
                await partner.join()
            await scene(bench, partners)
        for partner in partners:
            await partner.leave()
        return bench, partners

    return asyncio.run(act())


def ids(bench: Testbench) -> list[int]:
    frames = bench._log.between(0, 1 << 62)
    return [int(frame["id"]) for frame in frames if frame["id"] >= 0x7F0]


@pytest.mark.parametrize("first", [0, 1])
def test_whoever_is_faster_the_order_is_by_name(first: int) -> None:
    async def scene(bench: Testbench, partners: list[Partner]) -> None:
        time = asyncio.create_task(bench.advance("30 ms"))
        by_name = sorted(partners, key=lambda each: each.name)
        for _ in range(3):
            for place in (first, 1 - first):
                partner = by_name[place]
                now = await partner.now()
                partner.say(f"< send 7F{2 * place} 1 0{place} >< send 7F{2 * place + 1} 0 >")
                partner.say(f"< done {now + 10_000_000} >")
                if place == first:  # the other one speaks only once this has been taken
                    await partner.settle()
        await time
        for partner in partners:
            await partner.now()

    bench, (alpha, beta) = play(scene, "alpha", "beta")
    assert ids(bench) == [0x7F0, 0x7F1, 0x7F2, 0x7F3] * 3
    # Each hears the other, not itself.
    assert sum("< frame 7F2" in text for text in alpha.heard) == 3
    assert not any("< frame 7F0" in text for text in alpha.heard)
    assert sum("< frame 7F0" in text for text in beta.heard) == 3


def test_frames_carry_the_car_s_time_and_partners_may_take_unlike_steps() -> None:
    async def scene(bench: Testbench, partners: list[Partner]) -> None:
        slow, fast = partners
        time = asyncio.create_task(bench.advance("100 ms"))
        await slow.now()
        slow.say("< done 50000000 >")
        for step in range(10):
            assert await fast.now() == step * 10_000_000
            fast.say(f"< done {(step + 1) * 10_000_000} >")
            if step == 5:
                assert await slow.now() == 50_000_000
                slow.say("< done 100000000 >")
        await time
        assert await slow.now() == await fast.now() == 100_000_000

    bench, (slow, fast) = play(scene, "slow", "fast")
    assert bench.now_s == pytest.approx(0.1)
    stamps = [float(text.split()[3]) for text in fast.heard if text.startswith("< frame 190")]
    assert stamps == pytest.approx([0.007 + 0.01 * step for step in range(len(stamps))])
    assert len(stamps) >= 9
    assert {len(text) for text in fast.heard if text.startswith(("< frame", "< now"))} == {64}
    assert sum(text.startswith("< now") for text in slow.heard) == 3


async def answer_once(bench: Testbench, partners: list[Partner]) -> None:
    await partners[0].now()
    partners[0].say("< done 10000000 >")
    with pytest.raises(BusError, match=r"'hcu' has not said done for 0.2 s at 0.010 s"):
        await bench.advance("1 s")


async def leave(bench: Testbench, partners: list[Partner]) -> None:
    await partners[0].now()
    partners[0].say("< done 10000000 >")
    task = asyncio.create_task(bench.advance("1 s"))
    await partners[0].now()
    await partners[0].leave()
    with pytest.raises(BusError, match=r"partner 'hcu' left at 0.010 s"):
        await task


@pytest.mark.parametrize("scene", [answer_once, leave])
def test_a_partner_that_fails_ends_the_run(scene: Scene) -> None:
    play(scene, "hcu", patience_s=0.2)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("< done soon >", "expected a time in ns after done"),
        ("< done -5 >", "expected a time in ns after done"),
        ("< done 0 >", "expected done beyond 0, got 0"),
        ("< lockstep again >", "expected lockstep once"),
        ("< done 10000000 >< done 99999999999999999999 >", "expected a time in ns after done"),
    ],
)
def test_a_partner_that_breaks_the_protocol_is_told_and_dropped(words: str, complaint: str) -> None:
    async def scene(bench: Testbench, partners: list[Partner]) -> None:
        task = asyncio.create_task(bench.advance("1 s"))
        await partners[0].now()
        partners[0].say(words)
        while not (text := await partners[0].hear()).startswith("< error"):
            pass
        assert complaint in text
        with pytest.raises(BusError, match="partner 'hcu' left"):
            await task

    play(scene, "hcu")


def test_the_uninvited_are_refused_and_do_no_harm() -> None:
    async def scene(bench: Testbench, partners: list[Partner]) -> None:
        guest, twin = Partner(bench.port, "guest"), Partner(bench.port, "hcu")
        for each, word in ((guest, "lockstep-refused"), (twin, "expected a name of its own")):
            await each.join()
            assert word in await each.hear()
            await each.leave()
        task = asyncio.create_task(bench.advance("20 ms"))
        for step in (1, 2):
            await partners[0].now()
            partners[0].say(f"< done {step * 10_000_000} >")
        await task
        assert bench.now_s == pytest.approx(0.02)

    play(scene, "hcu")


def test_a_server_of_wall_time_says_that_it_waits_for_nobody() -> None:
    async def ask() -> str:
        async with SocketcandBus(lambda: 0, port=0, beacon=False) as bus:
            partner = Partner(bus.port, "hcu")
            await partner.join()
            text = await partner.hear()
            await partner.leave()
            return text

    assert "lockstep-refused:this-server-keeps-wall-time" in asyncio.run(ask())


@pytest.mark.parametrize(
    ("spec", "partners", "complaint"),
    [
        ("socketcan:vcan0", 1, "only the embedded server can let time wait"),
        ("socketcand", 0, "--partners: expected 1 to 64, got 0"),
    ],
)
def test_what_cannot_keep_lockstep_is_told(spec: str, partners: int, complaint: str) -> None:
    with pytest.raises(InputError) as told:
        open_lockstep_bus(spec, lambda: 0, partners, 1.0)
    assert complaint in str(told.value)


def test_lockstep_without_an_end_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--clock", "lockstep"]) == 2
    assert "--duration: expected a time, with --clock lockstep" in capsys.readouterr().err
    lockstep = ["run", "--clock", "lockstep", "--duration", "1"]
    assert main([*lockstep, "--mqtt", "mqtt://localhost"]) == 2
    told = capsys.readouterr().err
    assert told == "hev-can-emu: --mqtt: expected the wall's clock, got --clock lockstep\n"
    assert main([*lockstep, "--vin", "X"]) == 2
    assert "--vin: expected --mqtt beside it" in capsys.readouterr().err
