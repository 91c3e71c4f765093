"""Where the files that ship with the package lie.

In an installed wheel they are inside the package (``hev_can_emu/_data/dbc`` and so on); in a
checkout they are the folders at the repository's root.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

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
