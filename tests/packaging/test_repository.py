"""What the repository says of itself is true, and holds on any machine."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

# In pieces, so that this file does not find itself.
REGISTRIES = re.compile("|".join((r"pypi\.or" + "g", "pythonhoste" + "d", r"registry\.np" + "m")))
MACHINE_PATHS = re.compile(r"(?<![\w.~$}])/(?:wor" + r"k|roo" + r"t|hom" + r"e/\w+|op" + r"t/\w+)/")
ROOMS = ("docs", "dbc", "vehicles", "scenarios", "tests", "benchmarks", "hev_can_emu", r"\.ci")
PATH = re.compile(rf"`((?:{'|'.join(ROOMS)})/[\w./-]+|[\w-]+\.(?:md|toml|lock)|Makefile|LICENSE)`")
LINK = re.compile(r"\]\((?!\w+:)([^)#\s]+)(?:#[^)]*)?\)")
TARGET = re.compile(r"`make ([a-z-]+)")


def tracked(repository: Path) -> list[Path]:
    """Return the files that git tracks; git must be there, as it was to fetch them."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=repository, capture_output=True, text=True, check=True
    )
    return [repository / name for name in listed.stdout.split("\0") if name]


def pages(repository: Path) -> list[Path]:
    return [*sorted(repository.glob("*.md")), *sorted((repository / "docs").rglob("*.md"))]


def test_no_registry_and_no_path_of_one_machine(repository: Path) -> None:
    found = []
    for path in tracked(repository):
        if not path.is_file():
            continue
        for number, line in enumerate(path.read_bytes().splitlines(), 1):
            text = line.decode("utf-8", "replace")
            if REGISTRIES.search(text) or MACHINE_PATHS.search(text):
                found.append(f"{path.relative_to(repository)}:{number}: {text.strip()[:100]}")
    assert found == []


def test_lock_names_no_host(repository: Path) -> None:
    assert "://" not in (repository / "requirements.lock").read_text()


def test_pages_name_only_what_is_there(repository: Path) -> None:
    missing = []
    for page in pages(repository):
        text = page.read_text()
        named = [(repository / name, name) for name in PATH.findall(text)]
        named += [(page.parent / name, name) for name in LINK.findall(text)]
        missing += [f"{page.name}: {name}" for path, name in named if not path.exists()]
    assert missing == []


def test_pages_name_only_targets_of_make(repository: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (repository / "Makefile").read_text(), re.MULTILINE))
    for page in pages(repository):
        assert set(TARGET.findall(page.read_text())) <= targets, page.name


def test_lock_holds_every_dependency_with_hashes(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    wanted = list(project["build-system"]["requires"])
    wanted += project["project"]["dependencies"]
    for group in project["project"]["optional-dependencies"].values():
        wanted += group
    wanted += project["dependency-groups"]["dev"]
    locked: dict[str, list[str]] = {}
    blocks = re.split(r"\n(?=[a-zA-Z0-9])", (repository / "requirements.lock").read_text())
    for block in blocks:
        name, version = re.match(r"([\w.-]+)==([\w.!+]+)", block).groups()  # type: ignore[union-attr]
        assert "--hash=sha256:" in block, name
        locked.setdefault(canonicalize_name(name), []).append(version)
    for text in wanted:
        requirement = Requirement(text)
        versions = locked.get(canonicalize_name(requirement.name))
        assert versions, f"{requirement.name} is not locked: run `make lock`"
        assert all(requirement.specifier.contains(Version(v)) for v in versions), text


def test_changelog_tells_of_this_version(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    headings = re.findall(r"^## \[(.+?)\]", (repository / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings
    assert project["version"] in headings or headings[0] == "Unreleased"


@pytest.mark.parametrize("name", ["dbc", "vehicles", "scenarios"])
def test_checkout_finds_its_own_folders(repository: Path, name: str) -> None:
    from hev_can_emu import resources

    assert resources.folder(name) == repository / name  # type: ignore[arg-type]


def test_other_folders_are_refused() -> None:
    from hev_can_emu import resources

    with pytest.raises(ValueError, match="expected one of dbc, vehicles, scenarios, got 'docs'"):
        resources.folder("docs")  # type: ignore[arg-type]
