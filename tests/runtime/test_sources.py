"""The hashes that name the cache's folders follow from the sources, with a table of them and without."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from hev_can_emu.sources import Sources


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "car"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "alone.py").write_text("A = 1\n")
    (folder / "inner" / "__init__.py").write_text("")
    (folder / "inner" / "user.py").write_text("from car.alone import (\n    A,  # one\n)\n")
    return folder


@pytest.fixture
def later(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = time.time_ns() + 10_000_000_000
    monkeypatch.setattr("hev_can_emu.sources.time.time_ns", lambda: now_ns)


def digests(package: Path) -> dict[str, str]:
    found = Sources(package, b"version").digests(package.parent)
    assert found == {module: Sources(package, b"version").digest(module) for module in found}
    return found


def tables(package: Path) -> list[Path]:
    return sorted(package.parent.glob("sources-*.json"))


def changed(before: dict[str, str], after: dict[str, str]) -> set[str]:
    return {name for name in before | after if before.get(name) != after.get(name)}


@pytest.mark.usefixtures("later")
def test_a_change_reaches_what_imports_it_and_nothing_else(package: Path) -> None:
    before = digests(package)
    assert set(before) == {"__init__", "alone", "inner", "inner.user"}
    assert digests(package) == before
    assert len(tables(package)) == 1
    # As long as before, and said to be as old: as a careful tool would leave it.
    status = (package / "alone.py").stat()
    (package / "alone.py").write_text("A = 2\n")
    os.utime(package / "alone.py", ns=(status.st_atime_ns, status.st_mtime_ns))
    after = digests(package)
    assert changed(before, after) == {"alone", "inner.user"}
    assert len(tables(package)) == 2
    (package / "inner" / "user.py").write_text("B = 1\n")
    assert changed(after, digests(package)) == {"inner.user"}


@pytest.mark.usefixtures("later")
def test_a_name_that_becomes_a_module_counts(package: Path) -> None:
    (package / "inner" / "user.py").write_text("from car.inner import more\n")
    before = digests(package)
    (package / "inner" / "more.py").write_text("C = 1\n")
    assert changed(before, digests(package)) == {"inner.user", "inner.more"}


@pytest.mark.usefixtures("later")
@pytest.mark.parametrize("damaged", [b"", b"{", b"[]", b"\0" * 99, b'"text"'])
def test_a_damaged_table_is_made_anew(package: Path, damaged: bytes) -> None:
    before = digests(package)
    (table,) = tables(package)
    whole = table.read_bytes()
    table.write_bytes(damaged)
    assert digests(package) == before
    assert table.read_bytes() == whole


def test_files_just_written_leave_no_table(package: Path) -> None:
    assert set(digests(package)) == {"__init__", "alone", "inner", "inner.user"}
    assert tables(package) == []


@pytest.mark.usefixtures("later")
def test_what_else_the_code_follows_from_counts(package: Path) -> None:
    assert Sources(package, b"other").digests(package.parent)["alone"] != digests(package)["alone"]
    assert digests(package)["alone"] == Sources(package, b"version").digest("alone")


@pytest.mark.usefixtures("later")
def test_a_folder_that_cannot_be_written_costs_time_alone(package: Path) -> None:
    found = Sources(package, b"version").digests(package.parent / "none")
    assert found == digests(package)
