"""Rigid-body dynamics: the controllers' rotor thrusts push MuJoCo bodies."""

from __future__ import annotations

import copy
from math import sqrt
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS
from controllers.cascade import OBSERVER_SIZE, Gains, rotor_wrench, track_velocity
from controllers.compiling import hot_kernel, implements, kernel
from controllers.tuning import TuningError, design_gains
from moflock_mj.airframes import flock_model, load_airframe
from moflock_mj.errors import AirframeError
from moflock_mj.mujoco_link import mj_step
from moflock_mj.plant import advance, write_state
from moflock_mj.scenario import Scenario
from moflock_mj.world import World

AIR_DENSITY = 1.225
"""kg/m^3 at sea level (ISO 2533, International Standard Atmosphere)."""

_MUJOCO_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)

GROUND = -1
"""In place of a drone's number: the ground."""


class Extremes(NamedTuple):
    """What a flight has asked of each body so far.

    Attributes:
        upright: (N,), smallest cosine of the tilt.
        altitude_error: (N,), m, largest.
        saturated: (N,), steps in which a rotor was commanded to its limit.
        touch_step: (N,), step of the first touch, -1 before it.
        touch_with: (N,), the other drone, or GROUND.
        steps: (1,), steps made.
    """

    upright: NDArray[np.float64]
    altitude_error: NDArray[np.float64]
    saturated: NDArray[np.int64]
    touch_step: NDArray[np.int64]
    touch_with: NDArray[np.int64]
    steps: NDArray[np.int64]


class RigidBody(NamedTuple):
    """N bodies in one MuJoCo model, as the compiled loop sees them; arrays of MuJoCo's are views.

    Attributes:
        gains: of the controllers, with the vehicle's figures.
        step: s.
        altitude: (N,), m, to be held.
        stopped: (N, 4), 1 for a rotor that stands still whatever it is commanded, else 0.
        noise_force: N, deviation of the outer noise in one step.
        drag: kg/m, quadratic drag: force over speed squared.
        reach: m, from a body's centre to the farthest point of its collision shape.
        model: address of the model.
        model_apart: address of the same model without collision detection.
        data: address of the data.
        qpos: (N, 7), position m world, quaternion w x y z.
        qvel: (N, 6), velocity m/s world, body rates rad/s body.
        qfrc_applied: (N, 6), force N world, torque N m body.
        qfrc_constraint: (N, 6), what contacts did in the latest step, same frames.
        thrust: (N, 4), N, of the rotors.
        thrust_command: (N, 4), N.
        observer: (N, 6), state of the disturbance observers.
        extremes: counts on.
    """

    gains: Gains
    step: float
    altitude: NDArray[np.float64]
    stopped: NDArray[np.uint8]
    noise_force: float
    drag: float
    reach: float
    model: int
    model_apart: int
    data: int
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    qfrc_applied: NDArray[np.float64]
    qfrc_constraint: NDArray[np.float64]
    thrust: NDArray[np.float64]
    thrust_command: NDArray[np.float64]
    observer: NDArray[np.float64]
    extremes: Extremes


@kernel
def _may_touch(plant: RigidBody, steps: int) -> bool:
    """Whether anything could come into contact within the next steps, by a bound on how far bodies can move."""
    gains, duration = plant.gains, steps * plant.step
    drones = plant.qpos.shape[0]
    fastest_sq, lowest = 0.0, np.inf
    for i in range(drones):
        vx, vy, vz = plant.qvel[i, 0], plant.qvel[i, 1], plant.qvel[i, 2]
        fastest_sq = max(fastest_sq, vx * vx + vy * vy + vz * vz)
        lowest = min(lowest, plant.qpos[i, 2])
    # Full thrust along gravity, and ten deviations of the outer noise's velocity.
    gusts = 10 * plant.noise_force / gains.mass * plant.step * sqrt(steps)
    thrust_acceleration = ROTORS * gains.thrust_max / gains.mass
    speed = sqrt(fastest_sq) + gusts + duration * (thrust_acceleration + 9.81)
    way = plant.reach + duration * speed
    if lowest < way:
        return True
    for i in range(drones):
        for j in range(i + 1, drones):
            dx = plant.qpos[j, 0] - plant.qpos[i, 0]
            dy = plant.qpos[j, 1] - plant.qpos[i, 1]
            dz = plant.qpos[j, 2] - plant.qpos[i, 2]
            if dx * dx + dy * dy + dz * dz < 4 * way * way:
                return True
    return False


