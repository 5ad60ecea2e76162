"""Rigid-body dynamics: MuJoCo bodies under the thrusts of their controllers."""

from __future__ import annotations

import copy
from math import sqrt
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS
from controllers.compiling import Off, hot_stage, implements
from controllers.flight_control.cascade import OBSERVER_SIZE, Gains, track_velocity
from controllers.flight_control.gain_design import GainDesignError, design_gains, maximum_horizontal_force
from moflock_mj.dynamics.airframe_models import flock_model, load_airframe
from moflock_mj.dynamics.bodies import BodyModel, BodyState, Effects, FlightStatistics, RigidBody
from moflock_mj.dynamics.contacts import mark_touches, may_touch
from moflock_mj.dynamics.interface import Noise, advance, take_fix, write_state
from moflock_mj.dynamics.mujoco_step import mj_step
from moflock_mj.dynamics.rotors import apply_rotor_wrench, draw_power, stop_rotors, update_statistics
from moflock_mj.effects.battery import drain, make_battery
from moflock_mj.effects.disturbance import make_disturbance
from moflock_mj.effects.downwash import make_downwash, write_downwash
from moflock_mj.effects.drag import Drag, add_drag, make_drag, wind_push
from moflock_mj.effects.fault_injection import FaultSchedule
from moflock_mj.effects.feasibility import check_feasible
from moflock_mj.effects.ground_effect import make_ground_effect
from moflock_mj.effects.rotor_power import power_factor
from moflock_mj.effects.wind import Wind, blow
from moflock_mj.errors import AirframeError
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.sensing.imu import correct_with_barometer_and_compass, estimated, make_imu, read_imu, walk_biases
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
    """Command the rotors of body i for one step; without a controller the caller's thrust commands remain.

    Args:
        controller: gains, or Off if the caller writes `dynamics.state.thrust_command`.
        dynamics: the dynamics.
        desired: (2, N), desired velocity, m/s, world.
        qpos: (N, 7), position and attitude for the controller.
        qvel: (N, 6), velocities for the controller.
        error: (2, N), additional error of the horizontal velocity, m/s.
        i: number of the body.
    """


