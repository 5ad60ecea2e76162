"""Forces of the air on bodies: drag of body and rotors, the jet below each drone, the ground."""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS, Airframe
from controllers.compiling import Off, hot_stage, implements, kernel, stage
from moflock_mj import air
from moflock_mj.scenario import Scenario
from moflock_mj.wind import air_velocity

AIR_DENSITY = 1.225
"""kg/m^3 at sea level (ISO 2533, International Standard Atmosphere)."""


class AirDrag(NamedTuple):
    """Drag of one body and its rotors.

    Attributes:
        body: kg/m, force over airspeed squared.
        rotors: kg/s, force over airspeed along the rotor plane, in hover.
        weight: N.
    """

    body: float
    rotors: float
    weight: float


class Jets(NamedTuple):
    """The jet of air below each drone.

    Attributes:
        drag: kg/m, of a drone's rotor discs: force over air speed squared.
        thrust: N, of all rotors of a drone in hover.
        fastest: m/s, of a jet that has not yet slowed down.
        force: (N,), N, downwards, on each drone.
    """

    drag: float
    thrust: float
    fastest: float
    force: NDArray[np.float64]


class Ground(NamedTuple):
    """Ground that the rotors feel.

    Attributes:
        height: m.
        rotor_radius: m.
    """

    height: float
    rotor_radius: float


def make_drag(scenario: Scenario, airframe: Airframe) -> AirDrag | Off:
    """The drag of a scenario: that of its section, and in wind at least that of an empty one."""
    if scenario.drag is None and scenario.wind is None:
        return Off()
    return air_drag(scenario, airframe)


def air_drag(scenario: Scenario, airframe: Airframe) -> AirDrag:
    """Drag as a scenario's section tells it, or that of an empty one."""
    drag = scenario.drag or air.Drag()
    area = airframe.drag_area if drag.area is None else drag.area
    rotor = airframe.rotor_drag if drag.rotor is None else drag.rotor
    return AirDrag(AIR_DENSITY * area / 2, airframe.mass * rotor, ROTORS * airframe.hover_thrust())


def wind_push(drag: AirDrag, speed: float, mass: float) -> float:
    """Acceleration with which air of a speed (m/s) pushes a level body in hover, m/s^2."""
    return (drag.body * speed + drag.rotors) * speed / mass


def make_jets(scenario: Scenario, airframe: Airframe) -> Jets | Off:
    """The downwash of a scenario."""
    if scenario.downwash is None:
        return Off()
    discs, thrust = ROTORS * pi * airframe.rotor_radius**2, ROTORS * airframe.hover_thrust()
    return Jets(
        drag=AIR_DENSITY * scenario.downwash.drag_coefficient * discs / 2,
        thrust=thrust,
        fastest=2 * sqrt(thrust / (2 * AIR_DENSITY * discs)),
        force=np.zeros(scenario.drones),
    )


def make_ground(scenario: Scenario, airframe: Airframe) -> Ground | Off:
    """The ground effect of a scenario."""
    return Off() if scenario.ground_effect is None else Ground(scenario.ground_effect.height, airframe.rotor_radius)


@stage
def add_drag(
    drag: NamedTuple,
    wind: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    thrust: NDArray[np.float64],
    force: NDArray[np.float64],
) -> None:
    """Add the drag of body and rotors to the forces on all bodies; chosen by the type of `drag`.

    The body's is quadratic in the air-relative velocity v: -rho/2 A |v| v, the same in all directions. The rotors' is
    linear: -c w v_p with v_p the part of v in the rotor plane and w the sum of rotor speeds (P. Martin, E. Salaun: The
    True Role of Accelerometer Feedback in Quadrotor Control, ICRA 2010). With equal rotors w goes with the root of the
    thrust, so that it is told by its value in hover.

    Args:
        drag: figures of the vehicle.
        wind: the air.
        qpos: (N, 7), position (m, world) and quaternion w x y z.
        qvel: (N, 6), velocity (m/s, world) and body rates.
        thrust: (N, 4), N, of the rotors.
        force: (N, 6), the first three N, world; added to.
    """


@implements(add_drag, Off)
def _add_no_drag(
    drag: Off,
    wind: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    thrust: NDArray[np.float64],
    force: NDArray[np.float64],
) -> None:
    pass


