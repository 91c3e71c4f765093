"""What a vehicle file may ask of the detailed model beyond the shipped car: firing ripple, play in meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.cli import main
from hev_can_emu.errors import InputError
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.car import Car
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

MS = 1_000_000
PLAY = """  mesh_play:
    kid: {value: 0.1, unit: mm, source: plausible}
"""
RIPPLE = "  firing_ripple: true\n"


@pytest.fixture(scope="module")
def vehicle(
    repository: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, str, str], str]:
    """Write the shipped car with some lines more at its end, and some text of it replaced."""
    text = (repository / "vehicles" / "dai2024.yaml").read_text(encoding="utf-8")
    assert "firing_ripple" not in text
    assert "mesh_play" not in text

    def write(more: str, old: str = "", new: str = "") -> str:
        assert old in text
        file = tmp_path_factory.mktemp("vehicle") / "car.yaml"
        file.write_text((text.replace(old, new) if old else text) + more, encoding="utf-8")
        return str(file)

    return write


def _charging(vehicle: str) -> Emulator:
    """Return the car at rest, its engine fired at 1200 1/min behind EM1, where ripple outdoes the pistons."""
    emulator = Emulator(Setup(model="detailed", vehicle=vehicle, nodes={"HCU": "emulated"}))
    for name, value in (
        ("ContactorRequest", 1.0),
        ("EM1ControlMode", 2.0),
        ("EM1SpeedRequest", 1560.0),
        ("ClutchTorqueCapacityRequest", 200.0),
        ("EngineRunRequest", 1.0),
        ("EngineTorqueRequest", 80.0),
    ):
        emulator.set_value(emulator.database.signal(name).index, value)
    emulator.advance(3000 * MS)
    assert emulator.truth("clutch_held") == 1.0
    emulator.take_events()
    return emulator


def _engine_speed(emulator: Emulator) -> np.ndarray:
    rows = []
    for _ in range(300):
        emulator.advance(emulator.now_ns + MS)
        rows.append(emulator.truth("engine_speed"))
    return np.array(rows)


def test_a_car_with_ripple_and_play_shakes_and_rattles(vehicle: Callable[..., str]) -> None:
    plain, rough = _charging("dai2024"), _charging(vehicle(PLAY + RIPPLE))
    calm, shaken = _engine_speed(plain), _engine_speed(rough)
    assert shaken.mean() == pytest.approx(calm.mean(), rel=0.02)
    # Two firings in a turn: that order stands out of the engine's speed.
    count = len(shaken)
    spectrum = np.abs(np.fft.rfft((shaken - shaken.mean()) * np.hanning(count)))
    frequency = np.fft.rfftfreq(count, 1e-3)[int(np.argmax(spectrum))]
    assert frequency == pytest.approx(shaken.mean() / np.pi, rel=0.05)
    assert np.ptp(shaken) > 3.0 * np.ptp(calm)
    # Teeth that rattle are for the bench to tell: they would drown all else.
    assert [event for event in rough.take_events() if event.kind == "teeth"] == []
    ledger = rough.ledger()
    assert ledger["gas"] != 0.0
    assert ledger["meshes"] > 0.0
    assert abs(ledger.residue) < 2e-4 * ledger.moved


def test_effects_go_before_the_file(vehicle: Callable[..., str]) -> None:
    setup = Setup(model="detailed", vehicle=vehicle(PLAY + RIPPLE))
    told = Car(setup).plant
    assert list(told.extras.mesh_half) == [5e-5]
    none = Car(setup, Effects(firing_ripple=False, mesh_play={})).plant
    default = Car(Setup(model="detailed")).plant
    assert not np.array_equal(told.engine, default.engine)
    assert np.array_equal(none.engine, default.engine)
    assert len(none.extras.mesh) == 0


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (
            PLAY.replace("kid", "kif"),
            r"detailed\.mesh_play: expected one of km1, .*did you mean 'kid'",
        ),
        (PLAY.replace("kid", "klh"), r"detailed\.mesh_play: expected one of km1, .* got 'klh'"),
        (
            PLAY.replace("mm", "m"),
            r"mesh_play\.kid: expected a play above 0, up to 5 mm, got 100 mm",
        ),
        (PLAY.replace("0.1", "0"), r"mesh_play\.kid: expected a play above 0, up to 5 mm, got 0"),
        (PLAY.replace("mm", "rad"), r"mesh_play\.kid\.unit: expected a unit of m, got 'rad'"),
        (
            PLAY + "".join(PLAY.splitlines(True)[1].replace("kid", k) for k in ("kg1", "kg2")),
            r"mesh_play: expected at most 2 meshes, got 3",
        ),
        (RIPPLE.replace("true", "3"), r"detailed\.firing_ripple: expected true or false, got 3"),
        ("  firing_riple: true\n", r"did you mean 'firing_ripple'\?"),
    ],
)
def test_what_cannot_be_is_refused_on_one_line(
    vehicle: Callable[..., str], more: str, told: str
) -> None:
    with pytest.raises(InputError, match=told) as caught:
        Car(Setup(model="detailed", vehicle=vehicle(more)))
    assert "\n" not in str(caught.value)


def test_ripple_needs_the_engines_pulses(
    vehicle: Callable[..., str], capsys: pytest.CaptureFixture[str], repository: Path
) -> None:
    text = (repository / "vehicles" / "dai2024.yaml").read_text(encoding="utf-8")
    begin = text.index("    pulses:\n")
    pulses = text[begin : text.index("  em1:\n", begin)]
    file = vehicle(RIPPLE, pulses, "")
    expected = "$.detailed.firing_ripple: expected false, or the engine's pulses"
    assert main(["scenario", "run", "first_launch", "--model", "detailed", "--vehicle", file]) == 2
    assert expected in capsys.readouterr().err
    # The bench says so as well, where the file itself does not ask for it.
    quiet = Setup(model="detailed", vehicle=vehicle("", pulses, ""))
    with pytest.raises(InputError, match=r"effects\.firing_ripple"):
        Bench(quiet, Effects(firing_ripple=True))
