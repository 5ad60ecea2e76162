"""Results of checks, in the scale of Skybrush: the result of the whole is the worst of its parts."""

from __future__ import annotations

import enum
from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict

POINT, FLOCK = "point", "flock"
"""Subjects of a check other than a vehicle."""


class CheckResult(enum.StrEnum):
    """Result of a check, from the best to the worst.

    A soft failure can pass later without action, such as one satellite too few; a failure requires action; an error is
    a check that could not be made.
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
        """Whether the result allows a flight."""
        return self in (CheckResult.OFF, CheckResult.PASS, CheckResult.WARNING)

    @classmethod
    def worst(cls, results: Iterable[CheckResult]) -> CheckResult:
        """The worst of the results; OFF if there are none."""
        order = list(cls)
        return max(results, key=order.index, default=cls.OFF)


class CheckItem(BaseModel):
    """One check and its result.

    Attributes:
        name: name of the checked quantity.
        about: subject: "point", "flock", or a vehicle such as "vehicle 3".
        result: result of the check.
        value: measured value, or None.
        limit: limit in words, with its unit.
        unit: unit of the value.
        advice: remedy; empty if none is needed.
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
    """Make an item that passes if `good`, else has the result `otherwise` and the advice."""
    return CheckItem(
        name=name,
        about=about,
        result=CheckResult.PASS if good else otherwise,
        value=value if not isinstance(value, float) or abs(value) < float("inf") else None,
        limit=limit,
        unit=unit,
        advice="" if good else advice,
    )
