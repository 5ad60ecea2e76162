"""A flight's whole state as bytes: arrays and generators, without pickles, to resume from bit by bit."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import LogError

_KINDS = {"<f8", "<i8", "<i4", "|u1"}
"""Types that an array may have."""


def arrays_of(state: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Every array in nested named tuples or mappings, by its dotted name.

    Constants of a flight lie in fields that are called `model`, which are left out. An array that is found a second
    time, such as that of a wind that two stages share, keeps its first name. Empty arrays are left out.
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
    """The arrays and some JSON facts: a length, a JSON header, then the arrays' bytes one after the other."""
    layout = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    header = json.dumps({"arrays": layout, "facts": facts}).encode()
    return b"".join([len(header).to_bytes(8, "little"), header, *(array.tobytes() for array in arrays.values())])


def unpack(content: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """What `pack` packed; the content may come from anywhere.

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
    """The state of a generator as JSON values."""
    return _plain(rng.bit_generator.state)


def set_generator(rng: np.random.Generator, facts: Any) -> None:
    """Put a generator into a state that `generator_facts` told.

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
