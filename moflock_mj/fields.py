"""Fields of frozen dataclasses with unit and bounds, checked at construction."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, ClassVar, Self

from moflock_mj.errors import MoflockError, ScenarioError


@dataclasses.dataclass(frozen=True, kw_only=True)
class FieldSpec:
    """Unit, bounds and description of a field.

    Attributes:
        unit: SI unit, "1" for a plain number or a name.
        low: smallest value, or None.
        high: largest value, or None.
        open_low: True if `low` itself is out of bounds.
        choices: permitted values of a text field; any text if empty.
        help: one-line description.
    """

    unit: str
    low: float | None = None
    high: float | None = None
    open_low: bool = False
    choices: tuple[str, ...] = ()
    help: str = ""

    def limit(self) -> str:
        """Bounds in words, for an error message or a comment."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        unit = "" if self.unit == "1" else f" {self.unit}"
        above = f"{'over' if self.open_low else 'at least'} {self.low:g}{unit}" if self.low is not None else ""
        below = f"at most {self.high:g}{unit}" if self.high is not None else ""
        return " and ".join(part for part in (above, below) if part)

    def admits(self, value: Any) -> bool:
        """True if a value of the right type lies within the bounds."""
        if isinstance(value, str):
            return not self.choices or value in self.choices
        if isinstance(value, tuple):
            return all(self.admits(part) for part in value)
        if self.low is not None and (value < self.low or (self.open_low and value == self.low)):
            return False
        return self.high is None or value <= self.high


def quantity(default: Any, unit: str, help: str, **bounds: Any) -> Any:
    """Define a dataclass field with a default, a unit and bounds."""
    return dataclasses.field(default=default, metadata={"bounds": FieldSpec(unit=unit, help=help, **bounds)})


def check_fields(record: Any, error: type[MoflockError], prefix: str = "") -> None:
    """Check every field of a frozen dataclass, and convert whole numbers in real fields to floats.

    Args:
        record: the object.
        error: type of the exception to raise.
        prefix: prefix of the field names in the message.

    Raises:
        MoflockError: (`error`) one line that names the field, the value and the limit.
    """
    for field in dataclasses.fields(record):
        name, value = prefix + field.name, getattr(record, field.name)
        if "arena" in field.metadata:
            continue
        if "section" in field.metadata:
            kind = field.metadata["section"]
            may_be_off = field.default is None
            if not isinstance(value, kind) and not (value is None and may_be_off):
                limit = f"a {kind.__name__}{', or None' if may_be_off else ''}"
                raise error(f"{name}: {value!r} is of the wrong type: it must be {limit}")
            continue
        if "sections" in field.metadata:
            kind = field.metadata["sections"]
            if not isinstance(value, tuple) or not all(isinstance(held, kind) for held in value):
                raise error(f"{name}: {value!r} is of the wrong type: it must be a tuple of {kind.__name__}")
            continue
        value = _typed(field, name, value, error)
        bounds: FieldSpec = field.metadata["bounds"]
        if value is not None and not bounds.admits(value):
            raise error(f"{name}: {value!r} is out of bounds: it must be {bounds.limit()}")
        object.__setattr__(record, field.name, value)


def check_keys(given: Iterable[str], allowed: Iterable[str], error: type[MoflockError], prefix: str = "") -> None:
    """Refuse unknown names and suggest the nearest known one; `prefix` precedes a name in the message."""
    names = list(allowed)
    for name in given:
        if name not in names:
            near = get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]}?" if near else "known are " + ", ".join(names)
            raise error(f"{prefix}{name}: unknown name; {hint}")


def _typed(field: dataclasses.Field[Any], name: str, value: Any, error: type[MoflockError]) -> Any:
    """Convert a value to the type of its field (annotations are strings such as "float | None")."""
    types = [kind.strip() for kind in str(field.type).split("|")]
    if value is None and "None" in types:
        return None
    if types[0] == "bool" and isinstance(value, bool):
        return value
    if types[0] == "str" and isinstance(value, str):
        return value
    if types[0] == "tuple[float, float]" and isinstance(value, (list, tuple)) and len(value) == 2:
        return tuple(real_number(name, part, error) for part in value)
    number = not isinstance(value, (bool, str)) and hasattr(value, "__float__")
    if types[0] == "int" and number and float(value).is_integer():
        return int(value)
    if types[0] == "float":
        return real_number(name, value, error)
    kinds = {"bool": "true or false", "str": "a text", "int": "a whole number", "tuple[float, float]": "two numbers"}
    raise error(f"{name}: {value!r} is of the wrong type: it must be {kinds[types[0]]}")


def real_number(name: str, value: Any, error: type[MoflockError]) -> float:
    """Check that a value is a finite number, and convert it to a float.

    Raises:
        MoflockError: (`error`) one line that names the field and the value.
    """
    if isinstance(value, (bool, str)) or not hasattr(value, "__float__"):
        raise error(f"{name}: {value!r} is of the wrong type: it must be a number")
    if not math.isfinite(value):
        raise error(f"{name}: {value!r} is not a finite number")
    return float(value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """Table of a scenario. A subclass sets its name in `table` and defines its fields with `quantity`.

    Raises:
        ScenarioError: a value is of the wrong type or out of bounds; the message names it as `table.field`.
    """

    table: ClassVar[str]

    def __post_init__(self) -> None:
        check_fields(self, ScenarioError, f"{self.table}.")

    @classmethod
    def read(cls, values: Any) -> Self:
        """Create a section from a mapping of its fields; absent fields keep their defaults.

        Raises:
            ScenarioError: not a table, or an unknown field or invalid value in it.
        """
        if not isinstance(values, Mapping):
            raise ScenarioError(f"{cls.table}: {values!r} is of the wrong type: it must be a table, [{cls.table}]")
        check_keys(values, [field.name for field in dataclasses.fields(cls)], ScenarioError, f"{cls.table}.")
        return cls(**values)

    @classmethod
    def read_all(cls, values: Any) -> tuple[Self, ...]:
        """Create sections from an array of tables; an error message names a field as `table[2].field`.

        Raises:
            ScenarioError: not an array of tables, or see `read`.
        """
        if not isinstance(values, (list, tuple)):
            raise ScenarioError(f"{cls.table}: {values!r} is of the wrong type: it must be tables, [[{cls.table}]]")
        read = []
        for index, table in enumerate(values):
            try:
                read.append(cls.read(table))
            except ScenarioError as problem:
                raise ScenarioError(f"{cls.table}[{index}]{str(problem).removeprefix(cls.table)}") from None
        return tuple(read)


def section(kind: type[Section], help: str, *, on: bool = False) -> Any:
    """Define a dataclass field for a section, with None for off; if `on`, the section is always on."""
    default = kind() if on else None
    return dataclasses.field(default=default, metadata={"bounds": FieldSpec(unit="1", help=help), "section": kind})


def sections(kind: type[Section], help: str) -> Any:
    """Define a dataclass field for a tuple of sections, empty by default."""
    return dataclasses.field(default=(), metadata={"bounds": FieldSpec(unit="1", help=help), "sections": kind})
