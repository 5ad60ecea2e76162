"""Rigid bodies flown in real time: each has its own height, and its rotors may stand still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel
from moflock_mj.plant import advance
from moflock_mj.rigid_body import RigidBody, RigidBodyFlock
from moflock_mj.scenario import Scenario
from moflock_mj.world import World

_OFF_THE_GROUND = 0.05
"""m above its stand, from which a body flies: below it nothing blows it about, and its observer rests."""


@entry_kernel
def _advance(
    plant: RigidBody,
    world: World,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> None:
    advance(plant, world, desired, velocity_error, noise)


class LiveBodies:
    """N bodies that stand on the ground until their rotors turn.

    Args:
        scenario: airframe, response, bounds and outer noise.
        places: (N, 2), m, world, where they stand.
        rng: of the outer noise.

    Attributes:
        desired: (2, N), m/s, world, the velocity commanded; written by the caller, and so are the next three.
        altitude: (N,), m, of the body's centre, to be held.
        stopped: (N, 4), 1 for a rotor that stands still.
        velocity_error: (2, N), m/s, by which a body's horizontal velocity is measured too high.
        ground: m, height of the centre of a body that stands.
        radius: m, of a body's collision shape.
        step: s.

    Raises:
        MoflockError: the scenario cannot be flown by rigid bodies.
    """

    def __init__(self, scenario: Scenario, places: NDArray[np.float64], rng: np.random.Generator) -> None:
        drones = len(places)
        self.step = scenario.step_for("rigid_body")
        self._world = World.at_rest(drones)
        self._world.position[:2] = places.T
        flock = RigidBodyFlock(scenario.replace(drones=drones), self.step, self._world)
        self._flock = flock  # keeps alive what the plant points to
        self._plant = plant = flock.plant
        self._rng = rng
        self.ground, self.radius = flock.airframe.half_height, flock.airframe.radius
        plant.qpos[:, 2] = self.ground
        plant.thrust[:] = 0
        plant.altitude[:] = self.ground
        plant.stopped[:] = 1
        self.desired = np.zeros((2, drones))
        self.velocity_error = np.zeros((2, drones))
        self.altitude = plant.altitude
        self.stopped = plant.stopped
        self.advance(0)  # compiles, so that the first real step takes no longer than the others

    @property
    def qpos(self) -> NDArray[np.float64]:
        """(N, 7), position m world, quaternion w x y z; to be read."""
        return self._plant.qpos

    @property
    def qvel(self) -> NDArray[np.float64]:
        """(N, 6), velocity m/s world, body rates rad/s body; to be read."""
        return self._plant.qvel

    def advance(self, steps: int) -> None:
        """Move all bodies by some integration steps."""
        standing = self.qpos[:, 2] < self.ground + _OFF_THE_GROUND
        noise = self._rng.standard_normal((steps, 2, len(standing)))
        noise[:, :, standing] = 0
        # An observer that felt the ground would take it for an updraught, and sag after take-off.
        self._plant.observer[standing] = 0
        _advance(self._plant, self._world, self.desired, self.velocity_error, noise)
