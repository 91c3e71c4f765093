"""The built wheel, used from a folder and an account that own nothing."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from hev_can_emu.jit import cache_home

# One worker builds and installs the wheel once for all tests of this file.
pytestmark = [pytest.mark.wheel, pytest.mark.xdist_group("wheel")]

FOLDERS = ("dbc", "vehicles", "scenarios")


def run(command: Sequence[str | Path], **options: object) -> subprocess.CompletedProcess[str]:
    """Run a command to its end and return what it printed; fail with that if it fails."""
    done: subprocess.CompletedProcess[str] = subprocess.run(  # type: ignore[call-overload]
        command, **({"capture_output": True, "text": True, "timeout": 300} | options)
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture(scope="session")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built through the source distribution as a release would be."""
    out = tmp_path_factory.mktemp("dist")
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", out, repository])
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment's bin folder: the wheel, and the locked dependencies of this one."""
    root = tmp_path_factory.mktemp("fresh") / "env"
    venv.create(root, with_pip=False)
    paths = {"base": str(root), "platbase": str(root)}
    packages = Path(sysconfig.get_path("purelib", "venv", vars=paths))
    # A path file inside the folder it names is not read: the editable installation stays out.
    (packages / "locked.pth").write_text(sysconfig.get_path("purelib") + "\n")
    python = root / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet"]
    run([*pip, "--no-index", "--no-deps", "--force-reinstall", wheel])
    return root / "bin"


@pytest.fixture(scope="session")
def kernels() -> str:
    """The checkout's cache of compiled kernels, which the same code elsewhere can use, too."""
    return str(cache_home().parent)


def environment(bin_folder: Path, scratch: Path, **changes: str) -> dict[str, str]:
    """Return an environment whose home is not there and cannot be made, not even by root."""
    kept = {key: os.environ[key] for key in ("LANG", "LC_ALL") if key in os.environ}
    path = f"{bin_folder}{os.pathsep}{os.defpath}"
    return kept | {"PATH": path, "HOME": "/dev/null/home", "TMPDIR": str(scratch)} | changes


def test_wheel_holds_the_package_its_data_and_nothing_else(wheel: Path, repository: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
        tops = {name.split("/")[0] for name in names}
        assert {top for top in tops if not top.endswith(".dist-info")} == {"hev_can_emu"}
        assert "hev_can_emu/py.typed" in names
        assert any(name.endswith("licenses/LICENSE") for name in names)
        for folder in FOLDERS:
            shipped = {
                name.removeprefix("hev_can_emu/_data/"): archive.read(name)
                for name in names
                if name.startswith(f"hev_can_emu/_data/{folder}/")
            }
            there = {
                path.relative_to(repository).as_posix(): path.read_bytes()
                for path in (repository / folder).rglob("*")
                if path.is_file() and "__pycache__" not in path.parts
            }
            assert shipped == there
            assert shipped


def test_installed_package_is_the_wheel_s_and_finds_its_data(
    installed: Path, tmp_path: Path
) -> None:
    program = "from hev_can_emu import resources as r\nprint(r.__file__, *map(r.folder, {!r}))"
    done = run(
        [installed / "python", "-c", program.format(FOLDERS)],
        cwd="/",
        env=environment(installed, tmp_path),
    )
    assert all(str(installed.parent) in path for path in done.stdout.split())


@pytest.mark.parametrize(
    "command",
    [
        ["--help"],
        ["--version"],
        ["run", "--bus", "socketcand:127.0.0.1:0", "--duration", "0.3"],
        ["scenario", "run", "series_parallel"],
        ["modes"],
    ],
    ids=" ".join,
)
def test_command_works_from_the_root_without_a_home(
    installed: Path, kernels: str, tmp_path: Path, command: list[str]
) -> None:
    done = run(
        [installed / "hev-can-emu", *command],
        cwd="/",
        env=environment(installed, tmp_path, HEV_CAN_EMU_CACHE=kernels),
        stdin=subprocess.DEVNULL,
    )
    assert "Traceback" not in done.stderr


def test_kernels_compile_where_no_cache_can_be_kept(installed: Path, tmp_path: Path) -> None:
    # A kernel needs a source file; it goes where only this test's interpreter looks for it.
    source = tmp_path / "site" / "probe.py"
    source.parent.mkdir()
    source.write_text(
        "from hev_can_emu.jit import kernel\n\n@kernel\ndef twice(x):\n    return 2.0 * x\n"
    )
    program = "import probe\nprint(probe.twice(21.0))"
    done = run(
        [installed / "python", "-c", program],
        cwd="/",
        env=environment(installed, tmp_path, PYTHONPATH=str(source.parent)),
    )
    assert done.stdout.strip() == "42.0"
