"""Where the files that ship with the package lie.

In an installed wheel they are inside the package (``hev_can_emu/_data/dbc`` and so on); in a
checkout they are the folders at the repository's root.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from hev_can_emu.errors import InputError, did_you_mean

Folder = Literal["dbc", "vehicles", "scenarios"]

_PACKAGE = Path(__file__).resolve().parent


def folder(name: Folder) -> Path:
    """Return the folder ``name`` of the shipped files.

    Raises:
        ValueError: ``name`` is not one of the shipped folders.
        FileNotFoundError: the installation lacks the folder.
    """
    if name not in get_args(Folder):
        raise ValueError(f"expected one of {', '.join(get_args(Folder))}, got {name!r}")
    places = (_PACKAGE / "_data" / name, _PACKAGE.parent / name)
    for place in places:
        if place.is_dir():
            return place
    raise FileNotFoundError(
        f"no folder {name!r} at {places[0]} or {places[1]}; reinstall hev-can-emu"
    )


def shipped_or_path(name: str, place: Path, option: str) -> Path:
    """Return ``name`` as a path where it is one, else the shipped YAML file of that name.

    Raises:
        InputError: neither exists; ``option`` is blamed.
    """
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1 or path.exists():
        return path
    known = sorted(file.stem for file in place.glob("*.yaml"))
    if name not in known:
        hint = did_you_mean(name, known) or f"shipped: {', '.join(known)}"
        raise InputError(option, "a file, or the name of a shipped one", f"'{name}'", hint)
    return place / f"{name}.yaml"
