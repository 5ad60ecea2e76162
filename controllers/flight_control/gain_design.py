"""The design of the controller's gains: loops are built, bandwidths placed, margins reported. No gain is typed in.

Every loop is linear about hover and built with python-control from the rigid body, the rotors' lag and the delay of the
sampled controller; its gain is the one that lets it cross 0 dB at the bandwidth asked for.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from controllers.airframe import GRAVITY, ROTORS, Airframe
from controllers.flight_control.cascade import Gains
from controllers.flight_control.mixer import wrench_matrix

GAIN_MARGIN_MIN = 6.0
"""dB, of every loop."""
PHASE_MARGIN_MIN = 45.0
"""Degrees, of every loop."""
THRUST_SHARE = 0.9
"""Share of the rotors' thrust that level flight at the largest commanded acceleration may take; the rest steers."""


class GainDesignError(ValueError):
    """No controller of the kind asked for can be designed for this airframe."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bandwidths:
    """Where each loop crosses 0 dB, in rad/s, from the innermost out.

    A loop is two to three times slower than the one inside it. The observer is far slower than the velocity loop, so
    that noise moves a rigid body as it moves a point mass, and only what lasts is countered.
    """

    roll_pitch_rate: float = 22.0
    tilt: float = 9.0
    yaw_rate: float = 8.0
    heading: float = 2.0
    climb: float = 5.0
    altitude: float = 1.5
    observer: float = 0.2


@dataclasses.dataclass(frozen=True, kw_only=True)
class Margins:
    """How far a loop is from instability.

    Attributes:
        loop: its name.
        crossover: rad/s, where its gain is 1.
        gain_margin: dB by which the gain may rise or, where a loop with several integrators needs it, fall.
        phase_margin: degrees.
        delay_margin: s, delay that uses up the phase margin.
    """

    loop: str
    crossover: float
    gain_margin: float
    phase_margin: float
    delay_margin: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopDesign:
    """The gains of a controller and the margins of its loops."""

    gains: Gains
    margins: tuple[Margins, ...]


def design_gains(
    airframe: Airframe,
    *,
    step: float,
    tau: float = 1.0,
    a_max: float = 6.0,
    tilt_max: float = math.radians(45),
    bandwidths: Bandwidths = Bandwidths(),
) -> LoopDesign:
    """Design the controller of an airframe.

    Args:
        airframe: the vehicle.
        step: s, period of the controller.
        tau: s, time constant of the velocity's response.
        a_max: m/s^2, bound of the commanded horizontal acceleration.
        tilt_max: rad, bound of the commanded tilt.
        bandwidths: where the loops cross.

    Raises:
        GainDesignError: the airframe is too weak for a_max, its rotors cannot steer it, or a loop falls short of 6 dB
            or 45 degrees.
    """
    for field, value in (("step", step), ("tau", tau), ("a_max", a_max)):
        if not (math.isfinite(value) and value > 0):
            raise GainDesignError(f"{field}: {value:g} must be above 0")
    if not 0 < tilt_max < math.pi / 2:
        raise GainDesignError(f"tilt_max: {tilt_max:g} rad must be between 0 and pi/2")
    _check_strength(airframe, a_max)
    matrix, mixer = _steering(airframe)
    loops = _Loops(airframe, step, bandwidths, 1 / tau)
    margins = tuple(loops.margins)
    _check_margins(airframe, step, margins)
    rate_gain_x, rate_gain_y, rate_gain_z = loops.rate_gains
    gains = Gains(
        step=step,
        mass=airframe.mass,
        inertia_x=airframe.inertia[0],
        inertia_y=airframe.inertia[1],
        inertia_z=airframe.inertia[2],
        gravity=GRAVITY,
        thrust_max=airframe.thrust_max,
        rotor_blend=-math.expm1(-step / airframe.rotor_lag),
        velocity_gain=loops.velocity_gain,
        a_max=a_max,
        tilt_tangent=math.tan(tilt_max),
        tilt_cosine=math.cos(tilt_max),
        climb_rate_max=3.0,
        vertical_acceleration_max=min(GRAVITY / 2, (THRUST_SHARE * airframe.thrust_to_weight() - 1) * GRAVITY),
        body_rate_max=2 * math.pi,
        altitude_gain=loops.altitude_gain,
        climb_gain=loops.climb_gain,
        tilt_gain=loops.tilt_gain,
        heading_gain=loops.heading_gain,
        rate_gain_x=rate_gain_x,
        rate_gain_y=rate_gain_y,
        rate_gain_z=rate_gain_z,
        observer_velocity_gain=loops.observer_velocity_gain,
        observer_disturbance_gain=loops.observer_disturbance_gain,
        disturbance_max=disturbance_bound(tilt_max),
        wind_max=disturbance_bound(tilt_max),
        wrench_matrix=matrix,
        mixer=mixer,
    )
    return LoopDesign(gains=gains, margins=margins)


def disturbance_bound(tilt_max: float) -> float:
    """Largest disturbance that the observer takes for real, m/s^2.

    Never more than half of what the tilt can push, nor, with the bound on vertical acceleration, all of gravity.

    Args:
        tilt_max: rad.
    """
    return min(GRAVITY * math.tan(tilt_max) / 2, GRAVITY / 4)


def maximum_horizontal_force(airframe: Airframe, tilt_max: float) -> float:
    """Horizontal acceleration that a vehicle can hold in level flight by tilt and `THRUST_SHARE` of its rotors, m/s^2.

    Args:
        airframe: the vehicle.
        tilt_max: rad.
    """
    lift = THRUST_SHARE * ROTORS * airframe.thrust_max / airframe.mass
    return min(GRAVITY * math.tan(tilt_max), math.sqrt(max(lift**2 - GRAVITY**2, 0.0)))


class _Loops:
    """The loops about hover, from the innermost out; each is reported as it is closed."""

    def __init__(self, airframe: Airframe, step: float, bandwidths: Bandwidths, velocity_gain: float) -> None:
        import control  # noqa: PLC0415 - takes most of a second, which a point-mass flight need not pay

        self._control = control
        self.s = control.tf("s")
        self.margins: list[Margins] = []

        # A command computed from the state at one step sets the rotors' thrust by the next, and that thrust moves the
        # body until the one after: half a step each, on average.
        self.half_step = control.tf(*control.pade(step / 2, 1))
        self.actuation = control.tf(*control.pade(step, 2)) / (airframe.rotor_lag * self.s + 1)

        rates = (bandwidths.roll_pitch_rate, bandwidths.roll_pitch_rate, bandwidths.yaw_rate)
        axes = ("roll rate", "pitch rate", "yaw rate")
        placed = [
            self._place(axis, self.actuation / (moment * self.s), rate)
            for axis, moment, rate in zip(axes, airframe.inertia, rates, strict=True)
        ]
        self.rate_gains = tuple(gain for gain, _ in placed)
        _, roll_closed = placed[0]
        _, yaw_closed = placed[2]
        self.tilt_gain, tilt_closed = self._place("tilt", roll_closed / self.s, bandwidths.tilt)
        self.heading_gain, _ = self._place("heading", yaw_closed / self.s, bandwidths.heading)
        self.climb_gain, climb_closed = self._place("climb", self.actuation / self.s, bandwidths.climb)
        self.altitude_gain, _ = self._place("altitude", climb_closed / self.s, bandwidths.altitude)

        # The velocity loop's gain is the answer asked for; its crossover follows.
        self.velocity_gain = velocity_gain
        leaning = tilt_closed * self.half_step
        self._report("velocity", velocity_gain * leaning / self.s)
        # Observer of v' = a + d, both poles at the bandwidth; q leads from the disturbance to its estimate.
        self.observer_velocity_gain = 2 * bandwidths.observer
        self.observer_disturbance_gain = bandwidths.observer**2
        q = self.observer_disturbance_gain / (self.s + bandwidths.observer) ** 2
        self._report_observed("velocity with observer", leaning, velocity_gain, q)
        climbing = self.climb_gain * (1 + self.altitude_gain / self.s)
        self._report_observed("altitude with observer", self.actuation, climbing, q)

    def _place(self, loop: str, plant: Any, bandwidth: float) -> tuple[float, Any]:
        """The gain that makes gain times plant cross 0 dB at the bandwidth, and the loop closed with it."""
        gain = 1 / abs(complex(plant(1j * bandwidth)))
        self._report(loop, gain * plant)
        return gain, self._control.feedback(gain * plant, 1)

    def _report(self, loop: str, open_loop: Any) -> None:
        """Keep the margins of a loop; one that is unstable when closed has none."""
        gain_margin, phase_margin, _, crossover = map(float, self._control.margin(open_loop))
        if self._control.feedback(open_loop, 1).poles().real.max() >= 0:
            gain_margin, phase_margin = 1.0, 0.0
        self.margins.append(
            Margins(
                loop=loop,
                crossover=crossover,
                gain_margin=abs(20 * math.log10(gain_margin)),
                phase_margin=phase_margin,
                delay_margin=math.radians(phase_margin) / crossover,
            )
        )

    def _report_observed(self, loop: str, actuation: Any, feedback_law: Any, q: Any) -> None:
        """Report a loop about v = a / s with the observer in it, broken where the velocity is measured.

        With y the measurement and a = actuation u the acceleration that the observer knows of, the controller asks for
        u = -feedback_law y - q (s y - a), thus u (1 - q actuation) = -(feedback_law + q s) y.
        """
        inner = self._control.feedback(1, q * actuation, sign=1)
        self._report(loop, inner * actuation * (feedback_law + q * self.s) / self.s)


def _check_strength(airframe: Airframe, a_max: float) -> None:
    available = THRUST_SHARE * ROTORS * airframe.thrust_max / airframe.mass
    if available <= GRAVITY:
        ratio = airframe.thrust_to_weight()
        raise GainDesignError(
            f"airframe {airframe.name}: thrust to weight of {ratio:.3g} must be above {1 / THRUST_SHARE:.3g}"
        )
    reachable = math.sqrt(available**2 - GRAVITY**2)
    if a_max > reachable:
        raise GainDesignError(
            f"a_max: {a_max:g} m/s^2 is too much for the airframe {airframe.name}, must be at most {reachable:.3g} "
            f"m/s^2 ({THRUST_SHARE:.0%} of its thrust)"
        )


def _steering(airframe: Airframe) -> tuple[Any, Any]:
    """The airframe's wrench matrix and its inverse."""
    matrix = wrench_matrix(airframe)
    if np.linalg.matrix_rank(matrix) < ROTORS:
        raise GainDesignError(
            f"airframe {airframe.name}: rotor_positions and yaw_ratio do not steer all of roll, pitch and yaw"
        )
    off_centre = np.abs(matrix[1:].sum(axis=1)).max()
    if off_centre > 1e-9:
        raise GainDesignError(
            f"airframe {airframe.name}: equal thrusts turn it by {off_centre:g} N m per N, must be 0 "
            "(rotor_positions, yaw_ratio)"
        )
    return matrix, np.ascontiguousarray(np.linalg.inv(matrix))


def _check_margins(airframe: Airframe, step: float, margins: tuple[Margins, ...]) -> None:
    for loop in margins:
        subject = f"airframe {airframe.name} at a step of {step:g} s: the {loop.loop} loop's"
        for margin, value, least, unit in (
            ("gain margin", loop.gain_margin, GAIN_MARGIN_MIN, "dB"),
            ("phase margin", loop.phase_margin, PHASE_MARGIN_MIN, "degrees"),
        ):
            if not value >= least:
                raise GainDesignError(f"{subject} {margin} is {value:.1f} {unit}, must be at least {least:g} {unit}")
