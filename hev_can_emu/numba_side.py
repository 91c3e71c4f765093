"""The only module that imports Numba at once: kernels become its dispatchers, entries machine code.

Numba and what it imports take half a second of CPU; :mod:`hev_can_emu.jit` comes here only when something
has to be compiled, or when a kernel is called that is not in :mod:`hev_can_emu.native`'s store.
"""

from __future__ import annotations

import ctypes
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numba.core.config
import numba.core.options
from numba.core import cgutils as untyped_cgutils
from numba.core import types as untyped_types
from numba.extending import intrinsic
from numba.np import arrayobj

from hev_can_emu import numba_indices, numba_stores

# Its attributes are made at run time, out of a type checker's sight.
numba_config: Any = numba.core.config
locators: Any = numba.core.caching
cgutils: Any = untyped_cgutils
types: Any = untyped_types
populate_array: Any = arrayobj.populate_array

JIT_DISABLED = bool(numba_config.DISABLE_JIT)
BOUNDS_CHECKED = bool(numba_config.BOUNDSCHECK)

# Without Numba's own run time references to arrays are not counted, which would cost several times the
# work where tuples of arrays are handed on.  Not a public option: a Numba without it is slower, no more.
UNCOUNTED = {"_nrt": False} if hasattr(numba.core.options.DefaultOptions, "_nrt") else {}


numba_indices.install()
numba_stores.install()


class KernelLocator(locators.UserProvidedCacheLocator):  # type: ignore[misc]
    """Places what is compiled in the folder set, wherever the package itself lies."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the path inside the folder; ``py_file`` is in the folder's name already."""
        return "compiled"


def dispatcher(
    function: Callable[..., Any], folder: Path | None, options: Mapping[str, Any]
) -> Any:
    """Return Numba's dispatcher of a function: it compiles on first call, or loads from ``folder``."""
    settings = {
        "CACHE_DIR": str(folder or ""),
        "CACHE_LOCATOR_CLASSES": f"{__name__}.{KernelLocator.__name__}",
    }
    previous = {name: getattr(numba_config, name, "") for name in settings}
    for name, value in settings.items():
        setattr(numba_config, name, value)
    try:
        njit: Any = numba.njit
        # Said of each kernel, since else it would pass from a kernel to those that it calls.
        chosen = {key: value for key, value in options.items() if UNCOUNTED or key != "_nrt"}
        return njit(
            cache=folder is not None,
            error_model="numpy",
            **{"forceinline": False, **UNCOUNTED, **chosen},
        )(function)
    finally:
        for name, value in previous.items():
            setattr(numba_config, name, value)


class MachineCode(NamedTuple):
    """A compiled entry: where it is, its name, its object file, and the functions it calls from outside."""

    address: int
    symbol: str
    content: bytes
    needs: list[str]
    library: Any  #: holds the memory


@intrinsic
def array_at(context: Any, address: Any, shape: Any, dtype: Any) -> Any:
    """Return the contiguous array of a shape at an address; for :func:`compile_entry`'s code."""
    del context
    kind = types.Array(dtype.dtype, len(shape), "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del signature
        array = context.make_array(kind)(context, builder)
        size = context.get_constant(
            types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype))
        )
        lengths = cgutils.unpack_tuple(builder, arguments[1])
        strides: list[Any] = []
        stride = size
        for length in reversed(lengths):
            strides.insert(0, stride)
            stride = builder.mul(stride, length)
        populate_array(
            array,
            data=builder.inttoptr(arguments[0], array.data.type),
            shape=lengths,
            strides=strides,
            itemsize=size,
            meminfo=None,
        )
        return array._getvalue()

    return kind(types.int64, shape, dtype), generate


@intrinsic
def float_of(context: Any, bits: Any) -> Any:
    """Return the float64 of a bit pattern; for :func:`compile_entry`'s code."""
    del context

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del signature
        return builder.bitcast(arguments[0], context.get_value_type(types.float64))

    return types.float64(types.int64), generate


def compile_entry(source: str, names: Mapping[str, Any], module: str) -> MachineCode:
    """Compile ``entry``, a function of a pointer to int64, from its source.

    Args:
        source: of the function.
        names: its globals; :func:`array_at` and :func:`float_of` are added.
        module: in whose name it is compiled.
    """
    space = {
        **names,
        "__name__": module,
        "array_at": array_at,
        "float_of": float_of,
    }
    exec(compile(source, f"<entry of {module}>", "exec"), space)
    njit: Any = numba.njit
    # Never for a person's eyes, never called from Python: no wrappers, which would need Numba's run time.
    compiled = njit(
        error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, **UNCOUNTED
    )(space["entry"])
    compiled.compile((types.CPointer(types.int64),))
    (result,) = compiled.overloads.values()
    symbol, library = result.fndesc.llvm_func_name, result.library
    content = library.serialize_using_object_code()[2][0]
    needs = [
        function.name
        for function in library._final_module.functions
        if function.is_declaration and not function.name.startswith("llvm.")
    ]
    return MachineCode(library.get_pointer_to_function(symbol), symbol, content, needs, library)


def error_at(address: int) -> BaseException:
    """Return the exception that a compiled function left, as its record at ``address`` tells."""
    try:
        data, size = ctypes.c_void_p.from_address(address), ctypes.c_int32.from_address(address + 8)
        kind, arguments, _ = pickle.loads(ctypes.string_at(data.value or 0, size.value))
        error = kind(*(arguments or ()))
    except Exception as failure:  # noqa: BLE001 - not as this version of Numba writes it
        return RuntimeError(f"a kernel failed ({failure})")
    return error if isinstance(error, BaseException) else RuntimeError("a kernel failed")
