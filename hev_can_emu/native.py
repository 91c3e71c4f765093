"""Kernels as machine code that starts without Numba.

What a long run calls from Python is bound to its arguments once, and then called through one table of int64:
the addresses and shapes of all arrays, and the scalars.  Its machine code is kept beside Numba's own cache,
under a hash of the arguments' types, of the sources, of Numba, LLVM and the processor; it is loaded in a
thousandth of the time that Numba takes to start.  Where there is none yet, Numba makes it.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import importlib.machinery
import importlib.util
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from hev_can_emu import machine_code
from hev_can_emu.jit import (
    JIT_DISABLED,
    USUAL,
    Kernel,
    cache_folder,
    ready_compiler,
)
from hev_can_emu.kept_file import keep, read_kept

_HEAD = 2  # words of the table before the arguments: the result, and the place of an error
_STORED = USUAL and sys.platform == "linux"
_PACKAGE = __name__.partition(".")[0]
_TELLING = ("vendor_id", "cpu family", "model", "stepping", "flags")  # of a processor, to Linux
_BY_REFERENCE = ctypes.PYFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 3)
_RELEASING = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 3)


class Bound:
    """A kernel with its first arguments; called with the rest, by one thread at a time.

    Args:
        function: the kernel as written.
        fixed: arguments, numbers, arrays, None, and named tuples of these; held as long as this.
        example: of the other arguments: whole numbers and arrays, whose types stay.
    """

    def __init__(self, function: Any, fixed: Sequence[Any], example: Sequence[Any]) -> None:
        self._fixed = tuple(fixed)
        self._function = _written(function)
        if JIT_DISABLED:
            return
        form = _Form()
        expressions = [form.add(value) for value in fixed]
        self._at = form.size
        expressions += [form.add(value) for value in example]
        self._dtypes = [getattr(value, "dtype", None) for value in example]
        self._dimensions = [getattr(value, "ndim", 0) for value in example]
        code = _code(function, form, expressions)
        self._held, self._released = _BY_REFERENCE(code.address), _RELEASING(code.address)
        self._table = np.array([0, 0, *form.words], dtype=np.int64)
        base = self._table.ctypes.data
        self._places = base, base + 8, base + 8 * _HEAD
        self._words = memoryview(self._table.data)  # sets a word in a third of the time
        self._last: list[Any] = [None] * len(self._dtypes)  # arrays that are in the table

    def __call__(self, *rest: Any, release: bool = False) -> int:
        """Call the kernel, which returns a whole number; ``release``: without holding up other threads."""
        if JIT_DISABLED:
            return int(self._function(*self._fixed, *rest))
        words, at, last = self._words, self._at, self._last
        if len(rest) != len(last):
            raise TypeError(f"expected {len(last)} arguments, got {len(rest)}")
        for i, value in enumerate(rest):
            dtype = self._dtypes[i]
            if dtype is None:
                words[at] = value
                at += 1
            elif value is last[i]:
                at += 1 + value.ndim
            else:
                if value.dtype != dtype:
                    raise ValueError(f"expected an array of {dtype}, got {value.dtype}")
                if value.ndim != self._dimensions[i]:
                    raise ValueError(f"expected {self._dimensions[i]} dimensions, got {value.ndim}")
                array = np.ascontiguousarray(value)
                # Held, and not looked at again, if it is what the caller has, whose memory stays.
                last[i] = array
                for word in (array.__array_interface__["data"][0], *array.shape):
                    words[at] = word
                    at += 1
        status = (self._released if release else self._held)(*self._places)
        if status != 0:
            from hev_can_emu.numba_side import error_at

            raise error_at(words[1])
        return int(words[0])


_bound: dict[tuple[Any, ...], Bound] = {}
_calling = threading.Lock()


def native(function: Callable[..., Any], *arguments: Any) -> int:
    """Call a kernel of arrays and whole numbers, which returns a whole number; from any thread.

    What it writes into must be contiguous.  Other threads run meanwhile, but for such calls.
    """
    given = [
        np.ascontiguousarray(value) if isinstance(value, np.ndarray) else value
        for value in arguments
    ]
    types = [(value.dtype, value.ndim) for value in given if isinstance(value, np.ndarray)]
    key = (_written(function), *types)
    with _calling:
        if key not in _bound:
            _bound[key] = Bound(function, (), given)
        return _bound[key](*given, release=True)


def _written(function: Any) -> Any:
    return getattr(function, "py_func", function)


class _Form:
    """The arguments' types as text, their values as words, and the code that puts them together again."""

    def __init__(self) -> None:
        self.words: list[int] = []
        self.parts: list[str] = []
        self.names: dict[str, Any] = {}

    @property
    def size(self) -> int:
        """How many words the table has so far."""
        return len(self.words) + _HEAD

    def add(self, value: Any) -> str:
        """Take an argument; return the expression that reads it from the table."""
        at = len(self.words)
        if isinstance(value, np.ndarray):
            if not value.flags.c_contiguous:
                raise ValueError("an array that is not contiguous")
            name = self._name("dtype", value.dtype)
            self.parts.append(f"{value.ndim}{name}")
            self.words += [value.__array_interface__["data"][0], *value.shape]
            shape = "".join(f"table[{at + 1 + axis}], " for axis in range(value.ndim))
            return f"array_at(table[{at}], ({shape}), {name})"
        if isinstance(value, tuple) and hasattr(value, "_fields"):
            kind = type(value)
            name = self._name("kind", kind)
            self.parts.append(f"{name}(")
            inner = ", ".join([self.add(each) for each in value])
            self.parts.append(")")
            return f"{name}({inner})"
        if value is None:
            self.parts.append("none")
            return "None"
        if isinstance(value, (float, np.floating)):
            self.parts.append("float")
            self.words.append(struct.unpack("q", struct.pack("d", value))[0])
            return f"float_of(table[{at}])"
        if isinstance(value, (int, np.integer)):
            self.parts.append("int")
            self.words.append(int(value))
            return f"table[{at}]"
        raise TypeError(f"no argument for machine code: {type(value).__name__}")

    def _name(self, prefix: str, value: Any) -> str:
        for name, known in self.names.items():
            if known is value or (prefix == "dtype" and known == value):
                return name
        name = f"{prefix}{len(self.names)}"
        self.names[name] = value
        text = str(value) if prefix == "dtype" else f"{value.__module__}.{value.__qualname__}"
        self.parts.append(f"{name}={text}")
        return name


