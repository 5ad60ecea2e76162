"""Guidance of one simulated vehicle: from hold, fly, go, rise or sink to a horizontal velocity and a height."""

from __future__ import annotations

import math
from typing import NamedTuple

from moflock_mj.mavlink.frames import Triple

_PLACE_GAIN = 0.3
"""1/s, from distance to speed: with the velocity loop's time constant of 1 s, a damping ratio of 0.9."""
_BRAKING = 1.5
"""m/s^2, of the approach to a place."""
_STOPPED = 0.5
"""m/s, below which a vehicle that holds keeps the place that it has reached."""
_CLIMB_MAX = 3.0
"""m/s, what the altitude loop flies."""
_SPEED_MAX = 100.0
"""m/s, bound of any commanded velocity."""


class Body(NamedTuple):
    """The state of one vehicle, as its estimator has it.

    Attributes:
        position: m, world.
        velocity: m/s, world.
        quaternion: w x y z, body to world.
        rates: rad/s, body (x forward, y left, z up).
    """

    position: Triple
    velocity: Triple
    quaternion: tuple[float, float, float, float]
    rates: Triple

    @property
    def speed(self) -> float:
        """Horizontal, m/s."""
        return math.hypot(self.velocity[0], self.velocity[1])

    @property
    def upright(self) -> float:
        """Cosine of the tilt."""
        _, x, y, _ = self.quaternion
        return 1 - 2 * (x * x + y * y)


class Setpoint(NamedTuple):
    """What the controllers of a body are asked for.

    Attributes:
        velocity_x: m/s, world; so is velocity_y.
        velocity_y: m/s, world.
        altitude: m, world, of the body's centre.
        stopped: whether the rotors stand still.
    """

    velocity_x: float
    velocity_y: float
    altitude: float
    stopped: bool


class Guide:
    """Flies one wish at a time; each wish replaces the one before.

    Args:
        altitude: m, where the vehicle is.
    """

    def __init__(self, altitude: float) -> None:
        self._altitude = altitude
        self._velocity: tuple[float, float] | None = None
        self._place: tuple[float, float] | None = None
        self._speed = 0.0
        self._target = altitude
        self._rates = (_CLIMB_MAX, _CLIMB_MAX)

    def hold(self) -> None:
        """Stop, and stay where that is."""
        self._velocity, self._place, self._speed = None, None, 2.0
        self._target, self._rates = self._altitude, (_CLIMB_MAX, _CLIMB_MAX)

    def fly(self, velocity: Triple, speed_max: float = _SPEED_MAX) -> None:
        """Fly a velocity, m/s, world, cut to `speed_max` in the horizontal."""
        x, y, z = velocity
        speed = math.hypot(x, y)
        share = min(1.0, speed_max / speed) if speed else 1.0
        self._velocity = (x * share, y * share)
        climb = min(abs(z), _CLIMB_MAX)
        self._target, self._rates = math.copysign(math.inf, z) if climb else self._altitude, (climb, climb)

    def go(self, place: tuple[float, float], altitude: float, *, speed: float, climb: float, descent: float) -> None:
        """Go to a place and a height, m, world, at these speeds at most, m/s."""
        self._velocity, self._place, self._speed = None, place, speed
        self._target, self._rates = altitude, (climb, descent)

    def rise(self, body: Body, altitude: float, climb: float) -> None:
        """Take off straight up from where the body is."""
        self._altitude = body.position[2]
        self.go((body.position[0], body.position[1]), altitude, speed=2.0, climb=climb, descent=climb)

    def sink(self, lowest: float, descent: float) -> None:
        """Descend on the place that is held, or where the vehicle comes to rest, to a height in m."""
        self._velocity, self._speed = None, 2.0
        self._target, self._rates = lowest, (descent, descent)

    def step(self, seconds: float, body: Body, *, lowest: float) -> Setpoint:
        """The setpoint for the next `seconds`; never below `lowest`, m."""
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
