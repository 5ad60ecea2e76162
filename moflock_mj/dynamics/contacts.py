"""Contacts: a bound on the motion of bodies that decides on collision detection, and the record of touches."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from controllers.airframe import GRAVITY, ROTORS
from controllers.compiling import hot_kernel, hot_stage, implements, kernel
from moflock_mj.dynamics.bodies import GROUND, RigidBody
from moflock_mj.effects.disturbance import outer_force
from moflock_mj.effects.downwash import downwash_at
from moflock_mj.effects.drag import Drag
from moflock_mj.effects.wind import air_velocity


@hot_stage
def air_force_bound(drag: NamedTuple, wind: NamedTuple, downwash: NamedTuple, speed: float, drones: int) -> float:
    """Upper bound of the force of the air on a body in an interval, N; without drag that of the downwash.

    Args:
        drag: figures of the vehicle, or Off.
        wind: the wind, or Off.
        downwash: the downwash, or Off.
        speed: upper bound of the speed of the bodies, m/s.
        drones: number of drones.
    """
    return _largest_downwash(downwash, drones)


@kernel
def _largest_downwash(downwash: NamedTuple, drones: int) -> float:
    largest = 0.0
    for i in range(drones):
        largest = max(largest, downwash_at(downwash, i))
    return largest


@implements(air_force_bound, Drag)
def _drag_force_bound(drag: Drag, wind: NamedTuple, downwash: NamedTuple, speed: float, drones: int) -> float:
    fastest = 0.0
    for i in range(drones):
        air_x, air_y, air_z = air_velocity(wind, i)
        fastest = max(fastest, sqrt(air_x * air_x + air_y * air_y + air_z * air_z))
    airspeed = speed + fastest
    # Rotor drag scales with the square root of thrust over weight, and that ratio is below 4 for every airframe.
    return (drag.body * airspeed + 2 * drag.rotors) * airspeed + _largest_downwash(downwash, drones)


@kernel
def may_touch(dynamics: RigidBody, steps: int) -> bool:
    """True if a contact is possible within the next steps, by an upper bound on the motion of the bodies."""
    gains, duration = dynamics.model.gains, steps * dynamics.model.step
    drones = dynamics.state.qpos.shape[0]
    fastest_sq, lowest = 0.0, np.inf
    for i in range(drones):
        vx, vy, vz = dynamics.state.qvel[i, 0], dynamics.state.qvel[i, 1], dynamics.state.qvel[i, 2]
        fastest_sq = max(fastest_sq, vx * vx + vy * vy + vz * vz)
        lowest = min(lowest, dynamics.state.qpos[i, 2])
    # Full thrust along gravity, ten standard deviations of the velocity disturbance, and the force of the air.
    gusts = 10 * outer_force(dynamics.effects.disturbance) / gains.mass * dynamics.model.step * sqrt(steps)
    thrust_acceleration = ROTORS * gains.thrust_max / gains.mass
    speed = sqrt(fastest_sq) + gusts + duration * (thrust_acceleration + GRAVITY)
    speed += (
        duration
        * air_force_bound(dynamics.effects.drag, dynamics.effects.wind, dynamics.effects.downwash, speed, drones)
        / gains.mass
    )
    distance = dynamics.model.reach + duration * speed
    if lowest < distance:
        return True
    for i in range(drones):
        for j in range(i + 1, drones):
            dx = dynamics.state.qpos[j, 0] - dynamics.state.qpos[i, 0]
            dy = dynamics.state.qpos[j, 1] - dynamics.state.qpos[i, 1]
            dz = dynamics.state.qpos[j, 2] - dynamics.state.qpos[i, 2]
            if dx * dx + dy * dy + dz * dz < 4 * distance * distance:
                return True
    return False


@hot_kernel
def _has_contact(dynamics: RigidBody, i: int) -> bool:
    """True if contact forces acted on body i in the latest step."""
    contact = False
    for k in range(6):
        contact |= dynamics.state.qfrc_constraint[i, k] != 0
    return contact


@kernel
def mark_touches(dynamics: RigidBody) -> None:
    """Record the first step with contact forces on a body, and the nearest touched drone or the ground."""
    statistics, qpos = dynamics.statistics, dynamics.state.qpos
    for i in range(qpos.shape[0]):
        if statistics.touch_step[i] >= 0 or not _has_contact(dynamics, i):
            continue
        nearest_sq, nearest = qpos[i, 2] ** 2, GROUND
        for j in range(qpos.shape[0]):
            if j != i and _has_contact(dynamics, j):
                dx, dy, dz = qpos[j, 0] - qpos[i, 0], qpos[j, 1] - qpos[i, 1], qpos[j, 2] - qpos[i, 2]
                distance_sq = dx * dx + dy * dy + dz * dz
                if distance_sq < nearest_sq:
                    nearest_sq, nearest = distance_sq, j
        statistics.touch_step[i], statistics.touch_with[i] = statistics.steps[0], nearest
