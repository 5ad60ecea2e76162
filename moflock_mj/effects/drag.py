"""Aerodynamic drag of body and rotors."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS, Airframe
from controllers.compiling import Off, implements, stage
from moflock_mj.effects.wind import air_velocity
from moflock_mj.scenario import effect_configs
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.constants import AIR_DENSITY


class Drag(NamedTuple):
    """Drag of one body and its rotors.

    Attributes:
        body: force divided by squared airspeed, kg/m.
        rotors: force divided by airspeed along the rotor plane, in hover, kg/s.
        weight: weight of the vehicle, N.
    """

    body: float
    rotors: float
    weight: float


def make_drag(scenario: Scenario, airframe: Airframe) -> Drag | Off:
    """Create the drag of a scenario; wind without a drag section uses the airframe's own drag."""
    if scenario.drag is None and scenario.wind is None:
        return Off()
    return air_drag(scenario, airframe)


def air_drag(scenario: Scenario, airframe: Airframe) -> Drag:
    """Create the drag from a scenario's section, with the airframe's own values for absent fields."""
    drag = scenario.drag or effect_configs.DragConfig()
    area = airframe.drag_area if drag.area is None else drag.area
    rotor = airframe.rotor_drag if drag.rotor is None else drag.rotor
    return Drag(AIR_DENSITY * area / 2, airframe.mass * rotor, ROTORS * airframe.hover_thrust())


def wind_push(drag: Drag, speed: float, mass: float) -> float:
    """Acceleration of a level body in hover by air of a given speed (m/s), m/s^2."""
    return (drag.body * speed + drag.rotors) * speed / mass


@stage
def add_drag(
    drag: NamedTuple,
    wind: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    thrust: NDArray[np.float64],
    force: NDArray[np.float64],
) -> None:
    """Add the drag of body and rotors to the forces on all bodies; no force without drag.

    The drag of the body is quadratic in the air-relative velocity v: -rho/2 A |v| v, independent of direction. The drag
    of the rotors is linear: -c w v_p with v_p the component of v in the rotor plane and w the sum of rotor speeds
    (P. Martin, E. Salaun: The True Role of Accelerometer Feedback in Quadrotor Control, ICRA 2010). With equal rotors w
    is proportional to the square root of the thrust, so that its value in hover defines the drag.

    Args:
        drag: figures of the vehicle.
        wind: the wind, or Off.
        qpos: (N, 7), position (m, world) and quaternion w x y z.
        qvel: (N, 6), velocity (m/s, world) and body rates.
        thrust: (N, 4), thrust of each rotor, N.
        force: (N, 6), generalised forces, the first three N, world; increased.
    """


@implements(add_drag, Drag)
def _add_air_drag(
    drag: Drag,
    wind: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    thrust: NDArray[np.float64],
    force: NDArray[np.float64],
) -> None:
    rotors = drag.rotors / sqrt(drag.weight)
    for i in range(qpos.shape[0]):
        air_x, air_y, air_z = air_velocity(wind, i)
        vx, vy, vz = qvel[i, 0] - air_x, qvel[i, 1] - air_y, qvel[i, 2] - air_z
        qw, qx, qy, qz = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
        zx, zy, zz = 2 * (qx * qz + qw * qy), 2 * (qy * qz - qw * qx), 1 - 2 * (qx * qx + qy * qy)
        along = rotors * sqrt(thrust[i, 0] + thrust[i, 1] + thrust[i, 2] + thrust[i, 3])
        axial = along * (vx * zx + vy * zy + vz * zz)
        along += drag.body * sqrt(vx * vx + vy * vy + vz * vz)
        force[i, 0] += axial * zx - along * vx
        force[i, 1] += axial * zy - along * vy
        force[i, 2] += axial * zz - along * vz
