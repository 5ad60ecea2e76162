"""What a controller knows of its vehicle."""

from __future__ import annotations

import dataclasses

GRAVITY = 9.81
"""m/s^2, as in the flock\'s model."""

ROTORS = 4
"""Rotors of a vehicle."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Airframe:
    """A quadrotor: four parallel rotors that push along the body's z axis (x forward, y left, z up).

    Attributes:
        name: file of models/, without .xml.
        mass: kg.
        inertia: (3,), kg m^2, about the centre of mass, along the body's axes.
        rotor_positions: (4, 2), m, x and y of each rotor's axis in the body frame, from the centre of mass.
        yaw_ratio: (4,), m, torque about the body's z axis per thrust (N m / N); positive for a rotor that turns
            clockwise seen from above, whose drag turns the body anticlockwise.
        thrust_max: N, of one rotor.
        rotor_lag: s, time constant of the first-order lag from commanded to actual thrust.
        drag_area: m^2, drag coefficient times reference area of the body.
        rotor_drag: 1/s, drag of the rotors in hover, over mass and speed along the rotor plane.
        rotor_radius: m.
        rotor_efficiency: ideal power of hover (momentum theory) over the power that the battery gives for it.
        battery_cells: lithium polymer cells in series.
        battery_capacity: C, charge of a full battery.
        battery_resistance: ohm, of the whole battery.
        radius: m, of the flat collision cylinder around body and rotors.
        half_height: m, of the same cylinder.
    """

    name: str
    mass: float
    inertia: tuple[float, float, float]
    rotor_positions: tuple[tuple[float, float], ...]
    yaw_ratio: tuple[float, ...]
    thrust_max: float
    rotor_lag: float
    drag_area: float
    rotor_drag: float
    rotor_radius: float
    rotor_efficiency: float
    battery_cells: int
    battery_capacity: float
    battery_resistance: float
    radius: float
    half_height: float

    def hover_thrust(self) -> float:
        """Thrust of one rotor in hover, N."""
        return self.mass * GRAVITY / ROTORS

    def thrust_to_weight(self) -> float:
        """Thrust of all rotors over weight."""
        return self.thrust_max / self.hover_thrust()
