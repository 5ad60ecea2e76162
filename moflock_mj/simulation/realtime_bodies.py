"""Rigid bodies for real-time simulation, with individual heights and stopped rotors."""

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

_FLYING_HEIGHT = 0.05
"""Height above the stand from which a body flies, m; below it, its observer is reset."""

_FULL_DISTURBANCE_HEIGHT = 5.0
"""Height above the stand from which the full velocity disturbance acts, m. The disturbance is zero on the ground and
linear between. The full disturbance at the ground changes the velocity by half a metre per second within a second,
which prevents landing: ArduCopter touches down a metre off, commands 20 degrees of lean to return, and does not detect
the landing. `[wind]` is a realistic model of the air near the ground."""


@entry_kernel
def _advance(
    dynamics: RigidBody,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: RandomBatch,
    steps: int,
) -> None:
    """Advance one interval of `steps` integration steps, or none."""
    if steps > 0:
        advance(dynamics, world, desired, velocity_error, noise_of_interval(draws, 0, steps), steps)


@entry_kernel
def _fix(
    dynamics: RigidBody, model: SensorModel, state: SensorState, gps: NDArray[np.float64], fix: NDArray[np.float64]
) -> None:
    """Apply a GPS fix: advance the GPS errors, and correct the estimates of the bodies."""
    drift_gps(model, state, gps)
    take_fix(dynamics, state.velocity_error[0], fix)


class RealtimeBodies:
    """N bodies that stand on the ground until their rotors turn.

    Args:
        scenario: airframe, response, limits, noise, effects and GPS errors.
        places: (N, 2), initial positions, m, world.
        streams: random generators.
        interval: integration steps per control interval, the unit of `advance`.
        controlled: True to run the controllers; otherwise the caller writes `thrust_command`.

    Attributes:
        desired: (2, N), commanded velocity, m/s, world; written by the caller.
        altitude: (N,), height of the body's centre to hold, m; written by the caller.
        stopped: (N, 4), 1 for a stopped rotor; written by the caller.
        thrust_command: (N, 4), commanded thrust of each rotor, N.
        position_error: (2, N), GPS position error of each body, m.
        velocity_error: (2, N), GPS velocity error of each body, m/s; an offset added by the caller decays like other
            errors.
        airframe: airframe of all bodies.
        ground: height of the centre of a body on the ground, m.
        radius: radius of a body's collision shape, m.
        step: integration step, s.

    Raises:
        MoflockError: the scenario is not possible with rigid bodies.
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
            raise ScenarioError(
                "faults: not supported by real-time bodies: they must be absent; a fleet has its own faults"
            )
        self.step = scenario.step_for("rigid_body")
        self._world = TrueState.at_rest(drones)
        self._world.position[:2] = places.T
        self._interval, self._scenario = interval, scenario.replace(drones=drones)
        wind = make_wind(self._scenario, interval * self.step, streams.wind)
        simulation = RigidBodyModel(
            self._scenario, self.step, interval, self._world, wind, Off(), controlled=controlled
        )
        self._simulation = simulation  # keeps the MuJoCo objects alive, whose addresses are in the dynamics
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
        # A vehicle sends its own measured position, so that the first of the two error processes serves both.
        self.position_error = self._sensor_state.position_error[0]
        self.velocity_error = self._sensor_state.velocity_error[0]
        self.altitude = dynamics.state.altitude
        self.stopped = dynamics.state.stopped
        self.thrust_command = dynamics.state.thrust_command
        self.airframe = simulation.airframe
        self._advance_interval(0)  # compiles, so that the first step in real time is not delayed

    @property
    def qpos(self) -> NDArray[np.float64]:
        """(N, 7), position (m, world) and quaternion w x y z; read-only."""
        return self._dynamics.state.qpos

    @property
    def qvel(self) -> NDArray[np.float64]:
        """(N, 6), velocity (m/s, world) and body rates (rad/s, body); read-only."""
        return self._dynamics.state.qvel

    def advance(self, steps: int) -> None:
        """Advance all bodies by integration steps, in whole intervals, and their GPS errors once per t_gps.

        Raises:
            ValueError: the steps are not a multiple of the interval.
        """
        if steps % self._interval:
            raise ValueError(f"steps: {steps} must be a multiple of the interval, {self._interval}")
        for _ in range(steps // self._interval):
            self._advance_interval(self._interval)

    def _advance_interval(self, steps: int) -> None:
        self._steps_to_fix -= steps
        fix_due = self._steps_to_fix <= 0
        draws = draw(self._streams, self._scenario, "rigid_body", ticks=int(fix_due), intervals=1, steps=steps)
        height = self.qpos[:, 2] - self.ground
        draws.outer[:] *= np.clip(height / _FULL_DISTURBANCE_HEIGHT, 0.0, 1.0)
        on_ground = height < _FLYING_HEIGHT
        # An observer would treat the force of the ground as an updraught, and the body would sink after take-off.
        self._dynamics.state.observer[on_ground] = 0
        if fix_due:
            self._steps_to_fix += self._steps_per_fix
            _fix(self._dynamics, self._sensors, self._sensor_state, draws.gps[0], draws.fix)
        _advance(self._dynamics, self._world, self.desired, self.velocity_error, draws, steps)
