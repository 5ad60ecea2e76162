"""The estimator: against its slow twin, and what it finds out."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controllers.compiling import kernel
from controllers.state_estimation import FixGains, StateEstimate, correct, design_fixes, integrate
from tests.support.twins import Navigator, quaternion_matrix

NOISES = {
    "period": 0.2,
    "gyro_noise": 2.44e-4,
    "gyro_walk": 1.94e-5,
    "accel_noise": 1.86e-3,
    "accel_walk": 3e-3,
    "velocity_noise": 0.07,
    "height_noise": 0.1,
    "heading_noise": 0.035,
}


@kernel
def read(state, i, rates, force):
    integrate(state, i, rates[0], rates[1], rates[2], force[0], force[1], force[2])


def estimates(gains, drones=1, step=0.005):
    qpos, qvel = np.zeros((drones, 7)), np.zeros((drones, 6))
    qpos[:, 3] = 1
    return StateEstimate(step, 9.81, gains, qpos, qvel, np.zeros((3, drones)), np.zeros(drones))


def test_agrees_with_its_slow_twin():
    state, rng = estimates(design_fixes(**NOISES)), np.random.default_rng(1)
    slow = Navigator(state.gains, 0.005, np.eye(3), np.zeros(3), 0.0)
    for k in range(400):
        rates, force = rng.normal(scale=0.5, size=3), np.array((0, 0, 9.81)) + rng.normal(scale=3, size=3)
        read(state, 0, rates, force)
        slow.integrate(rates, force)
        if k % 40 == 0:
            fix = rng.normal(size=2), rng.normal(), rng.uniform(-math.pi, math.pi)
            correct(state, 0, *fix[0], *fix[1:])
            slow.correct(*fix)
    np.testing.assert_allclose(quaternion_matrix(state.qpos[0, 3:]), slow.rotation, atol=2e-4)
    np.testing.assert_allclose(state.qvel[0], [*slow.velocity, *slow.rates], atol=5e-3)
    assert state.qpos[0, 2] == pytest.approx(slow.height, abs=5e-3)
    np.testing.assert_allclose(state.rate_bias[:, 0], slow.rate_bias, atol=1e-6)
    assert state.lift_bias[0] == pytest.approx(slow.lift_bias, abs=1e-6)


def test_the_gain_of_one_noisy_constant_is_the_textbooks():
    """Heading by a gyroscope without a walking bias: with q per period and r per fix, p^2 = q (p + r)."""
    gains = design_fixes(**NOISES | {"gyro_walk": 0.0, "gyro_noise": 0.01})
    q, r = 0.01**2 * 0.2, 0.035**2
    prior = q / 2 + math.sqrt(q * q / 4 + q * r)
    assert gains.heading == pytest.approx(prior / (prior + r), rel=1e-2)
    assert all(math.isfinite(gain) for gain in design_fixes(**dict.fromkeys(NOISES, 0.0) | {"period": 0.2}))


def test_a_gyroscope_that_is_wrong_is_found_out():
    """At rest, level, with biases on every axis: they are learned, and tilt, velocity and height come back."""
    state = estimates(design_fixes(**NOISES | {"gyro_walk": 1e-3}))
    bias = np.array([0.01, -0.02, 0.015])
    for k in range(200 * 120):
        read(state, 0, bias, np.array([0, 0, 9.81 + 0.05]))
        if k % 40 == 0:
            correct(state, 0, 0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(state.rate_bias[:, 0], bias, atol=1e-4)
    assert state.lift_bias[0] == pytest.approx(0.05, abs=1e-3)
    assert math.acos(quaternion_matrix(state.qpos[0, 3:])[2, 2]) < 1e-3
    assert np.abs(state.qvel[0, :3]).max() < 1e-2


def test_a_wrong_tilt_is_found_out_by_velocity():
    state = estimates(design_fixes(**NOISES))
    mujoco.mju_axisAngle2Quat(state.qpos[0, 3:], np.array([0.6, 0.8, 0]), 0.1)
    for k in range(200 * 60):
        read(state, 0, np.zeros(3), np.array([0, 0, 9.81]))
        if k % 40 == 0:
            correct(state, 0, 0.0, 0.0, 0.0, 0.0)
    assert math.acos(quaternion_matrix(state.qpos[0, 3:])[2, 2]) < 2e-3


def test_perfect_sensors_follow_mujoco_exactly_enough():
    """A body thrown with a spin, its true rates and forces integrated for two seconds."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><option timestep='0.005'/><worldbody><body><freejoint/><inertial pos='0 0 0' mass='1' "
        "diaginertia='1 2 2.5'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[:] = (3, 1, 8, 0.4, -0.9, 1.5)
    state = estimates(FixGains(*8 * [0.0]))
    state.qvel[0] = data.qvel
    for _ in range(400):
        data.qfrc_applied[:3] = (2, 0, 9)
        mujoco.mj_step(model, data)
        force = quaternion_matrix(data.qpos[3:]).T @ (data.qacc[:3] + np.array((0, 0, 9.81)))
        read(state, 0, data.qvel[3:].copy(), force)
    np.testing.assert_allclose(state.qpos[0, 3:], data.qpos[3:], atol=1e-4)
    np.testing.assert_allclose(state.qvel[0], data.qvel, atol=1e-3)
    assert state.qpos[0, 2] == pytest.approx(data.qpos[2], abs=1e-3)
