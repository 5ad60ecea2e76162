"""Step response: velocity of isolated drones under sequences of velocity commands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import Off, entry_kernel
from moflock_mj.dynamics.interface import Noise, advance
from moflock_mj.dynamics.point_mass import make_point_masses
from moflock_mj.dynamics.rigid_body import RigidBodyModel
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.state import TrueState

_SPACING = 100.0
"""Distance between drones, m, which prevents interaction."""


class StepResponse(NamedTuple):
    """Commanded and actual velocities, one row per integration step.

    Attributes:
        t: (T,), time, s, from which the command of a row applies.
        commanded: (T, 2, N), commanded velocity, m/s, world.
        velocity: (T, 2, N), actual velocity at that time, m/s, world.
    """

    t: NDArray[np.float64]
    commanded: NDArray[np.float64]
    velocity: NDArray[np.float64]


def step_response(
    scenario: Scenario, legs: NDArray[np.float64], seconds: float, dynamics: str = "rigid_body"
) -> StepResponse:
    """Fly one drone for each of N sequences of commands, from rest and without noise.

    Args:
        scenario: airframe, controller settings, altitude, battery, drag, and response of point masses; other effects
            are off.
        legs: (K, 2, N), consecutive horizontal velocity commands, m/s, world.
        seconds: duration of each command, s.
        dynamics: "rigid_body" or "point_mass", both with the integration step of rigid bodies.

    Raises:
        MoflockError: the airframe is unknown, or too weak for the scenario.
    """
    count, _, drones = legs.shape
    calm = scenario.replace(drones=drones, sigma_outer=0.0, wind=None, imu=None, downwash=None, faults=())
    step = calm.step_for("rigid_body")
    steps = round(seconds / step)
    world = TrueState.at_rest(drones)
    world.position[1] = _SPACING * np.arange(drones)
    world.position[2] = calm.altitude
    velocity = np.empty((count * steps, 2, drones))
    commanded = np.repeat(np.asarray(legs, np.float64), steps, axis=0)
    # The model owns the MuJoCo memory that the dynamics refer to, and must outlive the flight.
    simulation = RigidBodyModel(calm, step, 1, world, Off(), Off()) if dynamics == "rigid_body" else None
    model = simulation.dynamics if simulation else make_point_masses(calm, step, world, Off())
    _respond(model, world, commanded, _no_noise(drones), velocity)
    return StepResponse(step * np.arange(count * steps), commanded, velocity)


@entry_kernel
def _respond(
    model: NamedTuple,
    world: TrueState,
    commanded: NDArray[np.float64],
    noise: Noise,
    velocity: NDArray[np.float64],
) -> None:
    for k in range(commanded.shape[0]):
        for i in range(commanded.shape[2]):
            velocity[k, 0, i] = world.velocity[0, i]
            velocity[k, 1, i] = world.velocity[1, i]
        advance(model, world, commanded[k], noise.outer[0], noise, 1)


def _no_noise(drones: int) -> Noise:
    return Noise(
        outer=np.zeros((1, 2, drones)),
        gust=np.zeros((0, 5, drones)),
        inertial=np.zeros((1, 6, drones), np.float32),
        walk=np.zeros((0, 6, drones)),
    )
