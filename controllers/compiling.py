"""Compilation of the project's kernels: decorators, stages that dispatch on a type, and a disk cache.

Numba's own disk cache checks the source file of the compiled function only. It would keep using a flight loop after an
edit of a policy in another file. The cache locators below include every source file of the project in the stamp.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numba
from numba.core import caching
from numba.extending import overload

_KERNEL_PACKAGES = (
    "controllers",
    *(
        f"moflock_mj/{package}"
        for package in (
            "analysis",
            "deployment",
            "dynamics",
            "effects",
            "log",
            "metrics",
            "sensing",
            "simulation",
            "world",
        )
    ),
)

SOURCE_ROOTS = tuple(Path(__file__).resolve().parent.parent / package for package in _KERNEL_PACKAGES)
"""Packages that may contain kernels. An edit in any of their files recompiles all kernels."""


def stamp_of(roots: tuple[Path, ...]) -> tuple[int, int]:
    """Newest modification time (ns) and total size (bytes) of all Python files below the given folders."""
    stats = [source.stat() for root in roots for source in root.rglob("*.py")]
    return max(s.st_mtime_ns for s in stats), sum(s.st_size for s in stats)


@functools.cache
def _sources_stamp() -> tuple[int, int]:
    return stamp_of(SOURCE_ROOTS)


class _ProjectSources:
    """Mixin of a cache locator that handles this project's files only and leaves all others to Numba."""

    def get_source_stamp(self) -> tuple[int, int]:
        return _sources_stamp()

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Any:
        if not any(root in Path(py_file).resolve().parents for root in SOURCE_ROOTS):
            return None
        return super().from_function(py_func, py_file)  # type: ignore[misc]


class _BesideTheSource(_ProjectSources, caching.InTreeCacheLocator):  # type: ignore[misc]
    pass


class _InTheUsersCache(_ProjectSources, caching.UserWideCacheLocator):  # type: ignore[misc]
    pass


class _Index(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Cache index of a function, empty if it cannot be read.

    An index pickles the argument types. One that older sources wrote may name a type that no longer exists, and Numba
    would fail on it before it compares the stamps.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (AttributeError, ImportError):
            return {}


caching.IndexDataCacheFile = _Index

# Numba already prefers a folder that the user names in NUMBA_CACHE_DIR.
if not numba.config.CACHE_DIR:
    caching.CompileResultCacheImpl._locator_classes = [
        _BesideTheSource,
        _InTheUsersCache,
        *caching.CompileResultCacheImpl._locator_classes,
    ]

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a function without the interpreter lock and with IEEE division."""
    return cast("Function", numba.njit(nogil=True, error_model="numpy")(function))


def hot_kernel(function: Function) -> Function:
    """Compile a function that runs for each drone at each step: as `kernel`, and always inlined.

    Numba counts references to every array row that is passed to a call, which costs more than a controller; inlining
    removes that cost. It also makes compilation slower, so that other functions use `kernel`.
    """
    return cast("Function", numba.njit(nogil=True, error_model="numpy", forceinline=True)(function))


def entry_kernel(function: Function) -> Function:
    """Compile a function that Python calls: as `kernel`, and cached on disk."""
    return cast("Function", numba.njit(nogil=True, error_model="numpy", cache=True)(function))


class Off(NamedTuple):
    """State of an effect that is off. A stage with `Off` as its first argument runs the body of its declaration."""


def stage(signature: Function) -> Function:
    """Declare a stage of the flight loop that dispatches on the type of its first argument.

    Numba selects the implementation when it compiles the loop, so that dispatch costs nothing at run time. A new arena,
    policy or effect defines a named tuple and, with `implements`, a function with the argument names of the stage. The
    body of the declaration runs when the first argument is `Off`. A stage that cannot be off raises
    `NotImplementedError` there.
    """
    return _declare(signature, {"error_model": "numpy"})


def hot_stage(signature: Function) -> Function:
    """Declare a stage that runs for each drone at each step: as `stage`, and always inlined."""
    return _declare(signature, {"error_model": "numpy", "forceinline": True})


def _declare(signature: Function, options: dict[str, Any]) -> Function:
    implementations: dict[type, Callable[..., Any]] = {}

    @functools.wraps(signature)
    def choose(*argument_types: Any, **named: Any) -> Callable[..., Any] | None:
        first = argument_types[0] if argument_types else next(iter(named.values()))
        kind = getattr(first, "instance_class", None)
        return implementations.get(kind, signature if kind is Off else None)  # type: ignore[arg-type]

    signature.implementations = implementations  # type: ignore[attr-defined]
    # A strict overload would also compare annotations, which differ by design.
    overload(signature, jit_options=options, strict=False)(choose)
    return signature


def implements(declared_stage: Callable[..., Any], chosen_by: type) -> Callable[[Function], Function]:
    """Register a function as the implementation of a stage for one type of the first argument.

    Args:
        declared_stage: function declared with `stage` or `hot_stage`.
        chosen_by: named tuple type of the first argument.
    """

    def register(implementation: Function) -> Function:
        declared_stage.implementations[chosen_by] = implementation  # type: ignore[attr-defined]
        return implementation

    return register
