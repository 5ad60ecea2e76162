"""Point-mass dynamics: RobotSim's robot model, a first-order velocity response with bounded acceleration and noise.

With wind, the drag in moving air replaces the noise.
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
    """Point masses without wind.

    Attributes:
        step: integration step, s.
        tau: time constant of the velocity, s.
        a_max: largest acceleration before noise, m/s^2.
        sigma_outer: strength of the velocity disturbance, m^2/s^3.
    """

    step: float
    tau: float
    a_max: float
    sigma_outer: float


class WindyPointMass(NamedTuple):
    """Point masses in wind, with the airframe's drag and the disturbance observer of rigid bodies.

    Attributes:
        step: integration step, s.
        tau: time constant of the velocity, s.
        a_max: largest acceleration in response to a velocity error, m/s^2.
        wind: the wind, see `moflock_mj.effects.wind`.
        body_drag: acceleration divided by squared airspeed, 1/m.
        rotor_drag: acceleration divided by airspeed, 1/s.
        observer_bandwidth: bandwidth of the observer, rad/s.
        wind_max: largest estimated disturbance along each axis, m/s^2.
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
    """Point masses with a delay between velocity error and acceleration.

    The delay is inside the velocity loop, as that of a tilting body, and also delays the response to noise.

    Attributes:
        response: dynamics without delay, a PointMass or a WindyPointMass.
        late: fraction of a step by which the delay exceeds a whole number of steps.
        past: (B, 2, N), ring buffer of the velocity errors (commanded less measured) of the latest steps, m/s.
        command: (2, N), command to the response that produces the delayed acceleration, m/s.
        steps: (1,), number of steps.
    """

    response: NamedTuple
    late: float
    past: NDArray[np.float64]
    command: NDArray[np.float64]
    steps: NDArray[np.int64]


def make_point_masses(
    scenario: Scenario, step: float, world: TrueState, wind: Wind | Off
) -> PointMass | WindyPointMass | LatePointMass:
    """Create the point masses of a scenario.

    Args:
        scenario: the scenario.
        step: integration step, s.
        world: the initial state.
        wind: the wind, or Off, see `moflock_mj.effects.wind`.

    Raises:
        AirframeError: with wind on, the airframe is unknown.
        ScenarioError: the wind is too much for the airframe.
    """
    given = scenario.point_mass or PointMassConfig(tau=scenario.tau, a_max=scenario.a_max)
    response = _make_response(scenario, given, step, world, wind)
    if given.delay == 0:
        return response
    # The acceleration is constant over a step, which already is a delay of half a step.
    whole, late = divmod(max(given.delay / step - 0.5, 0.0), 1.0)
    return LatePointMass(
        response=response,
        late=late,
        past=np.zeros((int(whole) + 2, 2, scenario.drones)),
        command=np.zeros((2, scenario.drones)),
        steps=np.zeros(1, np.int64),
    )


def _make_response(
    scenario: Scenario, given: PointMassConfig, step: float, world: TrueState, wind: Wind | Off
) -> PointMass | WindyPointMass:
    if isinstance(wind, Off):
        return PointMass(step, given.tau, given.a_max, scenario.sigma_outer)
    from moflock_mj.dynamics.airframe_models import load_airframe  # noqa: PLC0415
    from moflock_mj.effects.battery import make_battery  # noqa: PLC0415
    from moflock_mj.effects.drag import air_drag, wind_push  # noqa: PLC0415 - without wind, point masses do not need MuJoCo
    from moflock_mj.effects.feasibility import check_feasible  # noqa: PLC0415

    airframe = load_airframe(scenario.airframe)
    drag = air_drag(scenario, airframe)
    check_feasible(scenario, airframe, drag, make_battery(scenario, airframe))
    observer = np.zeros((4, scenario.drones))
    observer[:2] = world.velocity[:2]
    observer[2:] = wind_push(drag, wind.speed, airframe.mass) * wind.along[:, None]  # see `RigidBodyModel`
    return WindyPointMass(
        step=step,
        tau=given.tau,
        a_max=given.a_max,
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
    """Euler-Maruyama steps of v' = clip((v_desired - v_measured) / tau, a_max) + noise, x' = v."""
    step, noise_scale = dynamics.step, sqrt(2 * dynamics.sigma_outer * dynamics.step)
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
            vx[i] += gain * ax + noise_scale * noise_x[i]
            vy[i] += gain * ay + noise_scale * noise_y[i]


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
            feedback = clip_length(
                (desired[0, i] - measured[0]) / dynamics.tau,
                (desired[1, i] - measured[1]) / dynamics.tau,
                dynamics.a_max,
            )
            air = air_velocity(dynamics.wind, i)
            wind_x, wind_y = air[0] - velocity[0, i], air[1] - velocity[1, i]
            drag = dynamics.body_drag * sqrt(wind_x * wind_x + wind_y * wind_y) + dynamics.rotor_drag
            drag_acceleration = (drag * wind_x, drag * wind_y)
            for axis in range(2):
                commanded = feedback[axis] - observer[2 + axis, i]
                observer[axis, i], observer[2 + axis, i] = observe_axis(
                    observer[axis, i],
                    observer[2 + axis, i],
                    measured[axis],
                    commanded,
                    gain,
                    disturbance_gain,
                    dynamics.wind_max,
                    step,
                )
                position[axis, i] += step * velocity[axis, i]
                velocity[axis, i] += step * (commanded + drag_acceleration[axis])


@implements(advance, LatePointMass)
def advance_late(
    dynamics: LatePointMass,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: Noise,
    steps: int,
) -> None:
    """Steps of the response, each with the command that produces the delayed acceleration."""
    past, length, fraction = dynamics.past, dynamics.past.shape[0], dynamics.late
    for k in range(steps):
        now = dynamics.steps[0]
        newer, older = (now - length + 2) % length, (now - length + 1) % length
        for axis in range(2):
            for i in range(desired.shape[1]):
                measured = world.velocity[axis, i] + velocity_error[axis, i]
                past[now % length, axis, i] = desired[axis, i] - measured
                dynamics.command[axis, i] = (
                    (1 - fraction) * past[newer, axis, i] + fraction * past[older, axis, i] + measured
                )
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
