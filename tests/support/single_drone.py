"""Single drone in MuJoCo, controlled by the compiled controller from Python."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from controllers.flight_control.cascade import OBSERVER_SIZE, rotor_wrench, track_velocity
from controllers.flight_control.gain_design import design_gains
from moflock_mj.dynamics.airframe_models import airframe_path, flock_model, load_airframe


class Track(NamedTuple):
    """Recorded flight, one row per step."""

    t: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    tilt: np.ndarray
    disturbance: np.ndarray

    @property
    def speed(self):
        return np.hypot(self.velocity[:, 0], self.velocity[:, 1])

    @property
    def acceleration(self):
        """(T - 1,), m/s^2, horizontal acceleration between rows."""
        return np.hypot(*(np.diff(self.velocity[:, :2], axis=0) / (self.t[1] - self.t[0])).T)


class SingleDrone:
    """Drone in the model of a flock, or in its airframe's own model with MuJoCo's actuators."""

    def __init__(self, airframe="x500", step=0.005, own_actuators=False, altitude=20.0, **settings):
        self.airframe = load_airframe(airframe)
        self.gains = design_gains(self.airframe, step=step, **settings).gains
        self.own_actuators = own_actuators
        if own_actuators:
            self.model = mujoco.MjModel.from_xml_path(str(airframe_path(airframe)))
            self.model.opt.timestep = step
        else:
            self.model = flock_model(airframe, 1, step)
        self.data = mujoco.MjData(self.model)
        self.altitude = altitude
        self.data.qpos[:] = (0, 0, altitude, 1, 0, 0, 0)
        self.observer = np.zeros(OBSERVER_SIZE)
        self.command = np.zeros(4)
        self.thrust = self.data.act if own_actuators else np.empty(4)
        self.thrust[:] = self.airframe.hover_thrust()

    def tilted(self, angle, heading=0.0):
        """Tilt the drone by `angle` about a horizontal axis at the angle `heading` to x, rad; return the drone."""
        axis = np.array([math.cos(heading), math.sin(heading), 0.0])
        mujoco.mju_axisAngle2Quat(self.data.qpos[3:], axis, angle)
        return self

    def fly(self, duration, desired, force=(0, 0, 0), controlled=True):
        """Fly and record. `desired`: velocity (2,), m/s, or a function of time; `force`: (3,), N, world."""
        rows = []
        steps = round(duration / self.gains.step)
        for step in range(steps + 1):
            t = step * self.gains.step
            q, v = self.data.qpos, self.data.qvel
            upright = 1 - 2 * (q[4] ** 2 + q[5] ** 2)
            rows.append((t, q[:3].copy(), v[:3].copy(), math.acos(min(upright, 1)), self.observer[3:].copy()))
            command = desired(t) if callable(desired) else desired
            if controlled:
                track_velocity(
                    self.gains,
                    *map(float, command),
                    self.altitude,
                    v[0],
                    v[1],
                    q,
                    v,
                    self.thrust,
                    self.observer,
                    self.command,
                )
            self._step(np.asarray(force, float))
        return Track(*map(np.array, zip(*rows, strict=True)))

    def _step(self, force):
        data = self.data
        data.xfrc_applied[1, :3] = force
        if self.own_actuators:
            data.ctrl[:] = self.command
        else:
            total, *torque = rotor_wrench(self.gains, self.thrust)
            thrust = np.empty(3)
            mujoco.mju_rotVecQuat(thrust, np.array([0, 0, total]), data.qpos[3:])
            data.qfrc_applied[:] = (*thrust, *torque)
            self.thrust += self.gains.rotor_blend * (self.command - self.thrust)
        mujoco.mj_step(self.model, data)
