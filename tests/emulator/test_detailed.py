"""The detailed model behind the same messages: the shipped scenario, its ledger, determinism."""

from __future__ import annotations

from pathlib import Path

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.plant.holding import ROW, TOUCHED
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.scenario_runs import read_scenario
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.virtual import play_virtual

MS = 1_000_000


def _driving() -> Emulator:
    emulator = Emulator(Setup(model="detailed", nodes={"HCU": "emulated"}))
    for name, value in (
        ("EM2ControlMode", 1.0),
        ("EM2TorqueRequest", 120.0),
        ("EM1ControlMode", 2.0),
        ("EM1SpeedRequest", 1200.0),
        ("ClutchTorqueCapacityRequest", 150.0),
        ("EngineRunRequest", 1.0),
        ("ContactorRequest", 1.0),
    ):
        emulator.set_value(emulator.database.signal(name).index, value)
    return emulator


@pytest.fixture(scope="module")
def played(repository: Path) -> Playing:
    document, scenario = read_scenario(repository / "scenarios" / "series_parallel.yaml")
    owners = dict.fromkeys(scenario.plays, "emulated") | dict(scenario.nodes)
    playing = Playing(Emulator(Setup(model="detailed", nodes=owners)), document, scenario)
    play_virtual(playing, [])
    return playing


def test_the_shipped_scenario_passes(played: Playing) -> None:
    assert played.player.outcome.value == "pass"


def test_every_joule_of_the_scenario_is_in_the_ledger(played: Playing) -> None:
    ledger = played.emulator.ledger()
    assert ledger.moved > 1e6
    assert abs(ledger.residue) < 1e-6 * ledger.moved
    # Fuel, battery and heat are there, each on its own.
    for name in ("fuel", "exhaust", "em2_copper", "friction_c1", "damper_lw", "air", "kinetic"):
        assert ledger[name] > 0.0
    assert ledger["refused"] == 0.0


def test_what_happens_inside_is_told(played: Playing) -> None:
    emulator = played.emulator
    kinds = {event.kind for event in emulator.take_events()}
    assert {"lock", "release", "teeth", "synchronizer", "mode"} <= kinds
    # Plates warm up by slipping, not with the coolant.
    plates = emulator.truth("clutch_temperature")
    assert plates > 294.0
    assert plates != emulator.truth("coolant_temperature")
    assert emulator.signal("ClutchTemperature") == pytest.approx(plates - 273.15, abs=1.1)


def test_splitting_a_run_or_taking_it_up_again_changes_no_bit() -> None:
    whole, split = _driving(), _driving()
    expected = whole.advance(600 * MS).tobytes()
    got = b"".join(split.advance(until * MS).tobytes() for until in (7, 8, 250, 301, 600))
    assert got == expected
    assert split.snapshot() == whole.snapshot()
    kept = whole.snapshot()
    ahead = whole.advance(800 * MS).tobytes()
    other = _driving()
    other.restore(kept)
    assert other.advance(800 * MS).tobytes() == ahead


def test_a_simpler_model_keeps_no_ledger() -> None:
    with pytest.raises(InputError, match="--ledger: expected --model detailed"):
        Emulator(Setup(model="16dof")).ledger()


def test_meshes_with_play_start_apart_and_close_the_ledger_as_far_as_is_told() -> None:
    bench = Bench(effects=Effects(mesh_play={"kfd": 2e-4}))
    base = len(bench.plant.bank.flow) // 2
    assert bench.n[ROW] == base
    bench.command(em2_mode=1.0, em2_torque=60.0)
    bench.advance(100)
    assert any(event.kind == TOUCHED for event in bench.events)
    ledger = bench.ledger()
    assert ledger is not None
    assert abs(ledger.residue) < 2e-4 * ledger.moved
