"""Snapshots: the complete state of a flight as bytes, without pickles, for a bit-identical continuation."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import LogError

_KINDS = {"<f8", "<i8", "<i4", "|u1"}
"""Permitted array types."""


def arrays_of(state: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Collect the arrays in nested named tuples or mappings, by dotted name.

    Fields named `model` hold constants of a flight and are excluded, as are empty arrays. An array that occurs twice,
    such as that of a wind shared by two stages, has the first of its names.
    """
    found: dict[str, NDArray[Any]] = {}
    _collect(state, prefix, found, set())
    return found


def _collect(state: Any, name: str, found: dict[str, NDArray[Any]], seen: set[int]) -> None:
    if isinstance(state, np.ndarray):
        if state.size and id(state) not in seen:
            seen.add(id(state))
            found[name] = state
        return
    parts = state._asdict() if hasattr(state, "_asdict") else state if isinstance(state, Mapping) else {}
    for field, part in parts.items():
        if field != "model":
            _collect(part, f"{name}.{field}" if name else field, found, seen)


def pack(arrays: Mapping[str, NDArray[Any]], facts: Mapping[str, Any]) -> bytes:
    """Pack arrays and JSON facts into bytes: length of the header, JSON header, and bytes of the arrays."""
    layout = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    header = json.dumps({"arrays": layout, "facts": facts}).encode()
    return b"".join([len(header).to_bytes(8, "little"), header, *(array.tobytes() for array in arrays.values())])


def unpack(content: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Unpack the bytes of `pack`, which may be from an untrusted source.

    Raises:
        LogError: not a snapshot.
    """
    try:
        start = 8 + int.from_bytes(content[:8], "little")
        header = json.loads(content[8:start])
        arrays = {}
        for name, kind, shape in header["arrays"]:
            if kind not in _KINDS or any(not isinstance(n, int) or n < 0 for n in shape):
                raise LogError(f"state: {name} is of an unknown type or shape")
            size = math.prod(shape)
            if start + size * np.dtype(kind).itemsize > len(content):
                raise LogError(f"state: {name} is cut off")
            array = np.frombuffer(content, kind, size, start)
            arrays[name] = array.reshape(shape)
            start += array.nbytes
        return arrays, dict(header["facts"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise LogError("state: not a snapshot of a flight") from None


def generator_facts(rng: np.random.Generator) -> Any:
    """State of a generator as JSON values."""
    return _plain(rng.bit_generator.state)


def set_generator(rng: np.random.Generator, facts: Any) -> None:
    """Restore a generator's state from `generator_facts`.

    Raises:
        LogError: not the state of such a generator.
    """
    try:
        state = facts["state"]["state"]
        rng.bit_generator.state = facts | {"state": {"state": np.array(state, np.uint64)}}
    except (ValueError, KeyError, TypeError, OverflowError):
        raise LogError("state: not that of a random generator") from None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(held) for key, held in value.items()}
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
