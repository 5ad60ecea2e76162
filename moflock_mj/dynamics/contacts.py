"""When contacts need MuJoCo's collision detection, and the bounds of the forces that decide it."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from controllers.airframe import ROTORS
from controllers.compiling import Off, hot_kernel, hot_stage, implements, kernel
from moflock_mj.dynamics.bodies import GROUND, RigidBody
from moflock_mj.effects.disturbance import outer_force
from moflock_mj.effects.downwash import washed
from moflock_mj.effects.drag import AirDrag
from moflock_mj.effects.wind import air_velocity


@hot_stage
def air_force_bound(drag: NamedTuple, wind: NamedTuple, jets: NamedTuple, speed: float, drones: int) -> float:
    """More than the air can push a body with in a beat, N; chosen by the type of `drag`.

    Args:
        drag: figures of the vehicle.
        wind: the air.
        jets: the downwash.
        speed: m/s, that no body exceeds.
        drones: how many there are.
    """
    raise NotImplementedError


@kernel
def _largest_wash(jets: NamedTuple, drones: int) -> float:
    largest = 0.0
    for i in range(drones):
        largest = max(largest, washed(jets, i))
    return largest


@implements(air_force_bound, Off)
def _wash_bound(drag: Off, wind: NamedTuple, jets: NamedTuple, speed: float, drones: int) -> float:  # noqa: ARG001
    return _largest_wash(jets, drones)


@implements(air_force_bound, AirDrag)
def _air_bound(drag: AirDrag, wind: NamedTuple, jets: NamedTuple, speed: float, drones: int) -> float:
    fastest = 0.0
    for i in range(drones):
        air_x, air_y, air_z = air_velocity(wind, i)
        fastest = max(fastest, sqrt(air_x * air_x + air_y * air_y + air_z * air_z))
    airspeed = speed + fastest
    # The rotors' drag goes with the root of thrust over weight, which is under 4 for every airframe that can be flown.
    return (drag.body * airspeed + 2 * drag.rotors) * airspeed + _largest_wash(jets, drones)


@kernel
def _may_touch(plant: RigidBody, steps: int) -> bool:
    """Whether anything could come into contact within the next steps, by a bound on how far bodies can move."""
    gains, duration = plant.gains, steps * plant.step
    drones = plant.qpos.shape[0]
    fastest_sq, lowest = 0.0, np.inf
    for i in range(drones):
        vx, vy, vz = plant.qvel[i, 0], plant.qvel[i, 1], plant.qvel[i, 2]
        fastest_sq = max(fastest_sq, vx * vx + vy * vy + vz * vz)
        lowest = min(lowest, plant.qpos[i, 2])
    # Full thrust along gravity, ten deviations of the outer noise's velocity, and what the air can do.
    gusts = 10 * outer_force(plant.outer) / gains.mass * plant.step * sqrt(steps)
    thrust_acceleration = ROTORS * gains.thrust_max / gains.mass
    speed = sqrt(fastest_sq) + gusts + duration * (thrust_acceleration + 9.81)
    speed += duration * air_force_bound(plant.drag, plant.wind, plant.downwash, speed, drones) / gains.mass
    way = plant.reach + duration * speed
    if lowest < way:
        return True
    for i in range(drones):
        for j in range(i + 1, drones):
            dx = plant.qpos[j, 0] - plant.qpos[i, 0]
            dy = plant.qpos[j, 1] - plant.qpos[i, 1]
            dz = plant.qpos[j, 2] - plant.qpos[i, 2]
            if dx * dx + dy * dy + dz * dz < 4 * way * way:
                return True
    return False


@hot_kernel
def _is_pushed(plant: RigidBody, i: int) -> bool:
    """Whether contact forces acted on body i in the latest step."""
    pushed = False
    for k in range(6):
        pushed |= plant.qfrc_constraint[i, k] != 0
    return pushed


@kernel
def _mark_touches(plant: RigidBody) -> None:
    """Note the first step in which contact forces act on a body, and what is nearest to it then."""
    extremes, qpos = plant.extremes, plant.qpos
    for i in range(qpos.shape[0]):
        if extremes.touch_step[i] >= 0 or not _is_pushed(plant, i):
            continue
        nearest_sq, nearest = qpos[i, 2] ** 2, GROUND
        for j in range(qpos.shape[0]):
            if j != i and _is_pushed(plant, j):
                dx, dy, dz = qpos[j, 0] - qpos[i, 0], qpos[j, 1] - qpos[i, 1], qpos[j, 2] - qpos[i, 2]
                distance_sq = dx * dx + dy * dy + dz * dz
                if distance_sq < nearest_sq:
                    nearest_sq, nearest = distance_sq, j
        extremes.touch_step[i], extremes.touch_with[i] = extremes.steps[0], nearest