@hot_kernel
def _push(plant: RigidBody, i: int, noise_x: float, noise_y: float) -> None:
    """Apply the rotors' wrench and the outer noise to body i; then let the rotors follow their commands.

    As in MuJoCo's own `filterexact` actuators, the thrust of a step is the one before this step's lag.
    """
    gains, qpos, force, thrust = plant.gains, plant.qpos, plant.qfrc_applied, plant.thrust
    total, force[i, 3], force[i, 4], force[i, 5] = rotor_wrench(gains, thrust[i])
    qw, qx, qy, qz = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
    force[i, 0] = 2 * (qx * qz + qw * qy) * total + plant.noise_force * noise_x
    force[i, 1] = 2 * (qy * qz - qw * qx) * total + plant.noise_force * noise_y
    force[i, 2] = (1 - 2 * (qx * qx + qy * qy)) * total
    for rotor in range(ROTORS):
        thrust[i, rotor] += gains.rotor_blend * (plant.thrust_command[i, rotor] - thrust[i, rotor])


@kernel
def _stop_rotors(plant: RigidBody) -> None:
    """Command nothing of the rotors that stand still."""
    for i in range(plant.stopped.shape[0]):
        for rotor in range(ROTORS):
            if plant.stopped[i, rotor]:
                plant.thrust_command[i, rotor] = 0.0


@hot_kernel
def _drag(plant: RigidBody, i: int) -> None:
    """Add the drag of still air to the force on body i."""
    qvel, force = plant.qvel, plant.qfrc_applied
    vx, vy, vz = qvel[i, 0], qvel[i, 1], qvel[i, 2]
    drag = plant.drag * sqrt(vx * vx + vy * vy + vz * vz)
    force[i, 0] -= drag * vx
    force[i, 1] -= drag * vy
    force[i, 2] -= drag * vz


@hot_kernel
def _watch(plant: RigidBody, i: int) -> None:
    """Count what the step before asks of body i."""
    extremes, gains = plant.extremes, plant.gains
    qx, qy = plant.qpos[i, 4], plant.qpos[i, 5]
    extremes.upright[i] = min(extremes.upright[i], 1 - 2 * (qx * qx + qy * qy))
    extremes.altitude_error[i] = max(extremes.altitude_error[i], abs(plant.qpos[i, 2] - plant.altitude[i]))
    saturated = False
    for rotor in range(ROTORS):
        command = plant.thrust_command[i, rotor]
        saturated |= command <= 0 or command >= gains.thrust_max
    extremes.saturated[i] += saturated


@hot_kernel
def _is_pushed(plant: RigidBody, i: int) -> bool:
    """Whether contact forces acted on body i in the latest step."""
    pushed = False
    for k in range(6):
        pushed |= plant.qfrc_constraint[i, k] != 0
    return pushed


@kernel
def _mark_touches(plant: RigidBody) -> None:
    """Note the first step in which contact forces act on a body, and what is nearest to it then."""
    extremes, qpos = plant.extremes, plant.qpos
    for i in range(qpos.shape[0]):
        if extremes.touch_step[i] >= 0 or not _is_pushed(plant, i):
            continue
        nearest_sq, nearest = qpos[i, 2] ** 2, GROUND
        for j in range(qpos.shape[0]):
            if j != i and _is_pushed(plant, j):
                dx, dy, dz = qpos[j, 0] - qpos[i, 0], qpos[j, 1] - qpos[i, 1], qpos[j, 2] - qpos[i, 2]
                distance_sq = dx * dx + dy * dy + dz * dz
                if distance_sq < nearest_sq:
                    nearest_sq, nearest = distance_sq, j
        extremes.touch_step[i], extremes.touch_with[i] = extremes.steps[0], nearest


