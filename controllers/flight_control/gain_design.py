"""Design of the controller's gains from the airframe and the bandwidths of the loops, and their stability margins.

Every loop is linearised about hover and built with python-control from the rigid body, the rotors' lag and the delay of
the sampled controller. Its gain makes it cross 0 dB at the given bandwidth.
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
"""Required gain margin of every loop, dB."""
PHASE_MARGIN_MIN = 45.0
"""Required phase margin of every loop, degrees."""
THRUST_SHARE = 0.9
"""Largest fraction of the rotors' thrust in level flight at full acceleration; the rest is for attitude control."""


class GainDesignError(ValueError):
    """A controller cannot be designed for an airframe with the given figures."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bandwidths:
    """Crossover frequencies of the loops, rad/s, from the innermost outwards.

    Each loop is two to three times slower than the next inner one. The observer is far slower than the velocity loop,
    so that it rejects constant disturbances only, and a rigid body responds to noise as a point mass does.
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
    """Stability margins of a loop.

    Attributes:
        loop: name of the loop.
        crossover: frequency at which the open-loop gain is 1, rad/s.
        gain_margin: change of the gain, up or down, to the limit of stability, dB.
        phase_margin: phase margin, degrees.
        delay_margin: additional delay to the limit of stability, s.
    """

    loop: str
    crossover: float
    gain_margin: float
    phase_margin: float
    delay_margin: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopDesign:
    """Gains of a controller, and stability margins of its loops."""

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
        step: period of the controller, s.
        tau: time constant of the velocity response, s.
        a_max: largest commanded horizontal acceleration, m/s^2.
        tilt_max: largest commanded tilt, rad.
        bandwidths: crossover frequencies of the loops.

    Raises:
        GainDesignError: the airframe is too weak for a_max, its rotors cannot control all axes, or a loop has margins
            below 6 dB or 45 degrees.
    """
    for field, value in (("step", step), ("tau", tau), ("a_max", a_max)):
        if not (math.isfinite(value) and value > 0):
            raise GainDesignError(f"{field}: {value:g} must be above 0")
    if not 0 < tilt_max < math.pi / 2:
        raise GainDesignError(f"tilt_max: {tilt_max:g} rad must be between 0 and pi/2")
    _check_thrust(airframe, a_max)
    matrix, mixer = _wrench_matrices(airframe)
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
    """Largest disturbance that the observer estimates, m/s^2.

    It is at most half of the acceleration at the largest tilt. Together with the limit of the vertical acceleration it
    stays below gravity, so that the required thrust always points upwards.

    Args:
        tilt_max: largest commanded tilt, rad.
    """
    return min(GRAVITY * math.tan(tilt_max) / 2, GRAVITY / 4)


def maximum_horizontal_force(airframe: Airframe, tilt_max: float) -> float:
    """Largest horizontal acceleration in level flight with `THRUST_SHARE` of the rotors' thrust, m/s^2.

    Args:
        airframe: the vehicle.
        tilt_max: largest commanded tilt, rad.
    """
    lift = THRUST_SHARE * ROTORS * airframe.thrust_max / airframe.mass
    return min(GRAVITY * math.tan(tilt_max), math.sqrt(max(lift**2 - GRAVITY**2, 0.0)))


class _Loops:
    """Loops about hover, closed from the innermost outwards, with their gains and margins."""

    def __init__(self, airframe: Airframe, step: float, bandwidths: Bandwidths, velocity_gain: float) -> None:
        import control  # noqa: PLC0415 - the import takes most of a second, and point masses do not need it

        self._control = control
        self.s = control.tf("s")
        self.margins: list[Margins] = []

        # A command computed from the state at one step acts on the rotors' thrust in the next, and that thrust acts on
        # the body in the one after: an average delay of half a step each.
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

        # The time constant fixes the gain of the velocity loop; its crossover follows.
        self.velocity_gain = velocity_gain
        tilt_actuation = tilt_closed * self.half_step
        self._store_margins("velocity", velocity_gain * tilt_actuation / self.s)
        # Observer of v' = a + d with both poles at the bandwidth; q is the transfer function from d to its estimate.
        self.observer_velocity_gain = 2 * bandwidths.observer
        self.observer_disturbance_gain = bandwidths.observer**2
        q = self.observer_disturbance_gain / (self.s + bandwidths.observer) ** 2
        self._store_margins_with_observer("velocity with observer", tilt_actuation, velocity_gain, q)
        altitude_feedback = self.climb_gain * (1 + self.altitude_gain / self.s)
        self._store_margins_with_observer("altitude with observer", self.actuation, altitude_feedback, q)

    def _place(self, loop: str, plant: Any, bandwidth: float) -> tuple[float, Any]:
        """Gain that makes gain times plant cross 0 dB at the bandwidth, and the closed loop."""
        gain = 1 / abs(complex(plant(1j * bandwidth)))
        self._store_margins(loop, gain * plant)
        return gain, self._control.feedback(gain * plant, 1)

    def _store_margins(self, loop: str, open_loop: Any) -> None:
        """Store the margins of a loop; a closed loop that is unstable has margins of 0."""
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

    def _store_margins_with_observer(self, loop: str, actuation: Any, feedback_law: Any, q: Any) -> None:
        """Store the margins of a loop about v = a / s with the observer, opened at the velocity measurement.

        With y the measurement and a = actuation u the modelled acceleration, the controller commands
        u = -feedback_law y - q (s y - a), thus u (1 - q actuation) = -(feedback_law + q s) y.
        """
        inner = self._control.feedback(1, q * actuation, sign=1)
        self._store_margins(loop, inner * actuation * (feedback_law + q * self.s) / self.s)


def _check_thrust(airframe: Airframe, a_max: float) -> None:
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


def _wrench_matrices(airframe: Airframe) -> tuple[Any, Any]:
    """Wrench matrix of the airframe, and its inverse."""
    matrix = wrench_matrix(airframe)
    if np.linalg.matrix_rank(matrix) < ROTORS:
        raise GainDesignError(
            f"airframe {airframe.name}: rotor_positions and yaw_ratio do not control all of roll, pitch and yaw"
        )
    off_centre = np.abs(matrix[1:].sum(axis=1)).max()
    if off_centre > 1e-9:
        raise GainDesignError(
            f"airframe {airframe.name}: equal thrusts exert a torque of {off_centre:g} N m per N, must be 0 "
            "(rotor_positions, yaw_ratio)"
        )
    return matrix, np.ascontiguousarray(np.linalg.inv(matrix))


def _check_margins(airframe: Airframe, step: float, margins: tuple[Margins, ...]) -> None:
    for loop in margins:
        subject = f"airframe {airframe.name} at a step of {step:g} s: the {loop.loop} loop's"
        for margin, value, minimum_margin, unit in (
            ("gain margin", loop.gain_margin, GAIN_MARGIN_MIN, "dB"),
            ("phase margin", loop.phase_margin, PHASE_MARGIN_MIN, "degrees"),
        ):
            if not value >= minimum_margin:
                raise GainDesignError(
                    f"{subject} {margin} is {value:.1f} {unit}, must be at least {minimum_margin:g} {unit}"
                )
