"""How the project compiles its kernels: one decorator, one way to choose a stage by type, a cache never stale.

Numba's own disk cache looks at the file of the compiled function alone, and would go on using a flight loop whose
policy has been edited in another file. The locators below mix every source file of the project into the stamp.
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
"""Folders whose files, and those of their sub-packages, may hold kernels: an edit in any of them compiles all anew."""


def stamp_of(roots: tuple[Path, ...]) -> tuple[int, int]:
    """Newest modification time (ns) and total size (bytes) over the Python files below some folders."""
    stats = [source.stat() for root in roots for source in root.rglob("*.py")]
    return max(s.st_mtime_ns for s in stats), sum(s.st_size for s in stats)


@functools.cache
def _sources_stamp() -> tuple[int, int]:
    return stamp_of(SOURCE_ROOTS)


class _ProjectSources:
    """A cache locator for this project's files only; every other file is left to Numba."""

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
    """The list of what is kept of a function. It names the types of its arguments, and one that other sources left may
    name a type that is no more: Numba would stop there, before it looks at the stamp.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except (AttributeError, ImportError):
            return {}


caching.IndexDataCacheFile = _Index

# A folder that the user named by NUMBA_CACHE_DIR is Numba's first choice already.
if not numba.config.CACHE_DIR:
    caching.CompileResultCacheImpl._locator_classes = [
        _BesideTheSource,
        _InTheUsersCache,
        *caching.CompileResultCacheImpl._locator_classes,
    ]

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Decorator of a compiled function: no interpreter lock, IEEE division."""
    return cast("Function", numba.njit(nogil=True, error_model="numpy")(function))


def hot_kernel(function: Function) -> Function:
    """Decorator of what runs for each drone at each step: as `kernel`, and always inlined.

    Numba counts references to every row of an array that crosses a call, which costs more than a controller does;
    inlined, it sees that it need not. Compiling takes longer, so that the rest of the project does without.
    """
    return cast("Function", numba.njit(nogil=True, error_model="numpy", forceinline=True)(function))


def entry_kernel(function: Function) -> Function:
    """Decorator of the few compiled functions that Python calls: as `kernel`, and kept on disk."""
    return cast("Function", numba.njit(nogil=True, error_model="numpy", cache=True)(function))


class Off(NamedTuple):
    """Stands for an effect that is off: a stage whose first argument it is runs the body of its own declaration."""


def stage(signature: Function) -> Function:
    """Declare a stage of the flight whose implementation is chosen by the type of its first argument.

    The choice is made when the loop is compiled for that type, so that another arena, policy or effect costs nothing in
    each step: it brings a named tuple and, under `implements`, a function with the stage's own argument names. The body
    of the declaration is what happens where the first argument is `Off`; a stage that must never be off raises
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
    # strict would compare annotations too, which differ by design
    overload(signature, jit_options=options, strict=False)(choose)
    return signature


def implements(declared_stage: Callable[..., Any], chosen_by: type) -> Callable[[Function], Function]:
    """Decorator: compile this function as `declared_stage` wherever the first argument is a `chosen_by`.

    Args:
        declared_stage: a function made by `stage` or `hot_stage`.
        chosen_by: the named tuple that selects this implementation.
    """

    def register(implementation: Function) -> Function:
        declared_stage.implementations[chosen_by] = implementation  # type: ignore[attr-defined]
        return implementation

    return register
