"""Decoded signals and truth as CSV and Parquet: what pandas reads is what was on the bus."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import cantools
import numpy as np
import pandas as pd
import pytest
from recorded import DBC, network, recorded

from hev_can_emu.errors import InputError
from hev_can_emu.messages.frame import frame
from hev_can_emu.telemetry.reading import read_recording
from hev_can_emu.telemetry.recorder import TABLES, open_recorder


def write(path: Path) -> None:
    run = recorded()
    with open_recorder(path, network=run.network) as recorder:
        assert recorder.takes_truth
        start = 0
        for t_ns, truth in zip(run.truth_ns, run.truth, strict=True):
            stop = int(np.searchsorted(run.frames["t_ns"], t_ns))
            recorder.write(run.frames[start:stop], stop - start)
            recorder.write_truth(t_ns, truth)
            start = stop


def table(path: Path) -> dict[str, list[float | None]]:
    """Return the columns as pandas reads them, without units: None where a cell is empty."""
    if path.suffix == ".parquet":
        found = pd.read_parquet(path, dtype_backend="pyarrow")
        return {name: found[name].array.__arrow_array__().to_pylist() for name in found}
    found = pd.read_csv(path, dtype=str, keep_default_na=False)
    return {
        head.partition(" [")[0]: [float(cell) if cell else None for cell in found[head]]
        for head in found
    }


def filled(found: dict[str, list[float | None]], name: str) -> tuple[list[float], list[float]]:
    """Return instants and values of the filled cells of a column."""
    pairs = zip(found["time_s"], found[name], strict=True)
    there = [(t, value) for t, value in pairs if value is not None]
    return [t for t, _ in there], [value for _, value in there]


@pytest.fixture(scope="module", params=TABLES)
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("tables") / f"run{request.param}"
    write(made)
    return made


def test_every_signal_is_what_cantools_decodes(path: Path) -> None:
    database = cantools.database.load_file(DBC)
    found = table(path)
    for name in ("MCU2_Status", "ESC_Vehicle", "BMS_Status", "HCU_EM2Request", "VEH_Road"):
        message = database.get_message_by_name(name)
        frames = recorded().frames
        frames = frames[frames["id"] == message.frame_id]
        assert len(frames) >= 20
        decoded = [message.decode(bytes(f["data"][:8]), decode_choices=False) for f in frames]
        for signal in message.signals:
            instants, values = filled(found, f"{name}.{signal.name}")
            assert instants == pytest.approx(frames["t_ns"] * 1e-9, abs=1e-9)
            for value, row in zip(values, decoded, strict=True):
                raw = round((row[signal.name] - signal.offset) / signal.scale)
                missing = raw == (1 << signal.length) - 1 and math.isnan(value)
                assert missing or value == pytest.approx(row[signal.name], rel=1e-12)


def test_the_truth_is_beside_the_signals(path: Path) -> None:
    found = table(path)
    instants, speeds = filled(found, "truth.vehicle_speed")
    run = recorded()
    place = list(run.network.truth).index("vehicle_speed")
    assert speeds == pytest.approx(run.truth[:, place], rel=1e-14)
    assert instants == pytest.approx(run.truth_ns * 1e-9)
    assert speeds[-1] > 0.1
    times = found["time_s"]
    assert all(a < b for a, b in itertools.pairwise(times))


def test_units_are_told(path: Path) -> None:
    if path.suffix == ".csv":
        heads = path.read_text().splitlines()[0].split(",")
        assert {"ESC_Vehicle.VehicleSpeed [km/h]", "truth.vehicle_speed [m/s]"} <= set(heads)
    else:
        from pyarrow import parquet

        schema = parquet.read_schema(path)
        assert schema.field("ESC_Vehicle.VehicleSpeed").metadata == {b"unit": b"km/h"}
        assert schema.field("truth.vehicle_speed").metadata == {b"unit": b"m/s"}


def test_the_frames_come_back_to_the_byte(path: Path) -> None:
    run = recorded()
    back = read_recording(path, run.network)
    for frames in (back, expected := run.frames.copy()):
        frames.sort(order=["t_ns", "id"])
    for field in ("t_ns", "id", "length", "data"):
        assert np.array_equal(back[field], expected[field]), field


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("t,x\n1,2\n", "expected a first column time_s, got 't'"),
        ("", "expected a first column time_s, got nothing"),
        (
            "time_s,ESC_Vehicle.VehicleSped\n0,1\n",
            "expected columns that are signals, got 'ESC_Vehicle.VehicleSped'; did you mean "
            "'ESC_Vehicle.VehicleSpeed'",
        ),
        ("time_s,VehicleSpeed\n0,1\n0.1,fast\n", "line 3: expected numbers, got could not"),
        ("time_s,VehicleSpeed\n0,1,2\n", "line 2: expected 2 columns, got 3"),
        ("time_s,VehicleSpeed\n", "expected frames, got none"),
    ],
)
def test_a_bad_csv_is_told_in_one_line(text: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError) as told:
        read_recording(path, network())
    assert str(told.value).startswith(str(path))
    assert complaint in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.kernels
def test_a_hand_written_table_is_enough(tmp_path: Path) -> None:
    """Counter and CRC that are left out are sent as what the network calls not available."""
    path = tmp_path / "hand.csv"
    path.write_text("time_s,EM2TorqueRequest [Nm],EM2ControlMode\n0.5,12.5,1\n1.25,,\n2,-3,1\n")
    frames = read_recording(path, network())
    assert frames["t_ns"].tolist() == [500_000_000, 2_000_000_000]
    message = cantools.database.load_file(DBC).get_message_by_name("HCU_EM2Request")
    told = [message.decode(bytes(f["data"][:8]), decode_choices=False) for f in frames]
    assert [row["EM2TorqueRequest"] for row in told] == [12.5, -3.0]


@pytest.mark.kernels
@pytest.mark.parametrize("ending", TABLES)
def test_a_message_twice_at_one_instant_makes_two_rows(ending: str, tmp_path: Path) -> None:
    frames = np.concatenate(
        [
            frame(0xA0, bytes(range(8)), 1_000_000),
            frame(0xA0, bytes(range(8, 16)), 1_000_000),
            frame(0x7FF, bytes(8), 1_000_000),  # unknown
            frame(0xB0, bytes(7), 2_000_000),  # too short
            frame(0xC0, bytes(8), 2_000_000),
        ]
    )
    path = tmp_path / f"run{ending}"
    with open_recorder(path, network=network()) as recorder:
        recorder.write(frames, 5)
    back = read_recording(path, network())
    assert back["id"].tolist() == [0xA0, 0xA0, 0xC0]
    assert back["t_ns"].tolist() == [1_000_000, 1_000_000, 2_000_000]
    message = cantools.database.load_file(DBC).get_message_by_name("HCU_BrakeRequest")
    assert [message.decode(bytes(f["data"][:8])) for f in back[:2]] == [
        message.decode(bytes(range(8))), message.decode(bytes(range(8, 16)))
    ]  # fmt: skip
