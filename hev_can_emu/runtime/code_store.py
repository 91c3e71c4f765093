"""Trouble codes in a file, so that they survive a restart."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Literal

import msgspec

from hev_can_emu.ecu.trouble_codes import TroubleCode
from hev_can_emu.errors import InputError
from hev_can_emu.runtime.emulator import Emulator


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    version: Literal[1]
    codes: tuple[TroubleCode, ...]


def read_store(path: Path) -> list[TroubleCode]:
    """Return the stored codes, none where there is no file yet; raises InputError."""
    try:
        text = path.read_bytes()
    except FileNotFoundError:
        if not path.parent.is_dir():
            got = f"no folder '{path.parent}'"
            raise InputError(str(path), "a file in a folder that exists", got) from None
        return []
    except OSError as error:
        raise InputError(str(path), "a file of trouble codes", error.strerror or "none") from error
    try:
        return list(msgspec.json.decode(text, type=_File).codes)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(str(path), "trouble codes as --dtc-store writes them", reason) from error


class CodeStore:
    """Keeps an emulator's trouble codes in a file.

    Args:
        emulator: whose codes; what the file holds is put into it, as from an earlier operation cycle.
        path: the file.

    Raises:
        InputError: a file that cannot be read as one, or a folder that is not there.

    Attributes:
        strangers: stored codes that this network does not have; they are dropped.
    """

    def __init__(self, emulator: Emulator, path: Path) -> None:
        self._emulator = emulator
        self._path = path
        stored = read_store(path)
        self.strangers = emulator.load_trouble_codes(stored)
        self._saved: list[TroubleCode] | None = None

    def save(self) -> str:
        """Write the file where a code has changed; return what went wrong, on one line, or nothing."""
        codes = self._emulator.trouble_codes
        if codes == self._saved:
            return ""
        # Times are of this run: another one cannot read them.
        kept = tuple(msgspec.structs.replace(code, first_ns=0, last_ns=0) for code in codes)
        text = msgspec.json.format(msgspec.json.encode(_File(1, kept)), indent=1) + b"\n"
        beside = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            beside.write_bytes(text)
            os.replace(beside, self._path)
        except OSError as error:
            with contextlib.suppress(OSError):
                beside.unlink()
            return f"{self._path}: trouble codes not stored: {error.strerror}"
        self._saved = codes
        return ""
