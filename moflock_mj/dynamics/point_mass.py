"""Point-mass dynamics: RobotSim's robot model, a first-order velocity response with bounded acceleration and noise.

Where the wind is on, its force takes the place of the noise.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import Off, implements
from controllers.flight_control.gain_design import Bandwidths, maximum_horizontal_force
from controllers.flight_control.velocity import observe_axis
from controllers.geometry import clip_length
from moflock_mj.dynamics.interface import Noise, advance, take_fix, write_state
from moflock_mj.effects.wind import Wind, air_velocity, blow
from moflock_mj.scenario.effect_configs import PointMassConfig
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.state import TrueState


class PointMass(NamedTuple):
    """Figures of the scenario that a point mass obeys.

    Attributes:
        step: s.
        tau: s, time constant of the velocity.
        a_max: m/s^2, bound of the acceleration, before noise.
        sigma_outer: m^2/s^3, strength of the outer noise.
    """

    step: float
    tau: float
    a_max: float
    sigma_outer: float


class WindyPointMass(NamedTuple):
    """A point mass in moving air: the airframe's drag pushes it, and an observer as that of rigid bodies counters it.

    Attributes:
        step: s.
        tau: s, time constant of the velocity.
        a_max: m/s^2, bound of the acceleration that answers a velocity.
        wind: the air, see `moflock_mj.effects.wind`.
        body_drag: 1/m, acceleration over airspeed squared.
        rotor_drag: 1/s, acceleration over airspeed.
        observer_bandwidth: rad/s.
        wind_max: m/s^2, bound of the disturbance that the observer counters along each axis.
        observer: (4, N), predicted velocity (m/s), then disturbance (m/s^2), x and y.
    """

    step: float
    tau: float
    a_max: float
    wind: NamedTuple
    body_drag: float
    rotor_drag: float
    observer_bandwidth: float
    wind_max: float
    observer: NDArray[np.float64]


class LatePointMass(NamedTuple):
    """Point masses that answer late: what they do about a velocity is what was called for some time ago.

    The delay is inside the velocity's loop, as that of a tilting body is, so that noise is answered late as well.

    Attributes:
        response: what moves them, a PointMass or a WindyPointMass.
        late: share of a step by which the delay exceeds a whole number of them.
        past: (B, 2, N), m/s, commanded less measured velocity in the latest steps, as a ring.
        command: (2, N), m/s, from which the response makes the late answer.
        steps: (1,), made.
    """

    response: NamedTuple
    late: float
    past: NDArray[np.float64]
    command: NDArray[np.float64]
    steps: NDArray[np.int64]


def make_point_masses(
    scenario: Scenario, step: float, world: TrueState, wind: Wind | Off
) -> PointMass | WindyPointMass | LatePointMass:
    """The point masses of a scenario, where `world` has them at the start.

    Args:
        scenario: what is flown.
        step: s.
        world: the start.
        wind: the air, see `moflock_mj.effects.wind`.

    Raises:
        AirframeError: with wind on, the airframe is unknown.
        ScenarioError: the wind is too much for the airframe.
    """
    asked = scenario.point_mass or PointMassConfig(tau=scenario.tau, a_max=scenario.a_max)
    response = _make_response(scenario, asked, step, world, wind)
    if asked.delay == 0:
        return response
    # An answer is held for a step, and so is late by half of one already.
    whole, late = divmod(max(asked.delay / step - 0.5, 0.0), 1.0)
    return LatePointMass(
        response=response,
        late=late,
        past=np.zeros((int(whole) + 2, 2, scenario.drones)),
        command=np.zeros((2, scenario.drones)),
        steps=np.zeros(1, np.int64),
    )


def _make_response(
    scenario: Scenario, asked: PointMassConfig, step: float, world: TrueState, wind: Wind | Off
) -> PointMass | WindyPointMass:
    if isinstance(wind, Off):
        return PointMass(step, asked.tau, asked.a_max, scenario.sigma_outer)
    from moflock_mj.dynamics.airframe_models import load_airframe  # noqa: PLC0415
    from moflock_mj.effects.battery import make_battery  # noqa: PLC0415
    from moflock_mj.effects.drag import air_drag, wind_push  # noqa: PLC0415 - in calm air point masses fly without MuJoCo
    from moflock_mj.effects.feasibility import check_feasible  # noqa: PLC0415

    airframe = load_airframe(scenario.airframe)
    drag = air_drag(scenario, airframe)
    check_feasible(scenario, airframe, drag, make_battery(scenario, airframe))
    observer = np.zeros((4, scenario.drones))
    observer[:2] = world.velocity[:2]
    observer[2:] = wind_push(drag, wind.speed, airframe.mass) * wind.along[:, None]  # see `RigidBodyModel`
    return WindyPointMass(
        step=step,
        tau=asked.tau,
        a_max=asked.a_max,
        wind=wind,
        body_drag=drag.body / airframe.mass,
        rotor_drag=drag.rotors / airframe.mass,
        observer_bandwidth=Bandwidths().observer,
        wind_max=maximum_horizontal_force(airframe, scenario.tilt_max),
        observer=observer,
    )


@implements(advance, PointMass)
def advance_point_masses(
    dynamics: PointMass,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: Noise,
    steps: int,
) -> None:
    """Euler-Maruyama steps of v' = clip((v_desired - v_measured) / tau, a_max) + outer noise, x' = v."""
    step, kick = dynamics.step, sqrt(2 * dynamics.sigma_outer * dynamics.step)
    x, y, _ = world.position
    vx, vy, _ = world.velocity
    for k in range(steps):
        noise_x, noise_y = noise.outer[k]
        for i in range(x.size):
            ax = (desired[0, i] - vx[i] - velocity_error[0, i]) / dynamics.tau
            ay = (desired[1, i] - vy[i] - velocity_error[1, i]) / dynamics.tau
            gain = step * dynamics.a_max / max(sqrt(ax * ax + ay * ay), dynamics.a_max)
            x[i] += step * vx[i]
            y[i] += step * vy[i]
            vx[i] += gain * ax + kick * noise_x[i]
            vy[i] += gain * ay + kick * noise_y[i]


@implements(advance, WindyPointMass)
def advance_in_wind(
    dynamics: WindyPointMass,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: Noise,
    steps: int,
) -> None:
    """Euler steps of v' = clip((v_desired - v_measured) / tau, a_max) - estimated drag + drag, x' = v."""
    blow(dynamics.wind, world.velocity, noise.gust)
    step, position, velocity, observer = dynamics.step, world.position, world.velocity, dynamics.observer
    gain, disturbance_gain = 2 * dynamics.observer_bandwidth, dynamics.observer_bandwidth**2
    for _ in range(steps):
        for i in range(position.shape[1]):
            measured = (velocity[0, i] + velocity_error[0, i], velocity[1, i] + velocity_error[1, i])
            wanted = clip_length(
                (desired[0, i] - measured[0]) / dynamics.tau,
                (desired[1, i] - measured[1]) / dynamics.tau,
                dynamics.a_max,
            )
            air = air_velocity(dynamics.wind, i)
            wind_x, wind_y = air[0] - velocity[0, i], air[1] - velocity[1, i]
            drag = dynamics.body_drag * sqrt(wind_x * wind_x + wind_y * wind_y) + dynamics.rotor_drag
            pushed = (drag * wind_x, drag * wind_y)
            for axis in range(2):
                push = wanted[axis] - observer[2 + axis, i]
                observer[axis, i], observer[2 + axis, i] = observe_axis(
                    observer[axis, i],
                    observer[2 + axis, i],
                    measured[axis],
                    push,
                    gain,
                    disturbance_gain,
                    dynamics.wind_max,
                    step,
                )
                position[axis, i] += step * velocity[axis, i]
                velocity[axis, i] += step * (push + pushed[axis])


@implements(advance, LatePointMass)
def advance_late(
    dynamics: LatePointMass,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: Noise,
    steps: int,
) -> None:
    """The response's own steps, each with the command that leads to the late answer."""
    past, kept, share = dynamics.past, dynamics.past.shape[0], dynamics.late
    for k in range(steps):
        now = dynamics.steps[0]
        newer, older = (now - kept + 2) % kept, (now - kept + 1) % kept
        for axis in range(2):
            for i in range(desired.shape[1]):
                measured = world.velocity[axis, i] + velocity_error[axis, i]
                past[now % kept, axis, i] = desired[axis, i] - measured
                dynamics.command[axis, i] = (1 - share) * past[newer, axis, i] + share * past[older, axis, i] + measured
        of_step = Noise(noise.outer[k : k + 1], noise.gust[: 1 if k == 0 else 0], noise.inertial, noise.walk)
        advance(dynamics.response, world, dynamics.command, velocity_error, of_step, 1)
        dynamics.steps[0] += 1


@implements(take_fix, LatePointMass)
@implements(take_fix, PointMass)
@implements(take_fix, WindyPointMass)
def _take_no_fix(dynamics: NamedTuple, velocity_error: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
    pass


@implements(write_state, LatePointMass)
@implements(write_state, PointMass)
@implements(write_state, WindyPointMass)
def write_point_masses(
    dynamics: NamedTuple,
    world: TrueState,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
) -> None:
    for i in range(qpos.shape[0]):
        for axis in range(3):
            qpos[i, axis] = world.position[axis, i]
            qvel[i, axis] = world.velocity[axis, i]
        qpos[i, 3] = 1.0
