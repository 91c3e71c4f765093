"""What cannot be built is refused in one line: where, expected, got, hint."""

from __future__ import annotations

from pathlib import Path

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ({"model": "17dof"}, ["--model", "4dof", "17dof"]),
        ({"vehicle": "dai2025"}, ["--vehicle", "dai2025", "dai2024"]),
        ({"vehicle": "no/such.yaml"}, ["no/such.yaml"]),
        ({"protection": "enforced"}, ["--protection", "enforced", "enforce"]),
        ({"start": "hot"}, ["--start", "hot"]),
        ({"nodes": {"MCU3": "external"}}, ["--node", "MCU3", "MCU2"]),
        ({"nodes": {"MCU2": "extern"}}, ["--node MCU2", "extern", "external"]),
        ({"dbc": "no/such.dbc"}, ["no/such.dbc"]),
        ({"bindings": "no/such.yaml"}, ["no/such.yaml"]),
        ({"reduction": "guess"}, ["--reduction", "guess"]),
        ({"state_of_charge": 1.5}, ["state of charge", "1.5"]),
        ({"state_of_charge": float("nan")}, ["state of charge", "nan"]),
    ],
)
def test_a_bad_choice_is_one_line(choice: dict[str, object], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        Emulator(Setup(**choice))  # type: ignore[arg-type]
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("EM2Torqe: external_em2_torque", ["EM2Torqe", "EM2Torque"]),
        ("EM2Torque: external_em3_torque", ["external_em3_torque", "external_em2_torque"]),
        ("EM2Torque: em2_torque", ["em2_torque", "status port"]),
        ("EM2Speed: external_em2_torque", ["rpm", "N m"]),
    ],
)
def test_bindings_that_do_not_fit_are_located(
    tmp_path: Path, repository: Path, line: str, words: list[str]
) -> None:
    text = (repository / "dbc" / "hev.bindings.yaml").read_text()
    assert text.count("      EM2Torque: external_em2_torque") == 1
    broken = tmp_path / "broken.yaml"
    broken.write_text(text.replace("EM2Torque: external_em2_torque", line))
    with pytest.raises(InputError) as caught:
        Emulator(Setup(bindings=str(broken)))
    message = str(caught.value)
    assert "\n" not in message
    assert f"broken.yaml:{text[: text.index('external_em2_torque')].count(chr(10)) + 1}" in message
    for word in words:
        assert word in message


def test_unknown_names_at_run_time() -> None:
    emulator = Emulator(Setup(model="4dof"))
    with pytest.raises(InputError, match="EM2Torque"):
        emulator.signal("EM2Torqe")
    with pytest.raises(InputError, match="em2_torque"):
        emulator.truth("em2_torqe")
