"""Sections of a scenario: tables of its file, such as `[wind]`; most are off unless their table stands there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, Self

from moflock_mj.errors import ScenarioError
from moflock_mj.quantities import Bounds, check_fields, check_keys


@dataclasses.dataclass(frozen=True, kw_only=True)
class Section:
    """A table of the scenario; a subclass has its name in `table`, and fields made by `quantity`.

    Raises:
        ScenarioError: a value is of the wrong type or out of bounds; the line names it as `table.field`.
    """

    table: ClassVar[str]

    def __post_init__(self) -> None:
        check_fields(self, ScenarioError, f"{self.table}.")

    @classmethod
    def read(cls, values: Any) -> Self:
        """A section from its fields by name; those left out keep their defaults.

        Raises:
            ScenarioError: it is no table, or names a field or a value that the section does not have.
        """
        if not isinstance(values, Mapping):
            raise ScenarioError(f"{cls.table}: {values!r} is of the wrong type: it must be a table, [{cls.table}]")
        check_keys(values, [field.name for field in dataclasses.fields(cls)], ScenarioError, f"{cls.table}.")
        return cls(**values)

    @classmethod
    def read_all(cls, values: Any) -> tuple[Self, ...]:
        """Sections from an array of tables; an error names one by its place, as `table[2].field`.

        Raises:
            ScenarioError: it is no array of tables, or as for `read`.
        """
        if not isinstance(values, (list, tuple)):
            raise ScenarioError(f"{cls.table}: {values!r} is of the wrong type: it must be tables, [[{cls.table}]]")
        read = []
        for place, table in enumerate(values):
            try:
                read.append(cls.read(table))
            except ScenarioError as problem:
                raise ScenarioError(f"{cls.table}[{place}]{str(problem).removeprefix(cls.table)}") from None
        return tuple(read)


def section(kind: type[Section], help: str, *, on: bool = False) -> Any:
    """A dataclass field that holds a section, or None where it is off; one that is `on` is never off."""
    default = kind() if on else None
    return dataclasses.field(default=default, metadata={"bounds": Bounds(unit="1", help=help), "section": kind})


def sections(kind: type[Section], help: str) -> Any:
    """A dataclass field that holds a tuple of sections, none by default."""
    return dataclasses.field(default=(), metadata={"bounds": Bounds(unit="1", help=help), "sections": kind})
