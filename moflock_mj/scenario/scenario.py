"""Scenario of a flight: all inputs except policy parameters, dynamics and seed."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import FieldSpec, Section, check_fields, check_keys, quantity, section, sections
from moflock_mj.scenario.acceptance import AcceptanceLimits
from moflock_mj.scenario.effect_configs import (
    BatteryConfig,
    DownwashConfig,
    DragConfig,
    GroundEffectConfig,
    ImuConfig,
    PointMassConfig,
    WindConfig,
)
from moflock_mj.scenario.faults import FaultConfig
from moflock_mj.world.arena import Arena, arena_table, check_arena, read_arena
from moflock_mj.world.square import Square

DEFAULT_STEP = {"point_mass": 0.01, "rigid_body": 0.005}
"""Default integration step of each dynamics, s."""

_PAPER_SIDE = 500.0
"""Side of the paper's square arena, m."""

DEPLOYED = "deployed"
"""Dynamics of a log of vehicles that flew over MAVLink, which cannot be resumed or verified."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scenario:
    """Scenario of a flight, in SI units. The defaults are the paper's (its tables, and MOflock's configuration).

    Raises:
        ScenarioError: a value is of the wrong type or out of bounds, or a period is not a whole multiple of the step.
    """

    drones: int = quantity(30, "1", "number of drones", low=1, high=10_000)
    arena_side: float | None = quantity(
        None,
        "m",
        'side of a square arena, centred at the origin; shorthand for [arena] shape = "square"',
        low=1,
        high=1e5,
    )
    duration: float = quantity(600.0, "s", "simulated time of the flight", low=0, open_low=True, high=1e6)
    step: float | None = quantity(None, "s", "integration step; the dynamics' own if absent", low=1e-4, high=0.2)

    altitude: float = quantity(20.0, "m", "height of the flight", low=1, high=1e4)
    airframe: str = quantity("x500", "1", "vehicle: name of a file in models/, without .xml")
    start: str = quantity(
        "spaced",
        "1",
        "spaced: at a distance and at rest; moflock: at random positions, with a common velocity",
        choices=("spaced", "moflock"),
    )
    start_spacing: float = quantity(
        12.0, "m", "smallest distance between two drones of a spaced start", low=0, high=1e4
    )
    start_speed: float = quantity(1.0, "m/s", "largest velocity component of a moflock start", low=0, high=100)
    warm_up: float = quantity(0.0, "s", "initial time that order parameters exclude", low=0, high=1e6)

    v_flock: float = quantity(6.0, "m/s", "cruise speed of each drone", low=0, open_low=True, high=100)
    v_max: float = quantity(6.0, "m/s", "largest desired speed", low=0, open_low=True, high=100)
    v_rep_max: float = quantity(6.0, "m/s", "largest repulsion from one neighbour", low=0, high=100)

    sample_period: float = quantity(0.1, "s", "period of order parameters and log", low=1e-4, high=10)
    t_gps: float = quantity(0.2, "s", "period of sensing and policy", low=1e-4, high=10)
    t_del: float = quantity(1.0, "s", "delay of the packets from other drones", low=0, high=60)
    r_comm: float = quantity(100.0, "m", "range of communication", low=0, high=1e5)
    packet_loss_ratio: float = quantity(0.0, "1", "fraction of packets lost at packet_loss_distance", low=0, high=1)
    packet_loss_distance: float = quantity(100.0, "m", "see packet_loss_ratio", low=0, open_low=True, high=1e5)
    sigma_inner: float = quantity(0.005, "m^2/s^2", "strength of the GPS error", low=0, high=100)
    lambda_gps: float = quantity(0.1, "1/s", "damping of the GPS error", low=0, high=10)

    tau: float = quantity(1.0, "s", "time constant of the velocity response", low=0.05, high=60)
    a_max: float = quantity(6.0, "m/s^2", "largest commanded acceleration", low=0, open_low=True, high=100)
    sigma_outer: float = quantity(
        0.2, "m^2/s^3", "strength of the velocity disturbance; replaced by wind", low=0, high=100
    )
    tilt_max: float = quantity(math.radians(45), "rad", "largest commanded tilt of a rigid body", low=0.05, high=1.4)

    r_coll: float = quantity(3.0, "m", "two drones closer than this count as a collision", low=0, high=1e3)
    v_tol: float = quantity(2.25, "m/s", "tolerance of F_speed", low=0, open_low=True, high=100)
    a_tol: float = quantity(0.0003, "1", "tolerance of F_coll", low=0, open_low=True, high=1)
    r_tol: float = quantity(5.0, "m", "tolerance of F_wall", low=0, open_low=True, high=1e4)

    arena: Arena = dataclasses.field(
        default=None, metadata={"arena": True, "bounds": FieldSpec(unit="1", help="arena of the flight")}
    )  # type: ignore[assignment]

    point_mass: PointMassConfig | None = section(PointMassConfig, "response of point masses, instead of tau and a_max")
    wind: WindConfig | None = section(WindConfig, "wind and gusts, instead of the velocity disturbance")
    drag: DragConfig | None = section(DragConfig, "drag of rigid bodies and their rotors; always on with wind")
    downwash: DownwashConfig | None = section(DownwashConfig, "force of the rotors' jets on drones below; rigid bodies")
    ground_effect: GroundEffectConfig | None = section(
        GroundEffectConfig, "additional thrust close to the ground; rigid bodies"
    )
    battery: BatteryConfig | None = section(
        BatteryConfig, "loss of voltage and thrust with charge and current; rigid bodies"
    )
    imu: ImuConfig | None = section(ImuConfig, "state estimates from noisy sensors in the control loops; rigid bodies")
    verdict: AcceptanceLimits = section(AcceptanceLimits, "acceptance limits of a flyable or unsafe point", on=True)

    faults: tuple[FaultConfig, ...] = sections(FaultConfig, "faults in flight, see `moflock_mj.scenario.faults`")

    def __post_init__(self) -> None:
        check_fields(self, ScenarioError)
        self._set_arena()
        if self.warm_up >= self.duration:
            raise ScenarioError(f"warm_up: {self.warm_up:g} s must be under the duration, {self.duration:g} s")
        self._check_multiple("duration", "sample_period", self.sample_period)
        if self.step is not None:
            self._check_periods(self.step)
        for index, fault in enumerate(self.faults):
            fault.check_against(self.drones, self.duration, f"faults[{index}]")

    def _set_arena(self) -> None:
        """Set the arena: the given one, a square of the given side, or the paper's."""
        if getattr(self, "arena", None) is None:
            object.__setattr__(self, "arena", Square(_PAPER_SIDE if self.arena_side is None else self.arena_side))
        object.__setattr__(self, "arena", check_arena(self.arena))
        side = self.arena.side if isinstance(self.arena, Square) else None
        if self.arena_side not in (None, side):
            raise ScenarioError(
                f"arena_side: {self.arena_side:g} m conflicts with the arena, {self.arena.title}: it must be absent"
            )
        object.__setattr__(self, "arena_side", side)

    def step_for(self, dynamics: str) -> float:
        """Integration step for `dynamics`, s.

        Raises:
            ScenarioError: a period is not a whole multiple of the step.
        """
        step = DEFAULT_STEP[dynamics] if self.step is None else self.step
        self._check_periods(step)
        return step

    def replace(self, **changes: Any) -> Scenario:
        """Copy of the scenario with changed fields."""
        check_keys(changes, self.field_names(), ScenarioError)
        if "arena" in changes or "arena_side" in changes:
            changes = {"arena": None, "arena_side": None, **changes}
        return dataclasses.replace(self, **changes)

    @classmethod
    def field_names(cls) -> tuple[str, ...]:
        """Names of all fields."""
        return tuple(field.name for field in dataclasses.fields(cls))

    @classmethod
    def from_toml(cls, text: str) -> Scenario:
        """Create a scenario from TOML; absent fields keep their defaults.

        Raises:
            ScenarioError: the text is not TOML, or has an unknown field or an invalid value.
        """
        try:
            values = tomllib.loads(text)
        except tomllib.TOMLDecodeError as problem:
            raise ScenarioError(f"not TOML: {problem}") from None
        return cls.from_dict(values)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Scenario:
        """Create a scenario from its fields by name, with sections as mappings or None, and faults as mappings.

        Absent fields keep their defaults.

        Raises:
            ScenarioError: an unknown field or an invalid value.
        """
        check_keys(values, cls.field_names(), ScenarioError)
        fields = dict(values)
        for name, kind in cls.sections().items():
            if fields.get(name) is not None:
                fields[name] = kind.read(fields[name])
        if fields.get("arena") is not None:
            fields["arena"] = read_arena(fields["arena"])
        if "faults" in fields:
            fields["faults"] = FaultConfig.read_all(fields["faults"])
        return cls(**fields)

    def to_dict(self) -> dict[str, Any]:
        """Fields by name as JSON values, in the form of `from_dict`."""
        values = dataclasses.asdict(self)
        values.pop("arena" if isinstance(self.arena, Square) else "arena_side")
        return values if "arena_side" in values else values | {"arena": arena_table(self.arena)}

    @classmethod
    def sections(cls) -> dict[str, type[Section]]:
        """Types of the sections by name."""
        kinds = {field.name: field.metadata.get("section") for field in dataclasses.fields(cls)}
        return {name: kind for name, kind in kinds.items() if kind is not None}

    @classmethod
    def load(cls, path: str | Path) -> Scenario:
        """Read a scenario file.

        Raises:
            ScenarioError: the file cannot be read, or see `from_toml`.
        """
        try:
            return cls.from_toml(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as problem:
            reason = problem.strerror if isinstance(problem, OSError) else "it is not UTF-8 text"
            raise ScenarioError(f"scenario {path}: {reason}") from None
        except ScenarioError as problem:
            raise ScenarioError(f"scenario {path}: {problem}") from None

    def to_toml(self) -> str:
        """Format the scenario as TOML, with meaning and bounds of each field in a comment, and tables last."""
        tables = {"section", "sections", "arena"}
        lines = [_toml_line(self, field) for field in dataclasses.fields(self) if not tables & field.metadata.keys()]
        if not isinstance(self.arena, Square):
            lines += [
                "",
                "[arena]",
                *(f"{name} = {json.dumps(value)}" for name, value in arena_table(self.arena).items()),
            ]
        for field in dataclasses.fields(self):
            if "section" in field.metadata:
                part, off = getattr(self, field.name), getattr(self, field.name) is None
                lines += ["", f"{'# ' * off}[{field.name}]  # {'off: ' * off}{field.metadata['bounds'].help}"]
                lines += [_toml_line(part, inner) for inner in dataclasses.fields(part)] if not off else []
        for fault in self.faults:
            lines += ["", "[[faults]]", *(_toml_line(fault, inner) for inner in dataclasses.fields(fault))]
        return "\n".join(lines) + "\n"

    def _check_periods(self, step: float) -> None:
        for name in ("sample_period", "t_gps", "t_del"):
            self._check_multiple(name, "step", step)

    def _check_multiple(self, name: str, of: str, period: float) -> None:
        value = getattr(self, name)
        if abs(value / period - round(value / period)) > 1e-6:
            raise ScenarioError(f"{name}: {value:g} s must be a whole multiple of the {of}, {period:g} s")


def _toml_line(record: Any, field: dataclasses.Field[Any]) -> str:
    value, bounds = getattr(record, field.name), field.metadata["bounds"]
    comment = "; ".join(part for part in (bounds.help, bounds.limit()) if part)
    if value is None:
        return f"# {field.name} = ...  # {comment}"
    return f"{field.name} = {json.dumps(value)}  # {comment}"