@implements(add_drag, AirDrag)
def _add_air_drag(
    drag: AirDrag,
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


@stage
def wash(jets: NamedTuple, qpos: NDArray[np.float64]) -> None:
    """Find the force of each drone's jet on those below it; chosen by the type of `jets`.

    The jet of a hovering drone is a round turbulent one that carries the momentum of its thrust T: on its axis the air
    moves down at U = B 2 sqrt(T / (pi rho)) / z at a distance z, no faster than the slipstream of momentum theory, and
    beside it at U / (1 + a (r/z)^2)^2 with a = (sqrt(2) - 1) / S^2; B = 5.8, S = 0.094 (Hussein, Capp, George 1994,
    in S. B. Pope: Turbulent Flows, 2000, section 5.1). That quadrotors blow such jets from some 2.5 of their lengths
    down is measured by Bauersfeld et al. (Robotics meets Fluid Dynamics, IEEE RA-L, 2025). A drone in a jet is pushed
    down by the drag of its rotor discs. Jets add by their momentum. They blow straight down, whatever wind and tilt.

    Args:
        jets: figures of the vehicle; the forces in it are written.
        qpos: (N, 7), the first three m, world.
    """


@hot_stage
def washed(jets: NamedTuple, i: int) -> float:
    """Force of the jets on drone i, N, downwards; chosen by the type of `jets`."""
    raise NotImplementedError


JET_DECAY = 5.8
JET_SPREAD = 0.094
_JET_PROFILE = (sqrt(2.0) - 1) / JET_SPREAD**2
_JET_EDGE = 0.5
"""Of r / z. Farther out the air moves at less than a hundredth of the axis's speed, and the force is left out."""


@implements(wash, Off)
def _wash_nothing(jets: Off, qpos: NDArray[np.float64]) -> None:
    pass


@implements(washed, Off)
def _not_washed(jets: Off, i: int) -> float:  # noqa: ARG001
    return 0.0


@implements(washed, Jets)
def _washed(jets: Jets, i: int) -> float:
    return float(jets.force[i])


@kernel
def jet_speed(jets: Jets, below: float, beside_sq: float) -> float:
    """Speed of the air in a jet, m/s, downwards.

    Args:
        jets: figures of the vehicle.
        below: m, how far under the drone; above 0.
        beside_sq: m^2, square of the distance from the jet's axis.
    """
    axis = min(JET_DECAY * 2 * sqrt(jets.thrust / (pi * AIR_DENSITY)) / below, jets.fastest)
    profile = 1 + _JET_PROFILE * beside_sq / (below * below)
    return axis / (profile * profile)


@implements(wash, Jets)
def _wash_those_below(jets: Jets, qpos: NDArray[np.float64]) -> None:
    drones = qpos.shape[0]
    jets.force[:] = 0
    for i in range(drones):
        for j in range(i + 1, drones):
            x, y, z = qpos[j, 0] - qpos[i, 0], qpos[j, 1] - qpos[i, 1], qpos[j, 2] - qpos[i, 2]
            beside_sq, below = x * x + y * y, abs(z)
            if beside_sq >= _JET_EDGE * _JET_EDGE * below * below:
                continue
            speed = jet_speed(jets, below, beside_sq)
            jets.force[i if z > 0 else j] += jets.drag * speed * speed


@hot_stage
def ground_lift(ground: NamedTuple, height: float) -> float:
    """How many times its thrust far from the ground a rotor has at `height` (m, world); chosen by the type of `ground`.

    1 / (1 - (R / 4z)^2) for a rotor of radius R at z above the ground, held from z = R/2 down, where the formula ends
    (I. C. Cheeseman, W. E. Bennett: The Effect of the Ground on a Helicopter Rotor in Forward Flight, ARC R&M 3021,
    1955).
    """
    raise NotImplementedError


@implements(ground_lift, Off)
def _no_ground(ground: Off, height: float) -> float:  # noqa: ARG001
    return 1.0


@implements(ground_lift, Ground)
def _lift_over_ground(ground: Ground, height: float) -> float:
    ratio = ground.rotor_radius / (4 * max(height - ground.height, ground.rotor_radius / 2))
    return 1 / (1 - ratio * ratio)
