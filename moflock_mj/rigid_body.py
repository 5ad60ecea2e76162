"""Rigid-body dynamics: the controllers' rotor thrusts push MuJoCo bodies."""

from __future__ import annotations

import copy
from math import sqrt
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS
from controllers.cascade import OBSERVER_SIZE, Gains, track_velocity
from controllers.compiling import Off, hot_kernel, hot_stage, implements, kernel
from controllers.tuning import TuningError, design_gains, largest_push
from moflock_mj.aerodynamics import (
    AirDrag,
    add_drag,
    air_force_bound,
    ground_lift,
    make_drag,
    make_ground,
    make_jets,
    wash,
    washed,
    wind_push,
)
from moflock_mj.airframes import flock_model, load_airframe
from moflock_mj.battery import battery_lift, drain, make_cells, power_factor, rotor_power
from moflock_mj.breakdown import Breakdown, delivered_wrench
from moflock_mj.errors import AirframeError
from moflock_mj.feasibility import check_air
from moflock_mj.inertial import Sensors, believed, feel, make_sensors, take_bearings, walk_biases
from moflock_mj.mujoco_link import mj_step
from moflock_mj.outer_noise import draw_force, make_outer_noise, outer_force
from moflock_mj.plant import Noise, advance, take_fix, write_state
from moflock_mj.scenario import Scenario
from moflock_mj.wind import Wind, blow
from moflock_mj.world import World

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
        energy: (N,), J, that the rotors took from the battery.
        power: (N,), W, that they take now.
    """

    upright: NDArray[np.float64]
    altitude_error: NDArray[np.float64]
    saturated: NDArray[np.int64]
    touch_step: NDArray[np.int64]
    touch_with: NDArray[np.int64]
    steps: NDArray[np.int64]
    energy: NDArray[np.float64]
    power: NDArray[np.float64]


class RigidBody(NamedTuple):
    """N bodies in one MuJoCo model, as the compiled loop sees them; arrays of MuJoCo's are views.

    Attributes:
        gains: of the controllers, with the vehicle's figures.
        pilot: the gains once more, or Off where others write `thrust_command`.
        step: s.
        altitude: (N,), m, to be held.
        stopped: (N, 4), 1 for a rotor that stands still whatever it is commanded, else 0.
        outer: see `moflock_mj.outer_noise`, or Off.
        wind: the air, see `moflock_mj.wind`.
        drag: of the air, see `moflock_mj.aerodynamics`, or Off; so are downwash and ground.
        downwash: of the drones on those below them.
        ground: under the rotors.
        battery: of each drone, see `moflock_mj.battery`, or Off.
        power_factor: W/N^1.5, see `moflock_mj.battery`.
        sensors: on board, see `moflock_mj.inertial`, or Off.
        faults: see `moflock_mj.breakdown`, or Off.
        reach: m, from a body's centre to the farthest point of its collision shape.
        model: address of the model.
        model_apart: address of the same model without collision detection.
        data: address of the data.
        qpos: (N, 7), position m world, quaternion w x y z.
        qvel: (N, 6), velocity m/s world, body rates rad/s body.
        qacc: (N, 6), acceleration m/s^2 world, angular rad/s^2 body, of the latest step.
        qfrc_applied: (N, 6), force N world, torque N m body.
        qfrc_constraint: (N, 6), what contacts did in the latest step, same frames.
        thrust: (N, 4), N, of the rotors.
        thrust_command: (N, 4), N.
        observer: (N, 6), state of the disturbance observers.
        extremes: counts on.
    """

    gains: Gains
    pilot: NamedTuple
    step: float
    altitude: NDArray[np.float64]
    stopped: NDArray[np.uint8]
    outer: NamedTuple
    wind: NamedTuple
    drag: NamedTuple
    downwash: NamedTuple
    ground: NamedTuple
    battery: NamedTuple
    power_factor: float
    sensors: NamedTuple
    faults: NamedTuple
    reach: float
    model: int
    model_apart: int
    data: int
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    qacc: NDArray[np.float64]
    qfrc_applied: NDArray[np.float64]
    qfrc_constraint: NDArray[np.float64]
    thrust: NDArray[np.float64]
    thrust_command: NDArray[np.float64]
    observer: NDArray[np.float64]
    extremes: Extremes


@hot_stage
def steer(
    pilot: NamedTuple,
    plant: RigidBody,
    desired: NDArray[np.float64],
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    error: NDArray[np.float64],
    i: int,
) -> None:
    """Command the rotors of body i for one step; chosen by the type of `pilot`.

    Args:
        pilot: Gains, or Off where others have written `plant.thrust_command`.
        plant: the dynamics.
        desired: (2, N), m/s, world.
        qpos: (N, 7), as the pilot believes it.
        qvel: (N, 6), as the pilot believes it.
        error: (2, N), m/s, of the horizontal velocity on top.
        i: the body.
    """


@implements(steer, Gains)
def _fly(
    pilot: Gains,
    plant: RigidBody,
    desired: NDArray[np.float64],
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    error: NDArray[np.float64],
    i: int,
) -> None:
    track_velocity(
        pilot,
        desired[0, i],
        desired[1, i],
        plant.altitude[i],
        qvel[i, 0] + error[0, i],
        qvel[i, 1] + error[1, i],
        qpos[i],
        qvel[i],
        plant.thrust[i],
        plant.observer[i],
        plant.thrust_command[i],
    )


@implements(steer, Off)
def _leave(
    pilot: Off,
    plant: RigidBody,
    desired: NDArray[np.float64],
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    error: NDArray[np.float64],
    i: int,
) -> None:
    pass


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
    # Full thrust along gravity, ten deviations of the outer noise's velocity, and what the air can do.
    gusts = 10 * outer_force(plant.outer) / gains.mass * plant.step * sqrt(steps)
    thrust_acceleration = ROTORS * gains.thrust_max / gains.mass
    speed = sqrt(fastest_sq) + gusts + duration * (thrust_acceleration + 9.81)
    speed += duration * air_force_bound(plant.drag, plant.wind, plant.downwash, speed, drones) / gains.mass
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
def _push(plant: RigidBody, noise: NDArray[np.float64], k: int, i: int) -> None:
    """Apply the rotors' wrench, the outer noise and the downwash to body i; then let the rotors follow their commands.

    As in MuJoCo's own `filterexact` actuators, the thrust of a step is the one before this step's lag. `plant.thrust`
    is what the controller believes; battery, ground and faults make more or less of it, which its observer takes for
    a disturbance.
    """
    gains, qpos, force, thrust = plant.gains, plant.qpos, plant.qfrc_applied, plant.thrust
    lift = battery_lift(plant.battery, i) * ground_lift(plant.ground, qpos[i, 2])
    total, torque_x, torque_y, torque_z = delivered_wrench(plant.faults, gains, thrust, i)
    total *= lift
    noise_x, noise_y = draw_force(plant.outer, noise, k, i)
    qw, qx, qy, qz = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
    force[i, 0] = 2 * (qx * qz + qw * qy) * total + noise_x
    force[i, 1] = 2 * (qy * qz - qw * qx) * total + noise_y
    force[i, 2] = (1 - 2 * (qx * qx + qy * qy)) * total - washed(plant.downwash, i)
    force[i, 3], force[i, 4], force[i, 5] = lift * torque_x, lift * torque_y, lift * torque_z
    for rotor in range(ROTORS):
        thrust[i, rotor] += gains.rotor_blend * (plant.thrust_command[i, rotor] - thrust[i, rotor])


@kernel
def _meter(plant: RigidBody, duration: float) -> None:
    """Count the energy that the rotors take in a beat, at their power now."""
    thrust, extremes = plant.thrust, plant.extremes
    for i in range(thrust.shape[0]):
        lift = battery_lift(plant.battery, i)
        a, b, c, d = lift * thrust[i, 0], lift * thrust[i, 1], lift * thrust[i, 2], lift * thrust[i, 3]
        extremes.power[i] = rotor_power(plant.power_factor, a, b, c, d)
        extremes.energy[i] += extremes.power[i] * duration


@kernel
def _stop_rotors(plant: RigidBody) -> None:
    """Command nothing of the rotors that stand still."""
    for i in range(plant.stopped.shape[0]):
        for rotor in range(ROTORS):
            if plant.stopped[i, rotor]:
                plant.thrust_command[i, rotor] = 0.0


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
    noise: Noise,
    steps: int,
) -> None:
    """Controllers, rotors and MuJoCo, step by step; air and battery change once in a beat."""
    drones = plant.qpos.shape[0]
    blow(plant.wind, world.velocity, noise.gust)
    wash(plant.downwash, plant.qpos)
    _meter(plant, steps * plant.step)
    drain(plant.battery, plant.extremes.power, steps * plant.step)
    walk_biases(plant.sensors, noise.walk)
    qpos, qvel, error = believed(plant.sensors, plant.qpos, plant.qvel, velocity_error)
    collisions = _may_touch(plant, steps)
    model = plant.model if collisions else plant.model_apart
    for k in range(steps):
        for i in range(drones):
            steer(plant.pilot, plant, desired, qpos, qvel, error, i)
        _stop_rotors(plant)
        # A loop of its own: the two together compile to slower code.
        for i in range(drones):
            _watch(plant, i)
            _push(plant, noise.outer, k, i)
        add_drag(plant.drag, plant.wind, plant.qpos, plant.qvel, plant.thrust, plant.qfrc_applied)
        mj_step(model, plant.data)
        feel(plant.sensors, plant.qpos, plant.qvel, plant.qacc, noise.inertial, k)
        plant.extremes.steps[0] += 1
        if collisions:
            _mark_touches(plant)
    for i in range(drones):
        for axis in range(3):
            world.position[axis, i] = plant.qpos[i, axis]
            world.velocity[axis, i] = plant.qvel[i, axis]
        world.touched[i] = plant.extremes.touch_step[i] >= 0


@implements(take_fix, RigidBody)
def _take_fix(plant: RigidBody, velocity_error: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
    take_bearings(plant.sensors, plant.qpos, plant.qvel, velocity_error, noise, plant.faults)


@implements(write_state, RigidBody)
def write_rigid_bodies(plant: RigidBody, world: World, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:  # noqa: ARG001
    qpos[:] = plant.qpos
    qvel[:] = plant.qvel


class RigidBodyFlock:
    """A flock's MuJoCo model and data, and the plant that the compiled loop flies.

    Args:
        scenario: what is flown.
        step: integration step, s.
        beat: integration steps of a beat.
        world: where the drones start, level, with their rotors at hover.
        wind: the air, see `moflock_mj.wind`.
        faults: what breaks, see `moflock_mj.breakdown`.
        piloted: whether our controllers fly the bodies; else whoever writes their thrust commands.

    Raises:
        AirframeError: the airframe is unknown, or too weak for the scenario.
        ScenarioError: the air is too much for the airframe.
    """

    def __init__(
        self,
        scenario: Scenario,
        step: float,
        beat: int,
        world: World,
        wind: Wind | Off,
        faults: Breakdown | Off,
        *,
        piloted: bool = True,
    ) -> None:
        airframe = load_airframe(scenario.airframe)
        check_air(scenario, airframe)
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
        if isinstance(wind, Wind):
            gains = gains._replace(wind_max=largest_push(airframe, scenario.tilt_max))
        drag = make_drag(scenario, airframe)
        self.plant = RigidBody(
            gains=gains,
            pilot=gains if piloted else Off(),
            step=step,
            altitude=np.full(drones, scenario.altitude),
            stopped=faults.stopped if isinstance(faults, Breakdown) else np.zeros((drones, ROTORS), np.uint8),
            outer=make_outer_noise(scenario, airframe, step),
            wind=wind,
            drag=drag,
            downwash=make_jets(scenario, airframe),
            ground=make_ground(scenario, airframe),
            battery=make_cells(scenario, airframe),
            power_factor=power_factor(airframe),
            sensors=make_sensors(scenario, step, beat * step, world),
            faults=faults,
            reach=sqrt(airframe.radius**2 + airframe.half_height**2),
            model=self.model._address,
            model_apart=self.model_apart._address,
            data=self.data._address,
            qpos=self.data.qpos.reshape(drones, 7),
            qvel=self.data.qvel.reshape(drones, 6),
            qacc=self.data.qacc.reshape(drones, 6),
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
                energy=np.zeros(drones),
                power=np.zeros(drones),
            ),
        )
        self.plant.qpos[:, :3] = world.position.T
        self.plant.qpos[:, 3:] = (1, 0, 0, 0)
        self.plant.qvel[:, :3] = world.velocity.T
        self.plant.observer[:, :3] = world.velocity.T
        if isinstance(wind, Wind) and isinstance(drag, AirDrag):
            # The mean wind has been held before the flight starts; the observers need not find it first.
            self.plant.observer[:, 3:5] = wind_push(drag, wind.speed, airframe.mass) * wind.along

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Every array that changes in flight, by name; MuJoCo's own state is a copy, see `load_mujoco`."""
        plant = self.plant
        named = {"thrust": plant.thrust, "thrust_command": plant.thrust_command, "observer": plant.observer}
        mujoco_state = np.empty(mujoco.mj_stateSize(self.model, _MUJOCO_STATE))
        mujoco.mj_getState(self.model, self.data, mujoco_state, _MUJOCO_STATE)
        for effect in (plant.downwash, plant.battery):
            named |= {name: held for name, held in effect._asdict().items() if isinstance(held, np.ndarray)}
        if isinstance(plant.sensors, Sensors):
            named |= plant.sensors.arrays()
        named |= plant.extremes._asdict()
        return {"mujoco": mujoco_state} | {f"body.{name}": array for name, array in named.items()}

    def load_mujoco(self, state: NDArray[np.float64]) -> None:
        """Put MuJoCo's data into a state that `arrays` told."""
        mujoco.mj_setState(self.model, self.data, state, _MUJOCO_STATE)
