"""Airframe: the model of the vehicle that controllers are designed for."""

from __future__ import annotations

import dataclasses

GRAVITY = 9.81
"""Gravitational acceleration, m/s^2."""

ROTORS = 4
"""Number of rotors of a vehicle."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Airframe:
    """A quadrotor: four parallel rotors with thrust along the body's z axis (x forward, y left, z up).

    Attributes:
        name: name of the file in models/, without .xml.
        mass: mass, kg.
        inertia: (3,), moments of inertia about the centre of mass, body axes, kg m^2.
        rotor_positions: (4, 2), x and y of each rotor's axis from the centre of mass, body frame, m.
        yaw_ratio: (4,), torque about the body's z axis per thrust, m (N m / N); positive for a rotor that turns
            clockwise seen from above, whose drag turns the body anticlockwise.
        thrust_max: maximum thrust of one rotor, N.
        rotor_lag: time constant of the first-order lag from commanded to actual thrust, s.
        drag_area: drag coefficient times reference area of the body, m^2.
        rotor_drag: drag of the rotors in hover, divided by mass and by speed along the rotor plane, 1/s.
        rotor_radius: radius of one rotor, m.
        rotor_efficiency: ideal hover power (momentum theory) divided by the electrical power of hover.
        battery_cells: number of lithium polymer cells in series.
        battery_capacity: charge of a full battery, C.
        battery_resistance: internal resistance of the whole battery, ohm.
        radius: radius of the flat collision cylinder around body and rotors, m.
        half_height: half height of the same cylinder, m.
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
        """Thrust-to-weight ratio: maximum thrust of all rotors divided by weight."""
        return self.thrust_max / self.hover_thrust()