@implements(steer, Gains)
def _track_velocity(
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
        dynamics.state.altitude[i],
        qvel[i, 0] + error[0, i],
        qvel[i, 1] + error[1, i],
        qpos[i],
        qvel[i],
        dynamics.state.thrust[i],
        dynamics.state.observer[i],
        dynamics.state.thrust_command[i],
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
    """Run controllers, rotors and MuJoCo step by step; wind and battery change once per interval."""
    drones = dynamics.state.qpos.shape[0]
    blow(dynamics.effects.wind, world.velocity, noise.gust)
    write_downwash(dynamics.effects.downwash, dynamics.state.qpos)
    draw_power(dynamics, steps * dynamics.model.step)
    drain(dynamics.effects.battery, dynamics.statistics.power, steps * dynamics.model.step)
    walk_biases(dynamics.effects.imu, noise.walk)
    qpos, qvel, error = estimated(dynamics.effects.imu, dynamics.state.qpos, dynamics.state.qvel, velocity_error)
    collisions = may_touch(dynamics, steps)
    model = dynamics.model.mujoco if collisions else dynamics.model.mujoco_apart
    for k in range(steps):
        for i in range(drones):
            steer(dynamics.controller, dynamics, desired, qpos, qvel, error, i)
        stop_rotors(dynamics)
        # A single loop with the one above compiles to slower code.
        for i in range(drones):
            update_statistics(dynamics, i)
            apply_rotor_wrench(dynamics, noise.outer, k, i)
        add_drag(
            dynamics.effects.drag,
            dynamics.effects.wind,
            dynamics.state.qpos,
            dynamics.state.qvel,
            dynamics.state.thrust,
            dynamics.state.qfrc_applied,
        )
        mj_step(model, dynamics.model.data)
        read_imu(dynamics.effects.imu, dynamics.state.qpos, dynamics.state.qvel, dynamics.state.qacc, noise.inertial, k)
        dynamics.statistics.steps[0] += 1
        if collisions:
            mark_touches(dynamics)
    for i in range(drones):
        for axis in range(3):
            world.position[axis, i] = dynamics.state.qpos[i, axis]
            world.velocity[axis, i] = dynamics.state.qvel[i, axis]
        world.touched[i] = dynamics.statistics.touch_step[i] >= 0


@implements(take_fix, RigidBody)
def _take_fix(dynamics: RigidBody, velocity_error: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
    correct_with_barometer_and_compass(
        dynamics.effects.imu, dynamics.state.qpos, dynamics.state.qvel, velocity_error, noise, dynamics.effects.faults
    )


@implements(write_state, RigidBody)
def write_rigid_bodies(
    dynamics: RigidBody,
    world: TrueState,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
) -> None:
    qpos[:] = dynamics.state.qpos
    qvel[:] = dynamics.state.qvel


class RigidBodyModel:
    """MuJoCo model and data of a flock, and its dynamics for the compiled loop.

    Args:
        scenario: the scenario.
        step: integration step, s.
        interval: integration steps per control interval.
        world: initial state, with level drones and their rotors at hover.
        wind: the wind, or Off, see `moflock_mj.effects.wind`.
        faults: the fault schedule, or Off, see `moflock_mj.effects.fault_injection`.
        controlled: True to run the controllers; otherwise the caller writes the thrust commands.

    Raises:
        AirframeError: the airframe is unknown, or too weak for the scenario.
        ScenarioError: the airframe is too weak for the wind.
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
        effects = Effects(
            disturbance=make_disturbance(scenario, airframe, step),
            wind=wind,
            drag=make_drag(scenario, airframe),
            downwash=make_downwash(scenario, airframe),
            ground_effect=make_ground_effect(scenario, airframe),
            battery=make_battery(scenario, airframe),
            imu=make_imu(scenario, step, interval * step, world),
            faults=faults,
        )
        check_feasible(scenario, airframe, effects.drag, effects.battery)
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
        self.dynamics = RigidBody(
            model=BodyModel(
                gains=gains,
                step=step,
                reach=sqrt(airframe.radius**2 + airframe.half_height**2),
                power_factor=power_factor(airframe),
                mujoco=self.model._address,
                mujoco_apart=self.model_apart._address,
                data=self.data._address,
            ),
            controller=gains if controlled else Off(),
            effects=effects,
            state=BodyState(
                qpos=self.data.qpos.reshape(drones, 7),
                qvel=self.data.qvel.reshape(drones, 6),
                qacc=self.data.qacc.reshape(drones, 6),
                qfrc_applied=self.data.qfrc_applied.reshape(drones, 6),
                qfrc_constraint=self.data.qfrc_constraint.reshape(drones, 6),
                altitude=np.full(drones, scenario.altitude),
                stopped=faults.stopped if isinstance(faults, FaultSchedule) else np.zeros((drones, ROTORS), np.uint8),
                thrust=np.full((drones, ROTORS), airframe.hover_thrust()),
                thrust_command=np.full((drones, ROTORS), airframe.hover_thrust()),
                observer=np.zeros((drones, OBSERVER_SIZE)),
            ),
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
        self.dynamics.state.qpos[:, :3] = world.position.T
        self.dynamics.state.qpos[:, 3:] = (1, 0, 0, 0)
        self.dynamics.state.qvel[:, :3] = world.velocity.T
        self.dynamics.state.observer[:, :3] = world.velocity.T
        if isinstance(wind, Wind) and isinstance(effects.drag, Drag):
            # Start with converged observers: the drones held their positions against the mean wind before the flight.
            self.dynamics.state.observer[:, 3:5] = wind_push(effects.drag, wind.speed, airframe.mass) * wind.along

    def mujoco_state(self) -> NDArray[np.float64]:
        """Copy of MuJoCo's integration state, from which `load_mujoco` continues bit-identically."""
        state = np.empty(mujoco.mj_stateSize(self.model, _MUJOCO_STATE))
        mujoco.mj_getState(self.model, self.data, state, _MUJOCO_STATE)
        return state

    def load_mujoco(self, state: NDArray[np.float64]) -> None:
        """Restore a state from `mujoco_state`."""
        mujoco.mj_setState(self.model, self.data, state, _MUJOCO_STATE)