@implements(advance, RigidBody)
def advance_rigid_bodies(
    plant: RigidBody,
    world: World,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> None:
    """Controllers, rotors and MuJoCo, step by step."""
    drones = plant.qpos.shape[0]
    collisions = _may_touch(plant, noise.shape[0])
    model = plant.model if collisions else plant.model_apart
    for k in range(noise.shape[0]):
        for i in range(drones):
            track_velocity(
                plant.gains,
                desired[0, i],
                desired[1, i],
                plant.altitude[i],
                plant.qvel[i, 0] + velocity_error[0, i],
                plant.qvel[i, 1] + velocity_error[1, i],
                plant.qpos[i],
                plant.qvel[i],
                plant.thrust[i],
                plant.observer[i],
                plant.thrust_command[i],
            )
        _stop_rotors(plant)
        # A loop of its own: the two together compile to slower code.
        for i in range(drones):
            _watch(plant, i)
            _push(plant, i, noise[k, 0, i], noise[k, 1, i])
        if plant.drag > 0:
            for i in range(drones):
                _drag(plant, i)
        mj_step(model, plant.data)
        plant.extremes.steps[0] += 1
        if collisions:
            _mark_touches(plant)
    for i in range(drones):
        for axis in range(3):
            world.position[axis, i] = plant.qpos[i, axis]
            world.velocity[axis, i] = plant.qvel[i, axis]
        world.touched[i] = plant.extremes.touch_step[i] >= 0


@implements(write_state, RigidBody)
def write_rigid_bodies(plant: RigidBody, world: World, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:  # noqa: ARG001
    qpos[:] = plant.qpos
    qvel[:] = plant.qvel


class RigidBodyFlock:
    """A flock's MuJoCo model and data, and the plant that the compiled loop flies.

    Args:
        scenario: what is flown.
        step: integration step, s.
        world: where the drones start, level, with their rotors at hover.

    Raises:
        AirframeError: the airframe is unknown, or too weak for the scenario.
    """

    def __init__(self, scenario: Scenario, step: float, world: World) -> None:
        airframe = load_airframe(scenario.airframe)
        try:
            self.design = design_gains(
                airframe, step=step, tau=scenario.tau, a_max=scenario.a_max, tilt_max=scenario.tilt_max
            )
        except TuningError as problem:
            raise AirframeError(str(problem)) from None
        self.airframe = airframe
        drones = scenario.drones
        self.model = flock_model(scenario.airframe, drones, step)
        self.model_apart = copy.copy(self.model)
        self.model_apart.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.data = mujoco.MjData(self.model)
        gains = self.design.gains
        self.plant = RigidBody(
            gains=gains,
            step=step,
            altitude=np.full(drones, scenario.altitude),
            stopped=np.zeros((drones, ROTORS), np.uint8),
            noise_force=airframe.mass * sqrt(2 * scenario.sigma_outer / step),
            drag=AIR_DENSITY * airframe.drag_area / 2 if scenario.air_drag else 0.0,
            reach=sqrt(airframe.radius**2 + airframe.half_height**2),
            model=self.model._address,
            model_apart=self.model_apart._address,
            data=self.data._address,
            qpos=self.data.qpos.reshape(drones, 7),
            qvel=self.data.qvel.reshape(drones, 6),
            qfrc_applied=self.data.qfrc_applied.reshape(drones, 6),
            qfrc_constraint=self.data.qfrc_constraint.reshape(drones, 6),
            thrust=np.full((drones, ROTORS), airframe.hover_thrust()),
            thrust_command=np.full((drones, ROTORS), airframe.hover_thrust()),
            observer=np.zeros((drones, OBSERVER_SIZE)),
            extremes=Extremes(
                upright=np.ones(drones),
                altitude_error=np.zeros(drones),
                saturated=np.zeros(drones, np.int64),
                touch_step=np.full(drones, -1),
                touch_with=np.full(drones, -1),
                steps=np.zeros(1, np.int64),
            ),
        )
        self.plant.qpos[:, :3] = world.position.T
        self.plant.qpos[:, 3:] = (1, 0, 0, 0)
        self.plant.qvel[:, :3] = world.velocity.T
        self.plant.observer[:, :3] = world.velocity.T

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Every array that changes in flight, by name; MuJoCo's own state is a copy, see `load_mujoco`."""
        plant = self.plant
        named = {"thrust": plant.thrust, "thrust_command": plant.thrust_command, "observer": plant.observer}
        mujoco_state = np.empty(mujoco.mj_stateSize(self.model, _MUJOCO_STATE))
        mujoco.mj_getState(self.model, self.data, mujoco_state, _MUJOCO_STATE)
        named |= plant.extremes._asdict()
        return {"mujoco": mujoco_state} | {f"body.{name}": array for name, array in named.items()}

    def load_mujoco(self, state: NDArray[np.float64]) -> None:
        """Put MuJoCo's data into a state that `arrays` told."""
        mujoco.mj_setState(self.model, self.data, state, _MUJOCO_STATE)
