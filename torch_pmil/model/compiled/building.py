"""How the kernels are compiled: by Numba, each for one signature, and cached on disk.

Three kinds of functions make up the kernels:

* a :class:`Kernel` is compiled once and cached; Python calls it, or a kernel by its address
  (:func:`call`);
* a function that is ``compiled`` becomes part of each kernel that calls it;
* a ``part`` is written where it is called: one long function with names for its parts.

To compile fast, kernels allocate nothing and count no references, and loops are vectorised by hand.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import numba
import numpy as np
from numba import extending, types
from numba.core import cgutils, event
from numba.misc.appdirs import AppDirs
from numpy.typing import NDArray

from torch_pmil.model.compiled.checked_cache import CheckedCache, is_private_folder

# arrays of float64, and these by their number of dimensions, C-contiguous
Array = NDArray[np.float64]
Array1 = Annotated[Array, 1]
Array2 = Annotated[Array, 2]
Array3 = Annotated[Array, 3]
Array4 = Annotated[Array, 4]
Array5 = Annotated[Array, 5]
Address = int  # of a kernel, for :func:`call`

# Products may be fused with sums, but sums must not be reordered. On processors that fuse nothing,
# reordering would undo the rounding in the exponential
OPTIONS = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
    "nogil": True,
    "_nrt": False,
    "no_cfunc_wrapper": True,
}
# more optimisation by the compiler would cost many times what it saves at run time
EFFORT = {"OPT": 1, "LOOP_VECTORIZE": 0, "SLP_VECTORIZE": 0}

# Numba's own annotations know neither all of its options nor how an intrinsic is called
njit: Any = numba.njit
config: Any = numba.config
intrinsic: Any = extending.intrinsic

KERNELS: list[Kernel] = []
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """A function of kernels alone, compiled for the types that it is called with."""
    return njit(**OPTIONS, no_cpython_wrapper=True)(function)


def part(function: Function) -> Function:
    """A part of kernels, written where it is called."""
    return njit(**OPTIONS, no_cpython_wrapper=True, inline="always")(function)


class Kernel:
    """A function that is compiled for its annotated types when it is first needed.

    It returns a bool or an int; arguments are arrays of this module, int, bool, or named tuples.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self._ready = function, None
        functools.update_wrapper(self, function)
        KERNELS.append(self)

    def __call__(self, *arguments: Any) -> Any:
        """Call it from Python."""
        return self.compile()(*arguments)

    @functools.cached_property
    def address(self) -> int:
        """Where it is in memory, for :func:`call`."""
        (result,) = self.compile().overloads.values()
        return result.library.get_pointer_to_function(result.fndesc.llvm_func_name)

    def compile(self) -> Any:
        """The compiled function, from the cache if it is there."""
        if self._ready is None:
            dispatcher = njit(**OPTIONS)(self.function)
            with _effort(), _cached(dispatcher):
                dispatcher.compile(_signature(self.function))
            dispatcher.disable_compile()
            self._ready = dispatcher
        return self._ready


@intrinsic
def call(typing: Any, address: Any, arguments: Any) -> tuple[Any, Callable[..., Any]]:
    """Call the kernel at an address, which returns a bool."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        convention, kinds = context.call_conv, tuple(arguments)
        kind = convention.get_function_type(types.boolean, kinds)
        function = builder.inttoptr(values[0], kind.as_pointer())
        unpacked = cgutils.unpack_tuple(builder, values[1], len(kinds))
        status, result = convention.call_function(builder, function, types.boolean, kinds, unpacked)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return result

    return types.boolean(types.int64, arguments), emit


def compile_all() -> Path | None:
    """Compile the kernels or load them from the cache; return its folder, or None without one.

    A line on stderr reports progress, since compiling takes a while.
    """
    progress = _Progress()
    with event.install_listener("numba:compile", progress):
        for kernel in KERNELS:
            kernel.compile()
    progress.clear()
    return None if CheckedCache.lost else _cache_folder()


class _Progress(event.Listener):
    """Reports each kernel that is compiled on a terminal, and elsewhere the first one."""

    def __init__(self) -> None:
        self.reported = 0

    def on_start(self, event: Any) -> None:
        functions = [kernel.function for kernel in KERNELS]
        function = event.data["dispatcher"].py_func
        terminal = sys.stderr.isatty()
        if function in functions and (terminal or not self.reported):
            line = "compiling the prediction for this processor, once: kernel "
            line += f"{functions.index(function) + 1} of {len(functions)}"
            print(line, end="\r" if terminal else "\n", file=sys.stderr, flush=True)
            self.reported = len(line)

    def on_end(self, event: Any) -> None:
        """Nothing to report."""

    def clear(self) -> None:
        """Wipe the line from a terminal."""
        if self.reported and sys.stderr.isatty():
            print(" " * self.reported, end="\r", file=sys.stderr, flush=True)


def _signature(function: Callable[..., Any]) -> Any:
    hints = get_type_hints(function, include_extras=True)
    hints.pop("return")
    return tuple(_numba_type(hint) for hint in hints.values())


def _numba_type(hint: Any) -> Any:
    if hasattr(hint, "__metadata__"):
        (dimensions,) = hint.__metadata__
        return types.Array(types.float64, dimensions, "C")
    if hint in (bool, int):
        return types.boolean if hint is bool else types.int64
    fields = get_type_hints(hint, include_extras=True).values()
    return types.BaseTuple.from_types([_numba_type(field) for field in fields], hint)


@contextlib.contextmanager
def _effort() -> Iterator[None]:
    """Numba's settings for the kernels, and then those from before."""
    before = {name: getattr(config, name) for name in EFFORT}
    try:
        vars(config).update(EFFORT)
        yield
    finally:
        vars(config).update(before)


@contextlib.contextmanager
def _cached(dispatcher: Any) -> Iterator[None]:
    """Let Numba look in, and write to, the folder of this version of the kernels."""
    before = config.CACHE_DIR
    try:
        folder = _cache_folder()
        if folder is not None:
            config.CACHE_DIR = str(folder)
            try:
                dispatcher._cache = CheckedCache(dispatcher.py_func)
            except RuntimeError:  # it was removed, or the disk became full
                CheckedCache.lose("it cannot be written to")
        yield
    finally:
        config.CACHE_DIR = before


@functools.cache
def _cache_folder() -> Path | None:
    """A private folder that changes with any file of the kernels; None, with a warning, if none.

    Numba itself notices a change in a function's own file only.
    """
    beside, of_user = Path(__file__).parent, AppDirs("torch_pmil", appauthor=False).user_cache_dir
    asked = [Path(config.CACHE_DIR)] if config.CACHE_DIR else []
    bases = asked or [beside / "__pycache__", Path(of_user)]
    sources = sorted(beside.glob("*.py"))
    version = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    for base in bases:
        folder = base / f"kernels-{version}"
        with contextlib.suppress(OSError):
            base.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            if os.access(folder, os.W_OK) and is_private_folder(folder):
                return folder
    warnings.warn(
        f"the compiled prediction cannot be kept: none of {', '.join(map(str, bases))} can be "
        "written by this user alone, so every process compiles it anew; NUMBA_CACHE_DIR names "
        "another folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return None
