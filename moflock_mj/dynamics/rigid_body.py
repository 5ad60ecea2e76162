"""Rigid-body dynamics: the controllers' rotor thrusts push MuJoCo bodies."""

from __future__ import annotations

import copy
from math import sqrt
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS
from controllers.compiling import Off, hot_stage, implements
from controllers.flight_control.cascade import OBSERVER_SIZE, Gains, track_velocity
from controllers.flight_control.gain_design import GainDesignError, design_gains, maximum_horizontal_force
from moflock_mj.dynamics.airframe_models import flock_model, load_airframe
from moflock_mj.dynamics.bodies import FlightStatistics, RigidBody
from moflock_mj.dynamics.contacts import _mark_touches, _may_touch
from moflock_mj.dynamics.interface import Noise, advance, take_fix, write_state
from moflock_mj.dynamics.mujoco_step import mj_step
from moflock_mj.dynamics.rotors import _apply_rotor_wrench, _draw_power, _stop_rotors, _update_statistics
from moflock_mj.effects.battery import drain, make_battery
from moflock_mj.effects.disturbance import make_disturbance
from moflock_mj.effects.downwash import make_downwash, write_downwash
from moflock_mj.effects.drag import Drag, add_drag, make_drag, wind_push
from moflock_mj.effects.fault_injection import FaultSchedule
from moflock_mj.effects.feasibility import check_air
from moflock_mj.effects.ground_effect import make_ground_effect
from moflock_mj.effects.rotor_power import power_factor
from moflock_mj.effects.wind import Wind, blow
from moflock_mj.errors import AirframeError
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.sensing.imu import Imu, correct_with_barometer_and_compass, estimated, make_imu, read_imu, walk_biases
from moflock_mj.world.state import TrueState

_MUJOCO_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@hot_stage
def steer(
    controller: NamedTuple,
    dynamics: RigidBody,
    desired: NDArray[np.float64],
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    error: NDArray[np.float64],
    i: int,
) -> None:
    """Command the rotors of body i for one step.

    Args:
        controller: Gains, or Off where others have written `dynamics.thrust_command`.
        dynamics: the dynamics.
        desired: (2, N), m/s, world.
        qpos: (N, 7), as the pilot believes it.
        qvel: (N, 6), as the pilot believes it.
        error: (2, N), m/s, of the horizontal velocity on top.
        i: the body.
    """


@implements(steer, Gains)
def _fly(
    controller: Gains,
    dynamics: RigidBody,
    desired: NDArray[np.float64],
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    error: NDArray[np.float64],
    i: int,
) -> None:
    track_velocity(
        controller,
        desired[0, i],
        desired[1, i],
        dynamics.altitude[i],
        qvel[i, 0] + error[0, i],
        qvel[i, 1] + error[1, i],
        qpos[i],
        qvel[i],
        dynamics.thrust[i],
        dynamics.observer[i],
        dynamics.thrust_command[i],
    )


@implements(advance, RigidBody)
def advance_rigid_bodies(
    dynamics: RigidBody,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: Noise,
    steps: int,
) -> None:
    """Controllers, rotors and MuJoCo, step by step; air and battery change once in a beat."""
    drones = dynamics.qpos.shape[0]
    blow(dynamics.wind, world.velocity, noise.gust)
    write_downwash(dynamics.downwash, dynamics.qpos)
    _draw_power(dynamics, steps * dynamics.step)
    drain(dynamics.battery, dynamics.statistics.power, steps * dynamics.step)
    walk_biases(dynamics.imu, noise.walk)
    qpos, qvel, error = estimated(dynamics.imu, dynamics.qpos, dynamics.qvel, velocity_error)
    collisions = _may_touch(dynamics, steps)
    model = dynamics.model if collisions else dynamics.model_apart
    for k in range(steps):
        for i in range(drones):
            steer(dynamics.controller, dynamics, desired, qpos, qvel, error, i)
        _stop_rotors(dynamics)
        # A loop of its own: the two together compile to slower code.
        for i in range(drones):
            _update_statistics(dynamics, i)
            _apply_rotor_wrench(dynamics, noise.outer, k, i)
        add_drag(dynamics.drag, dynamics.wind, dynamics.qpos, dynamics.qvel, dynamics.thrust, dynamics.qfrc_applied)
        mj_step(model, dynamics.data)
        read_imu(dynamics.imu, dynamics.qpos, dynamics.qvel, dynamics.qacc, noise.inertial, k)
        dynamics.statistics.steps[0] += 1
        if collisions:
            _mark_touches(dynamics)
    for i in range(drones):
        for axis in range(3):
            world.position[axis, i] = dynamics.qpos[i, axis]
            world.velocity[axis, i] = dynamics.qvel[i, axis]
        world.touched[i] = dynamics.statistics.touch_step[i] >= 0


