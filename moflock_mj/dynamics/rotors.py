"""Rotor model: thrust with lag, wrench on the body, energy, and stopped rotors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS
from controllers.compiling import hot_kernel, hot_stage, implements, kernel
from controllers.flight_control.cascade import Gains, rotor_wrench
from moflock_mj.dynamics.bodies import RigidBody
from moflock_mj.effects.battery import battery_lift
from moflock_mj.effects.disturbance import draw_force
from moflock_mj.effects.downwash import downwash_at
from moflock_mj.effects.fault_injection import FaultSchedule
from moflock_mj.effects.ground_effect import ground_lift
from moflock_mj.effects.rotor_power import rotor_power


@hot_stage
def delivered_wrench(
    faults: NamedTuple, gains: Gains, thrust: NDArray[np.float64], i: int
) -> tuple[float, float, float, float]:
    """Wrench of the rotors of drone i from thrusts (N, 4), N; without faults that of `rotor_wrench`."""
    return rotor_wrench(gains, thrust[i])


@implements(delivered_wrench, FaultSchedule)
def _faulty_wrench(
    faults: FaultSchedule, gains: Gains, thrust: NDArray[np.float64], i: int
) -> tuple[float, float, float, float]:
    for rotor in range(ROTORS):
        faults.delivered[i, rotor] = faults.effectiveness[i, rotor] * thrust[i, rotor]
    return rotor_wrench(gains, faults.delivered[i])


@hot_kernel
def apply_rotor_wrench(dynamics: RigidBody, noise: NDArray[np.float64], k: int, i: int) -> None:
    """Apply rotor wrench, velocity disturbance and downwash to body i; then advance the rotor lag.

    As in MuJoCo's `filterexact` actuators, the thrust of a step is the one before this step's lag.
    `dynamics.state.thrust` is the thrust that the controller assumes. Changes of it by battery, ground and faults act
    as a disturbance on the controller's observer.
    """
    gains, qpos, force, thrust = (
        dynamics.model.gains,
        dynamics.state.qpos,
        dynamics.state.qfrc_applied,
        dynamics.state.thrust,
    )
    lift = battery_lift(dynamics.effects.battery, i) * ground_lift(dynamics.effects.ground_effect, qpos[i, 2])
    total, torque_x, torque_y, torque_z = delivered_wrench(dynamics.effects.faults, gains, thrust, i)
    total *= lift
    noise_x, noise_y = draw_force(dynamics.effects.disturbance, noise, k, i)
    qw, qx, qy, qz = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
    force[i, 0] = 2 * (qx * qz + qw * qy) * total + noise_x
    force[i, 1] = 2 * (qy * qz - qw * qx) * total + noise_y
    force[i, 2] = (1 - 2 * (qx * qx + qy * qy)) * total - downwash_at(dynamics.effects.downwash, i)
    force[i, 3], force[i, 4], force[i, 5] = lift * torque_x, lift * torque_y, lift * torque_z
    for rotor in range(ROTORS):
        thrust[i, rotor] += gains.rotor_blend * (dynamics.state.thrust_command[i, rotor] - thrust[i, rotor])


@kernel
def draw_power(dynamics: RigidBody, duration: float) -> None:
    """Add the energy of an interval at the present power of the rotors."""
    thrust, statistics = dynamics.state.thrust, dynamics.statistics
    for i in range(thrust.shape[0]):
        lift = battery_lift(dynamics.effects.battery, i)
        a, b, c, d = lift * thrust[i, 0], lift * thrust[i, 1], lift * thrust[i, 2], lift * thrust[i, 3]
        statistics.power[i] = rotor_power(dynamics.model.power_factor, a, b, c, d)
        statistics.energy[i] += statistics.power[i] * duration


@kernel
def stop_rotors(dynamics: RigidBody) -> None:
    """Set the commands of stopped rotors to zero."""
    for i in range(dynamics.state.stopped.shape[0]):
        for rotor in range(ROTORS):
            if dynamics.state.stopped[i, rotor]:
                dynamics.state.thrust_command[i, rotor] = 0.0


@hot_kernel
def update_statistics(dynamics: RigidBody, i: int) -> None:
    """Update the statistics of body i by the previous step."""
    statistics, gains = dynamics.statistics, dynamics.model.gains
    qx, qy = dynamics.state.qpos[i, 4], dynamics.state.qpos[i, 5]
    statistics.upright[i] = min(statistics.upright[i], 1 - 2 * (qx * qx + qy * qy))
    statistics.altitude_error[i] = max(
        statistics.altitude_error[i], abs(dynamics.state.qpos[i, 2] - dynamics.state.altitude[i])
    )
    saturated = False
    for rotor in range(ROTORS):
        command = dynamics.state.thrust_command[i, rotor]
        saturated |= command <= 0 or command >= gains.thrust_max
    statistics.saturated[i] += saturated
