"""Object files linked into images, which are loaded by copying them and adding addresses.

LLVM loads object files of any kind, but takes longer to be imported than a short run takes.  The code that
Numba makes on x86-64 names nothing but whole addresses, and distances inside itself.  So all its sections
are laid out once, as one piece with every distance filled in; what is left to each process is to add the
address of that piece, and those of the functions that it calls.  Code that asks for more is left to LLVM.

The records are those of the System V application binary interface (ELF-64, and its x86-64 supplement).
"""

from __future__ import annotations

import ctypes
import mmap
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

_PAGE = 4096
_CACHE_LINE = 64
_HEADER = b"\x7fELF\x02\x01\x01"  # 64 bits, little endian, version 1
_RELOCATABLE_X86_64 = (1, 62)
_SYMBOLS, _ADDENDS, _EMPTY, _NO_ADDENDS = 2, 4, 8, 9  # types of sections
_WRITTEN, _ALLOCATED, _PER_THREAD = 1, 2, 0x400  # flags of sections
_UNDEFINED, _COMMON = 0, 0xFFF2  # what a symbol may have in a section's place
_ADDRESS, _DISTANCE = 1, 24  # R_X86_64_64 and R_X86_64_PC64


class Image(NamedTuple):
    """Machine code in one piece.

    Attributes:
        content: its bytes, from a page's start.
        fixed: how many of them, whole pages, are never written to.
        entry: where the function starts.
        needs: names of the functions that it calls.
        places: int64 (2, n), where to add an address, and which one: 0 of the image, i of the i-th need.
    """

    content: bytes | memoryview
    fixed: int
    entry: int
    needs: tuple[str, ...]
    places: npt.NDArray[np.int64]


class _Section(NamedTuple):
    name: int
    type: int
    flags: int
    address: int
    offset: int
    size: int
    link: int
    info: int
    alignment: int
    entry_size: int


class _Symbol(NamedTuple):
    name: str
    section: int
    value: int  #: of a common one its alignment
    size: int


class _Unsuited(Exception):
    """An object file asks for more than this module can do."""


def link(code: bytes, name: str) -> Image | None:
    """Return the image of an object file and its function ``name``; None where that takes a real linker."""
    try:
        return _Linker(code).image(name)
    except (_Unsuited, struct.error, ValueError, IndexError):
        return None


def load(image: Image, addresses: Sequence[int]) -> tuple[int, Any]:
    """Return the address of the image's function in memory, and what holds that memory.

    Args:
        image: as linked.
        addresses: of what it needs.

    Raises:
        OSError: the system lets no memory be executed.
    """
    size = len(image.content)
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    content = np.frombuffer(memory, dtype=np.uint8)
    content[:] = np.frombuffer(image.content, dtype=np.uint8)
    base = content.ctypes.data
    where = image.places[0][:, np.newaxis] + np.arange(8)
    words = (
        content[where].view("<i8") + np.array([base, *addresses])[image.places[1]][:, np.newaxis]
    )
    content[where] = words.view(np.uint8)
    system = ctypes.CDLL(None, use_errno=True)
    rights = mmap.PROT_READ | mmap.PROT_EXEC
    if system.mprotect(ctypes.c_void_p(base), ctypes.c_size_t(image.fixed), rights) != 0:
        raise OSError(ctypes.get_errno(), "no memory may be executed")
    return base + image.entry, content


class _Linker:
    def __init__(self, code: bytes) -> None:
        if code[:7] != _HEADER or struct.unpack_from("<HH", code, 16) != _RELOCATABLE_X86_64:
            raise _Unsuited
        (start,), (count,) = struct.unpack_from("<Q", code, 40), struct.unpack_from("<H", code, 60)
        self._code = code
        self._sections = [
            _Section(*struct.unpack_from("<IIQQQQIIQQ", code, start + 64 * i)) for i in range(count)
        ]
        self._symbols = list(self._read_symbols())
        self._end = 0
        self._starts: dict[int, int] = {}  # of sections in the image

    def _read_symbols(self) -> Any:
        (table,) = [each for each in self._sections if each.type == _SYMBOLS]
        names = self._sections[table.link].offset
        for at in range(table.offset, table.offset + table.size, 24):
            name, _, _, section, value, size = struct.unpack_from("<IBBHQQ", self._code, at)
            end = self._code.index(b"\0", names + name)
            yield _Symbol(self._code[names + name : end].decode(), section, value, size)

    def image(self, name: str) -> Image:
        used = {i: each for i, each in enumerate(self._sections) if each.flags & _ALLOCATED}
        if any(each.flags & _PER_THREAD for each in used.values()):
            raise _Unsuited
        for i, each in used.items():
            if not each.flags & _WRITTEN:
                self._starts[i] = self._place(each.size, max(each.alignment, _CACHE_LINE))
        fixed = self._place(0, _PAGE)
        for i, each in used.items():
            if each.flags & _WRITTEN:
                self._starts[i] = self._place(each.size, each.alignment)
        needs: list[str] = []
        values = [self._value(each, needs) for each in self._symbols]

        content = bytearray(self._end)
        for i, each in used.items():
            if each.type != _EMPTY:
                content[self._starts[i] : self._starts[i] + each.size] = self._code[
                    each.offset : each.offset + each.size
                ]
        places = []
        for each in self._sections:
            if each.info not in used or each.type not in (_ADDENDS, _NO_ADDENDS):
                continue
            if each.type == _NO_ADDENDS:
                raise _Unsuited
            for at in range(each.offset, each.offset + each.size, 24):
                offset, kind, symbol, addend = struct.unpack_from("<QIIq", self._code, at)
                place = self._starts[each.info] + offset
                who, value = values[symbol]
                if kind == _ADDRESS and who >= 0:
                    places.append((place, who))
                elif kind == _DISTANCE and who == 0:
                    value -= place
                else:
                    raise _Unsuited
                struct.pack_into("<q", content, place, value + addend)
        (entry,) = [
            value
            for each, (_, value) in zip(self._symbols, values, strict=True)
            if each.name == name
        ]
        where = np.array(places, dtype=np.int64).reshape(-1, 2).T.copy()
        return Image(bytes(content), fixed, entry, tuple(needs), where)

    def _place(self, size: int, alignment: int) -> int:
        start = -(-self._end // alignment) * alignment if alignment else self._end
        self._end = start + size
        return start

    def _value(self, symbol: _Symbol, needs: list[str]) -> tuple[int, int]:
        """Return what a symbol's address is counted from, as in ``places``, and its offset from there."""
        if symbol.section == _COMMON:
            return 0, self._place(symbol.size, symbol.value)
        if symbol.section in self._starts:
            return 0, self._starts[symbol.section] + symbol.value
        if symbol.section == _UNDEFINED and symbol.name:
            needs.append(symbol.name)
            return len(needs), 0
        return -1, 0
