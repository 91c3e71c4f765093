"""Teeth, pistons and dampers in the driveline's step, against what is known without it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hev_can_emu.commands._components.small import MESH, Stand, two_inertias
from hev_can_emu.plant import teeth
from hev_can_emu.plant.bank import build_bank
from hev_can_emu.plant.crank import CrankParameters, reciprocating_energy
from hev_can_emu.plant.driveline import energy
from hev_can_emu.plant.holding import HELD, MESH_EVENT, PARTED, SIDE, TOUCHED
from hev_can_emu.plant.structure import G1

INERTIAS = (0.2, 0.3)
REDUCED = INERTIAS[0] * INERTIAS[1] / sum(INERTIAS)
STEP = 5e-5


def _dogs(gap: float, slip: float, half: float = 0.01) -> Stand:
    stand = Stand(two_inertias(*INERTIAS, between=G1), STEP, 6, toothed=True)
    stand.x[:2] = 50.0 + slip, 50.0
    stand.static[G1] = np.inf
    stand.books[teeth.HALF], stand.books[teeth.GAP] = half, gap
    return stand


def test_teeth_fly_through_their_play_and_rebound_without_loss() -> None:
    # No damping: between the flanks 2h at speed v, on each flank half a swing, pi*sqrt(J/k).
    stiffness, play, speed = 4e4, 0.01, 2.0
    structure = two_inertias(*INERTIAS, stiffness=stiffness, joined=True)
    stand = Stand(structure, STEP, 6, play=play)
    stand.x[0] = speed
    start = energy(stand.bank, stand.x, stand.state)
    while stand.t_ns < 100_000_000:
        stand.advance()
    swing = math.pi * math.sqrt(REDUCED / stiffness)
    expected = [(TOUCHED, play / 2 / speed)]
    while len(expected) < 9:
        kind, instant = expected[-1]
        later = instant + (swing if kind == TOUCHED else play / speed)
        expected.append((PARTED if kind == TOUCHED else TOUCHED, later))
    told = stand.record[:9]
    assert told["index"].tolist() == [MESH_EVENT] * 9
    assert told["kind"].tolist() == [kind for kind, _ in expected]
    assert told["t_ns"] * 1e-9 == pytest.approx([t for _, t in expected], abs=1e-5)
    assert energy(stand.bank, stand.x, stand.state) == pytest.approx(start, rel=1e-3)


def test_dogs_cross_their_play_and_take_each_other_along() -> None:
    stand = _dogs(gap=-0.01, slip=4.0)
    while stand.count == 0:
        stand.advance()
    assert int(stand.record[0]["kind"]) == TOUCHED
    assert stand.record[0]["t_ns"] * 1e-9 == pytest.approx(0.02 / 4.0, abs=1e-6)
    common = (INERTIAS[0] * 54.0 + INERTIAS[1] * 50.0) / sum(INERTIAS)
    assert stand.x[:2] == pytest.approx([common, common])
    assert stand.books[teeth.LOST_DOGS] == pytest.approx(0.5 * REDUCED * 16.0)
    assert stand.state[SIDE] == 1


def test_dogs_push_but_never_pull() -> None:
    stand = _dogs(gap=0.01, slip=1e-3)
    stand.torques = (5.0, 0.0)
    for _ in range(100):
        stand.advance()
    assert stand.state[HELD + G1] == 1
    assert stand.x[0] == pytest.approx(stand.x[1])
    # The torque turns: they part at once and cross the play under it alone.
    turned = stand.t_ns
    stand.torques = (-5.0, 0.0)
    before = stand.count
    while stand.count < before + 2:
        stand.advance()
    parted, touched = stand.record[before : before + 2]
    assert (int(parted["kind"]), int(touched["kind"])) == (PARTED, TOUCHED)
    assert int(parted["t_ns"]) == turned
    flight = math.sqrt(2.0 * 0.02 / (5.0 / INERTIAS[0]))
    assert (touched["t_ns"] - turned) * 1e-9 == pytest.approx(flight, abs=2e-6)
    assert stand.state[SIDE] == -1


def test_dogs_that_come_in_take_over_from_the_cone() -> None:
    stand = Stand(two_inertias(*INERTIAS, between=G1), STEP, 6, toothed=True)
    stand.kinetic[G1] = stand.static[G1] = 20.0
    stand.x[:2] = 50.0
    stand.torques = (5.0, 0.0)
    stand.advance()
    assert stand.state[HELD + G1] == 1
    stand.kinetic[G1], stand.static[G1] = 0.0, np.inf
    stand.books[teeth.HALF] = 0.01
    stand.advance()
    assert stand.state[HELD + G1] == 0
    assert stand.x[0] > stand.x[1]


def test_what_a_damper_takes_is_what_the_swing_loses() -> None:
    structure = two_inertias(*INERTIAS, stiffness=4e4, damping=3.0, joined=True)
    bank = build_bank(structure, STEP, 6, travel=True, dampers=True)
    stand = Stand(structure, STEP, 6, toothed=True)
    stand.bank = bank
    stand.extras = teeth.build_extras(structure, bank, np.zeros(0), damper_work=True)
    stand.x[0] = 2.0
    start = energy(bank, stand.x, stand.state)
    for _ in range(400):
        stand.advance()
    lost = start - energy(bank, stand.x, stand.state)
    assert lost > 0.1 * start
    assert stand.books[teeth.DAMPERS] == pytest.approx(lost, rel=1e-6)


def test_pistons_neither_make_nor_take_energy_on_an_elastic_shaft() -> None:
    structure = two_inertias(*INERTIAS, stiffness=2e4, joined=True)
    crank = CrankParameters(reciprocating_mass=0.42, radius=0.0424, rod_length=0.14).pack()
    stand = Stand(structure, STEP, 6, toothed=True)
    stand.extras = teeth.build_extras(structure, stand.bank, crank)
    stand.x[:2] = 300.0

    def total() -> float:
        angle = float(stand.books[teeth.ANGLE])
        kept = reciprocating_energy(crank, angle, float(stand.x[0]))
        return float(energy(stand.bank, stand.x, stand.state)) + kept

    start = total()
    for _ in range(2000):
        stand.advance()
    assert total() == pytest.approx(start, rel=1e-11)
    assert abs(stand.books[teeth.CRANK_WORK]) > 1.0  # it has been at work
    assert abs(stand.x[0] - stand.x[1]) > 1e-3


def test_a_mesh_that_is_none_is_told() -> None:
    structure = two_inertias(*INERTIAS, joined=True)
    assert teeth.parting(structure, {MESH: 0.01}) == [0]
    with pytest.raises(KeyError):
        teeth.parting(structure, {"kg3": 0.01})


@pytest.mark.parametrize("built", [{"travel": True}, {"dampers": True}, {}])
def test_damper_work_needs_a_bank_that_gives_the_rates(built: dict[str, bool]) -> None:
    structure = two_inertias(*INERTIAS, stiffness=4e4, damping=3.0, joined=True)
    bank = build_bank(structure, STEP, 2, **built)
    with pytest.raises(ValueError, match="expected one built with travel and dampers"):
        teeth.build_extras(structure, bank, np.zeros(0), damper_work=True)


def test_play_needs_a_bank_whose_mesh_may_part() -> None:
    structure = two_inertias(*INERTIAS, stiffness=4e4, damping=3.0, joined=True)
    bank = build_bank(structure, STEP, 2, travel=True)
    play = {structure.branch_names[0]: 1e-3}
    with pytest.raises(ValueError, match=r"expected one built with open_branches=\[0\]"):
        teeth.build_extras(structure, bank, np.zeros(0), play)
