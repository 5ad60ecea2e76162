"""Guidance of one simulated vehicle: converts hold, fly, go, rise or sink to a horizontal velocity and a height."""

from __future__ import annotations

import math
from typing import NamedTuple

from moflock_mj.mavlink.frames import Triple

_PLACE_GAIN = 0.3
"""Position gain, 1/s; with the velocity loop's time constant of 1 s, the damping ratio is 0.9."""
_BRAKING = 1.5
"""Deceleration of the approach to a place, m/s^2."""
_STOPPED = 0.5
"""Speed below which a holding vehicle keeps its present place, m/s."""
_CLIMB_MAX = 3.0
"""Maximum climb rate of the altitude loop, m/s."""
_SPEED_MAX = 100.0
"""Maximum commanded speed, m/s."""


class Body(NamedTuple):
    """Estimated state of one vehicle.

    Attributes:
        position: position, m, world.
        velocity: velocity, m/s, world.
        quaternion: quaternion (w, x, y, z) from body to world.
        rates: angular rates, rad/s, body (x forward, y left, z up).
    """

    position: Triple
    velocity: Triple
    quaternion: tuple[float, float, float, float]
    rates: Triple

    @property
    def speed(self) -> float:
        """Horizontal speed, m/s."""
        return math.hypot(self.velocity[0], self.velocity[1])

    @property
    def upright(self) -> float:
        """Cosine of the tilt."""
        _, x, y, _ = self.quaternion
        return 1 - 2 * (x * x + y * y)


class Setpoint(NamedTuple):
    """Setpoint of a body's controllers.

    Attributes:
        velocity_x: velocity along x, m/s, world.
        velocity_y: velocity along y, m/s, world.
        altitude: altitude of the body's centre, m, world.
        stopped: whether the rotors are stopped.
    """

    velocity_x: float
    velocity_y: float
    altitude: float
    stopped: bool


class Guide:
    """Guidance with one target at a time; each call replaces the target.

    Args:
        altitude: present altitude of the vehicle, m.
    """

    def __init__(self, altitude: float) -> None:
        self._altitude = altitude
        self._velocity: tuple[float, float] | None = None
        self._place: tuple[float, float] | None = None
        self._speed = 0.0
        self._target = altitude
        self._rates = (_CLIMB_MAX, _CLIMB_MAX)

    def hold(self) -> None:
        """Stop, and keep the place of standstill."""
        self._velocity, self._place, self._speed = None, None, 2.0
        self._target, self._rates = self._altitude, (_CLIMB_MAX, _CLIMB_MAX)

    def fly(self, velocity: Triple, speed_max: float = _SPEED_MAX) -> None:
        """Fly a velocity, m/s, world, whose horizontal part is limited to `speed_max`."""
        x, y, z = velocity
        speed = math.hypot(x, y)
        share = min(1.0, speed_max / speed) if speed else 1.0
        self._velocity = (x * share, y * share)
        climb = min(abs(z), _CLIMB_MAX)
        self._target, self._rates = math.copysign(math.inf, z) if climb else self._altitude, (climb, climb)

    def go(self, place: tuple[float, float], altitude: float, *, speed: float, climb: float, descent: float) -> None:
        """Go to a place and an altitude, m, world, with these maximum speeds, m/s."""
        self._velocity, self._place, self._speed = None, place, speed
        self._target, self._rates = altitude, (climb, descent)

    def rise(self, body: Body, altitude: float, climb: float) -> None:
        """Take off vertically from the body's position."""
        self._altitude = body.position[2]
        self.go((body.position[0], body.position[1]), altitude, speed=2.0, climb=climb, descent=climb)

    def sink(self, lowest: float, descent: float) -> None:
        """Descend to an altitude, m, at the held place or at the place of standstill."""
        self._velocity, self._speed = None, 2.0
        self._target, self._rates = lowest, (descent, descent)

    def step(self, seconds: float, body: Body, *, lowest: float) -> Setpoint:
        """Return the setpoint for the next `seconds`, never below the altitude `lowest`, m."""
        climb, descent = self._rates
        change = min(max(self._target - self._altitude, -descent * seconds), climb * seconds)
        self._altitude = max(self._altitude + change, lowest)
        velocity_x, velocity_y = self._velocity or self._towards_place(body)
        return Setpoint(velocity_x, velocity_y, self._altitude, False)

    def _towards_place(self, body: Body) -> tuple[float, float]:
        x, y, _ = body.position
        if self._place is None:
            if body.speed > _STOPPED:
                return 0.0, 0.0
            self._place = (x, y)
        dx, dy = self._place[0] - x, self._place[1] - y
        distance = math.hypot(dx, dy)
        if distance < 1e-6:
            return 0.0, 0.0
        speed = min(_PLACE_GAIN * distance, math.sqrt(2 * _BRAKING * distance), self._speed)
        return dx / distance * speed, dy / distance * speed
