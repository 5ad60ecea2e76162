"""Rigid bodies flown in real time: each has its own height, and its rotors may stand still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import Off, entry_kernel
from moflock_mj.dynamics.bodies import RigidBody
from moflock_mj.dynamics.interface import advance, take_fix
from moflock_mj.dynamics.rigid_body import RigidBodyModel
from moflock_mj.effects.wind import make_wind
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.sensing.gps import SensorModel, SensorState, drift_gps
from moflock_mj.simulation.random_numbers import RandomBatch, RandomStreams, draw, noise_of_interval
from moflock_mj.simulation.setup import sensor_model
from moflock_mj.world.state import TrueState

_OFF_THE_GROUND = 0.05
"""m above its stand, from which a body flies: below it its observer rests."""

_SHELTERED = 5.0
"""m above its stand, from which a body feels all of the outer noise; on the ground it feels nothing, and in between its
share. At full strength down to the ground, velocity goes astray by half a metre a second within a second: nobody lands
in that, and ArduCopter, which touches down a metre off and asks for 20 degrees of lean to get there, does not take
itself for landed. For air that is true near the ground there is `[wind]`."""


@entry_kernel
def _advance(
    dynamics: RigidBody,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: RandomBatch,
    steps: int,
) -> None:
    """One beat of `steps` integration steps, or none."""
    if steps > 0:
        advance(dynamics, world, desired, velocity_error, noise_of_interval(draws, 0, steps), steps)


@entry_kernel
def _fix(
    dynamics: RigidBody, model: SensorModel, state: SensorState, gps: NDArray[np.float64], fix: NDArray[np.float64]
) -> None:
    """One GPS fix: the errors drift, and the bodies' estimators take note of it."""
    drift_gps(model, state, gps)
    take_fix(dynamics, state.velocity_error[0], fix)


class RealtimeBodies:
    """N bodies that stand on the ground until their rotors turn.

    Args:
        scenario: airframe, response, bounds, noise, air and GPS errors.
        places: (N, 2), m, world, where they stand.
        streams: of all random numbers.
        interval: integration steps between two changes of the air, and the unit in which they are advanced.
        controlled: whether our controllers fly them; else the caller writes `thrust_command`.

    Attributes:
        desired: (2, N), m/s, world, the velocity commanded; written by the caller, and so are the next two.
        altitude: (N,), m, of the body's centre, to be held.
        stopped: (N, 4), 1 for a rotor that stands still.
        thrust_command: (N, 4), N.
        position_error: (2, N), m, of each body's GPS.
        velocity_error: (2, N), m/s, of each body's GPS; what is added to it goes away as other errors do.
        airframe: of all bodies.
        ground: m, height of the centre of a body that stands.
        radius: m, of a body's collision shape.
        step: s.

    Raises:
        MoflockError: the scenario cannot be flown by rigid bodies.
    """

    def __init__(
        self,
        scenario: Scenario,
        places: NDArray[np.float64],
        streams: RandomStreams,
        interval: int = 4,
        *,
        controlled: bool = True,
    ) -> None:
        drones = len(places)
        if scenario.faults:
            raise ScenarioError("faults: live bodies have none of a scenario: take them out; a fleet has its own")
        self.step = scenario.step_for("rigid_body")
        self._world = TrueState.at_rest(drones)
        self._world.position[:2] = places.T
        self._beat, self._scenario = interval, scenario.replace(drones=drones)
        wind = make_wind(self._scenario, interval * self.step, streams.wind)
        simulation = RigidBodyModel(
            self._scenario, self.step, interval, self._world, wind, Off(), controlled=controlled
        )
        self._simulation = simulation  # keeps alive what the plant points to
        self._dynamics = dynamics = simulation.dynamics
        self._streams = streams
        self.ground, self.radius = simulation.airframe.half_height, simulation.airframe.radius
        dynamics.state.qpos[:, 2] = self.ground
        dynamics.state.thrust[:] = 0
        dynamics.state.altitude[:] = self.ground
        dynamics.state.thrust_command[:] = 0
        dynamics.state.stopped[:] = controlled
        self.desired = np.zeros((2, drones))
        self._sensors = sensor_model(scenario)
        self._sensor_state = SensorState.at_start(self._world, 0)
        self._steps_per_fix = round(scenario.t_gps / self.step)
        self._steps_to_fix = 0
        # What a vehicle tells others is what it reads itself: the first of the two processes does for both.
        self.position_error = self._sensor_state.position_error[0]
        self.velocity_error = self._sensor_state.velocity_error[0]
        self.altitude = dynamics.state.altitude
        self.stopped = dynamics.state.stopped
        self.thrust_command = dynamics.state.thrust_command
        self.airframe = simulation.airframe
        self._advance_interval(0)  # compiles, so that the first real step takes no longer than the others

    @property
    def qpos(self) -> NDArray[np.float64]:
        """(N, 7), position m world, quaternion w x y z; to be read."""
        return self._dynamics.state.qpos

    @property
    def qvel(self) -> NDArray[np.float64]:
        """(N, 6), velocity m/s world, body rates rad/s body; to be read."""
        return self._dynamics.state.qvel

    def advance(self, steps: int) -> None:
        """Move all bodies by some integration steps, in whole beats, and their GPS errors once in t_gps.

        Raises:
            ValueError: the steps are no whole number of beats.
        """
        if steps % self._beat:
            raise ValueError(f"steps: {steps} must be a multiple of the beat, {self._beat}")
        for _ in range(steps // self._beat):
            self._advance_interval(self._beat)

    def _advance_interval(self, steps: int) -> None:
        self._steps_to_fix -= steps
        fix_due = self._steps_to_fix <= 0
        draws = draw(self._streams, self._scenario, "rigid_body", ticks=int(fix_due), intervals=1, steps=steps)
        height = self.qpos[:, 2] - self.ground
        draws.outer[:] *= np.clip(height / _SHELTERED, 0.0, 1.0)
        standing = height < _OFF_THE_GROUND
        # An observer that felt the ground would take it for an updraught, and sag after take-off.
        self._dynamics.state.observer[standing] = 0
        if fix_due:
            self._steps_to_fix += self._steps_per_fix
            _fix(self._dynamics, self._sensors, self._sensor_state, draws.gps[0], draws.fix)
        _advance(self._dynamics, self._world, self.desired, self.velocity_error, draws, steps)