class _Code(NamedTuple):
    address: int
    holds: Any  #: the memory


_codes: dict[tuple[Any, str], _Code] = {}


def _code(function: Any, form: _Form, expressions: list[str]) -> _Code:
    """Return the machine code for these arguments: known, stored, or made now."""
    written = _written(function)
    types = " ".join(form.parts)
    key = written, types
    if key not in _codes:
        path = _path(written, types) if _is_stored(written) else None
        found = _load(path) if path is not None else None
        _codes[key] = found or _make(function, form, expressions, path)
    return _codes[key]


def _is_stored(function: Callable[..., Any]) -> bool:
    """Return whether its code is kept: not of functions elsewhere, whose changes nobody would notice."""
    return _STORED and function.__module__.startswith(f"{_PACKAGE}.")


def _make(function: Any, form: _Form, expressions: list[str], path: Path | None) -> _Code:
    ready_compiler()
    from hev_can_emu.numba_side import compile_entry

    source = f"def entry(table):\n    return int(kernel({', '.join(expressions)}))\n"
    # A kernel imported before Numba was is its dispatcher now.
    compiled = function.dispatcher if isinstance(function, Kernel) else function
    names = {**form.names, "kernel": compiled, "int": np.int64}
    made = compile_entry(source, names, compiled.py_func.__module__)
    if path is not None:
        _keep(path, made.symbol, made.needs, made.content)
    return _Code(made.address, made.library)