@implements(take_fix, RigidBody)
def _take_fix(dynamics: RigidBody, velocity_error: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
    correct_with_barometer_and_compass(
        dynamics.imu, dynamics.qpos, dynamics.qvel, velocity_error, noise, dynamics.faults
    )


@implements(write_state, RigidBody)
def write_rigid_bodies(
    dynamics: RigidBody,
    world: TrueState,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
) -> None:
    qpos[:] = dynamics.qpos
    qvel[:] = dynamics.qvel


class RigidBodyModel:
    """A flock's MuJoCo model and data, and the plant that the compiled loop flies.

    Args:
        scenario: what is flown.
        step: integration step, s.
        interval: integration steps of a beat.
        world: where the drones start, level, with their rotors at hover.
        wind: the air, see `moflock_mj.effects.wind`.
        faults: what breaks, see `moflock_mj.effects.fault_injection`.
        controlled: whether our controllers fly the bodies; else whoever writes their thrust commands.

    Raises:
        AirframeError: the airframe is unknown, or too weak for the scenario.
        ScenarioError: the air is too much for the airframe.
    """

    def __init__(
        self,
        scenario: Scenario,
        step: float,
        interval: int,
        world: TrueState,
        wind: Wind | Off,
        faults: FaultSchedule | Off,
        *,
        controlled: bool = True,
    ) -> None:
        airframe = load_airframe(scenario.airframe)
        check_air(scenario, airframe)
        try:
            self.design = design_gains(
                airframe, step=step, tau=scenario.tau, a_max=scenario.a_max, tilt_max=scenario.tilt_max
            )
        except GainDesignError as problem:
            raise AirframeError(str(problem)) from None
        self.airframe = airframe
        drones = scenario.drones
        self.model = flock_model(scenario.airframe, drones, step)
        self.model_apart = copy.copy(self.model)
        self.model_apart.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.data = mujoco.MjData(self.model)
        gains = self.design.gains
        if isinstance(wind, Wind):
            gains = gains._replace(wind_max=maximum_horizontal_force(airframe, scenario.tilt_max))
        drag = make_drag(scenario, airframe)
        self.dynamics = RigidBody(
            gains=gains,
            controller=gains if controlled else Off(),
            step=step,
            altitude=np.full(drones, scenario.altitude),
            stopped=faults.stopped if isinstance(faults, FaultSchedule) else np.zeros((drones, ROTORS), np.uint8),
            outer=make_disturbance(scenario, airframe, step),
            wind=wind,
            drag=drag,
            downwash=make_downwash(scenario, airframe),
            ground=make_ground_effect(scenario, airframe),
            battery=make_battery(scenario, airframe),
            power_factor=power_factor(airframe),
            imu=make_imu(scenario, step, interval * step, world),
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
            statistics=FlightStatistics(
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
        self.dynamics.qpos[:, :3] = world.position.T
        self.dynamics.qpos[:, 3:] = (1, 0, 0, 0)
        self.dynamics.qvel[:, :3] = world.velocity.T
        self.dynamics.observer[:, :3] = world.velocity.T
        if isinstance(wind, Wind) and isinstance(drag, Drag):
            # The mean wind has been held before the flight starts; the observers need not find it first.
            self.dynamics.observer[:, 3:5] = wind_push(drag, wind.speed, airframe.mass) * wind.along

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Every array that changes in flight, by name; MuJoCo's own state is a copy, see `load_mujoco`."""
        dynamics = self.dynamics
        named = {"thrust": dynamics.thrust, "thrust_command": dynamics.thrust_command, "observer": dynamics.observer}
        mujoco_state = np.empty(mujoco.mj_stateSize(self.model, _MUJOCO_STATE))
        mujoco.mj_getState(self.model, self.data, mujoco_state, _MUJOCO_STATE)
        for effect in (dynamics.downwash, dynamics.battery):
            named |= {name: held for name, held in effect._asdict().items() if isinstance(held, np.ndarray)}
        if isinstance(dynamics.imu, Imu):
            named |= dynamics.imu.arrays()
        named |= dynamics.statistics._asdict()
        return {"mujoco": mujoco_state} | {f"body.{name}": array for name, array in named.items()}

    def load_mujoco(self, state: NDArray[np.float64]) -> None:
        """Put MuJoCo's data into a state that `arrays` told."""
        mujoco.mj_setState(self.model, self.data, state, _MUJOCO_STATE)
