"""Grades of checks, as Skybrush gives them: the worst of the parts is that of the whole."""

from __future__ import annotations

import enum
from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict

POINT, FLOCK = "point", "flock"
"""What an item can be about besides a vehicle."""


class Grade(enum.StrEnum):
    """From the best to the worst.

    A soft failure may mend itself, such as a satellite too few; a failure wants somebody to do something; an error is a
    check that could not be made.
    """

    OFF = "off"
    PASS = "pass"
    WARNING = "warning"
    RUNNING = "running"
    SOFT_FAILURE = "soft failure"
    FAILURE = "failure"
    ERROR = "error"

    @property
    def is_good(self) -> bool:
        """Whether one may fly with it."""
        return self in (Grade.OFF, Grade.PASS, Grade.WARNING)

    @classmethod
    def worst(cls, grades: Iterable[Grade]) -> Grade:
        """Of all, that of the whole; OFF if there are none."""
        order = list(cls)
        return max(grades, key=order.index, default=cls.OFF)


class Item(BaseModel):
    """One check.

    Attributes:
        name: of what was checked.
        about: the point, the flock, or the vehicle: "point", "flock", "vehicle 3".
        grade: of it.
        value: what was measured, or None.
        limit: what it must be, in words with units.
        unit: of the value.
        advice: what to do about it; empty if nothing is to be done.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    about: str
    grade: Grade
    value: float | str | None = None
    limit: str = ""
    unit: str = ""
    advice: str = ""


def judged(
    name: str,
    about: str,
    *,
    good: bool,
    value: float | str | None,
    limit: str,
    unit: str = "",
    advice: str,
    otherwise: Grade = Grade.FAILURE,
) -> Item:
    """An item that passes, or is graded `otherwise` with advice."""
    return Item(
        name=name,
        about=about,
        grade=Grade.PASS if good else otherwise,
        value=value if not isinstance(value, float) or abs(value) < float("inf") else None,
        limit=limit,
        unit=unit,
        advice="" if good else advice,
    )
