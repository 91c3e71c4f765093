"""Files of the user's cache folder: there as a whole, or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

CHECK = 32  #: bytes before the content: its SHA-256


def read_kept(path: Path) -> memoryview | None:
    """Return the content of a kept file, not copied; None where there is none, or it is damaged."""
    try:
        whole = memoryview(path.read_bytes())
    except OSError:
        return None
    content = whole[CHECK:]
    return content if hashlib.sha256(content).digest() == whole[:CHECK] else None


def keep(
    path: Path, content: bytes, alike: str = "", most: int = 0, check: bytes | None = None
) -> None:
    """Write a file in one piece, so that no other process reads half of it; do nothing where that fails.

    Args:
        path: of the file, in a folder that should be there.
        content: what to write.
        alike: pattern of the names of files beside it that count as alike; none of them counts if empty.
        most: how many of those may stay, the newest.
        check: what stands before the content, of CHECK bytes; the SHA-256 that :func:`read_kept` asks for
            if None.
    """
    import tempfile  # takes a millisecond, and is seldom needed

    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(check or hashlib.sha256(content).digest())
                file.write(content)
            os.replace(name, path)
        except OSError:  # no room
            os.unlink(name)
            raise
        if alike:
            entries = sorted(path.parent.glob(alike), key=lambda each: each.stat().st_mtime)
            for old in entries[:-most]:
                old.unlink()
