"""Grades of checks, as Skybrush gives them: the worst of the parts is that of the whole."""

from __future__ import annotations

import enum
from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict

POINT, FLOCK = "point", "flock"
"""What an item can be about besides a vehicle."""


class CheckResult(enum.StrEnum):
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
        return self in (CheckResult.OFF, CheckResult.PASS, CheckResult.WARNING)

    @classmethod
    def worst(cls, grades: Iterable[CheckResult]) -> CheckResult:
        """Of all, that of the whole; OFF if there are none."""
        order = list(cls)
        return max(grades, key=order.index, default=cls.OFF)


class CheckItem(BaseModel):
    """One check.

    Attributes:
        name: of what was checked.
        about: the point, the flock, or the vehicle: "point", "flock", "vehicle 3".
        result: of it.
        value: what was measured, or None.
        limit: what it must be, in words with units.
        unit: of the value.
        advice: what to do about it; empty if nothing is to be done.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    about: str
    result: CheckResult
    value: float | str | None = None
    limit: str = ""
    unit: str = ""
    advice: str = ""


def check(
    name: str,
    about: str,
    *,
    good: bool,
    value: float | str | None,
    limit: str,
    unit: str = "",
    advice: str,
    otherwise: CheckResult = CheckResult.FAILURE,
) -> CheckItem:
    """An item that passes, or is graded `otherwise` with advice."""
    return CheckItem(
        name=name,
        about=about,
        result=CheckResult.PASS if good else otherwise,
        value=value if not isinstance(value, float) or abs(value) < float("inf") else None,
        limit=limit,
        unit=unit,
        advice="" if good else advice,
    )