@functools.cache
def _machine() -> Any:
    """Return LLVM's target machine."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine()


@functools.cache
def _processor() -> str:
    """Return what tells processors apart, as Linux has it, which LLVM takes long to be asked for."""
    told = {}
    with contextlib.suppress(OSError), open("/proc/cpuinfo", "rb") as lines:
        for line in lines:
            name, colon, value = line.decode(errors="replace").partition(":")
            if not colon:
                break  # the next one's
            told[name.strip()] = value.strip()
    if all(told.get(name) for name in _TELLING):
        return " ".join(told[name] for name in _TELLING)
    import llvmlite.binding as llvm

    return f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


@functools.cache
def _llvm_version() -> str:
    """Return what tells versions of llvmlite apart, without importing it."""
    found = importlib.util.find_spec("llvmlite")
    assert found is not None
    assert found.origin is not None
    return Path(found.origin).with_name("_version.py").read_text()


def _path(function: Callable[..., Any], types: str) -> Path:
    module = function.__module__.partition(".")[2]
    key = hashlib.sha256(f"{_processor()} {_llvm_version()} {_own()} {types}".encode()).hexdigest()[
        :16
    ]
    return cache_folder(module) / f"{function.__name__}-{key}.code"


@functools.cache
def _own() -> str:
    """Return what tells versions of this module and the linker apart."""
    both = (Path(__file__), Path(machine_code.__file__))
    return hashlib.sha256(b"".join(each.read_bytes() for each in both)).hexdigest()


@functools.cache
def _process() -> ctypes.CDLL:
    """Return what looks functions up in the libraries that are loaded."""
    return ctypes.CDLL(None)


def _address(symbol: str) -> int:
    """Return where a function of this name is, 0 if nowhere."""
    with contextlib.suppress(AttributeError):
        return ctypes.cast(getattr(_process(), symbol), ctypes.c_void_p).value or 0
    if symbol.startswith("NRT_"):
        return _run_time().get(symbol.removeprefix("NRT_"), 0)
    return 0


@functools.cache
def _run_time() -> dict[str, int]:
    """Return the functions of Numba's run time, a C extension of its own, which needs no import of Numba.

    Kernels that make arrays allocate with it.
    """
    name = "numba.core.runtime._nrt_python"
    module = sys.modules.get(name)
    if module is None:
        package = importlib.util.find_spec("numba")
        for place in (package.submodule_search_locations if package is not None else None) or ():
            for suffix in importlib.machinery.EXTENSION_SUFFIXES:
                path = Path(place, "core", "runtime", f"_nrt_python{suffix}")
                if module is None and path.is_file():
                    module = _imported(name, path)
    return dict(getattr(module, "c_helpers", {}))


def _imported(name: str, path: Path) -> Any:
    """Import an extension without the packages around it; those find it imported, should they come."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[name] = module
    return module


def _load(path: Path) -> _Code | None:
    """Return what is stored, None where there is nothing that can be used."""
    content = read_kept(path)
    if content is None:
        return None
    size = int.from_bytes(content[:4], "little")
    told, content = msgspec.json.decode(content[4 : 4 + size]), content[4 + size :]
    addresses = {name: _address(name) for name in told["needs"]}
    if not all(addresses.values()):
        return None
    if "symbol" in told:
        return _load_object(bytes(content), told["symbol"], addresses)
    length = told["length"]
    places = np.frombuffer(content, dtype=np.int64, offset=length).reshape(2, -1)
    image = machine_code.Image(
        content[:length], told["fixed"], told["entry"], told["needs"], places
    )
    try:
        return _Code(*machine_code.load(image, list(addresses.values())))
    except OSError:
        return None


def _load_object(content: bytes, symbol: str, addresses: dict[str, int]) -> _Code | None:
    import llvmlite.binding as llvm

    for name, address in addresses.items():
        # LLVM ends the process where it does not find one.
        llvm.add_symbol(name, address)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    address = engine.get_function_address(symbol)
    return _Code(address, engine) if address else None


def _keep(path: Path, symbol: str, needs: list[str], code: bytes) -> None:
    """Store machine code."""
    image = machine_code.link(code, symbol)
    told: dict[str, Any] = {"symbol": symbol, "needs": needs}
    if image is not None:
        code = bytes(image.content) + image.places.tobytes()
        told = {"needs": image.needs, "fixed": image.fixed, "entry": image.entry}
        told["length"] = len(image.content)
    if not all(_address(name) for name in told["needs"]):
        return
    head = msgspec.json.encode(told)
    keep(path, len(head).to_bytes(4, "little") + head + code)
