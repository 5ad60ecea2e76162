"""Sensors on board: their noise has the densities asked for, and without noise they tell the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.compiling import Off
from moflock_mj import Scenario
from moflock_mj.scenario import effect_configs
from moflock_mj.sensing.imu import correct_with_barometer_and_compass, make_imu, read_imu, walk_biases
from moflock_mj.world.state import TrueState
from tests.support.compiled import compiled
from tests.support.twins import quaternion_matrix

FEEL, WALK, BEARINGS = compiled(read_imu, 6), compiled(walk_biases, 2), compiled(correct_with_barometer_and_compass, 6)
STEP, INTERVAL = 0.005, 0.1


def sensors_of(drones, **noises):
    scenario = Scenario(drones=drones, imu=effect_configs.ImuConfig(**noises))
    return make_imu(scenario, STEP, INTERVAL, TrueState.at_rest(drones))


def test_rates_and_velocity_have_the_densities_asked_for():
    """White noise of density n gives rates the deviation n / sqrt(step), and their integral n sqrt(t) by time t."""
    drones, steps = 2000, 40
    imu = sensors_of(drones, gyro_noise=0.01, accel_noise=0.05)
    level = np.tile((0, 0, 0, 1.0, 0, 0, 0), (drones, 1))
    rest, draws = np.zeros((drones, 6)), np.random.default_rng(1).random((steps, 6, drones), np.float32)
    for k in range(steps):
        FEEL(imu, level, rest, rest, draws, k)
    estimated = imu.estimate.qvel
    assert estimated[:, 3:].std(axis=0) == pytest.approx(3 * [0.01 / math.sqrt(STEP)], rel=0.06)
    assert estimated[:, 2].std() == pytest.approx(0.05 * math.sqrt(steps * STEP), rel=0.06)
    tilt = 2 * imu.estimate.qpos[:, 4]
    assert tilt.std() == pytest.approx(0.01 * math.sqrt(steps * STEP), rel=0.06)


def test_biases_walk_as_asked_for():
    imu, rng = sensors_of(1000, gyro_walk=1e-3, accel_walk=2e-3), np.random.default_rng(2)
    for _ in range(50):
        WALK(imu, rng.standard_normal((1, 6, 1000)))
    assert imu.gyro_bias.std(axis=1) == pytest.approx(3 * [1e-3 * math.sqrt(50 * INTERVAL)], rel=0.08)
    assert imu.accel_bias.std(axis=1) == pytest.approx(3 * [2e-3 * math.sqrt(50 * INTERVAL)], rel=0.08)


def test_without_noise_a_reading_is_the_truth_in_the_body_frame():
    """Told by what one step of it makes of attitude and velocity."""
    imu, rng = sensors_of(5, gyro_noise=0, accel_noise=0), np.random.default_rng(3)
    qpos, qvel, qacc = rng.normal(size=(5, 7)), rng.normal(size=(5, 6)), rng.normal(size=(5, 6))
    qpos[:, 3:] /= np.linalg.norm(qpos[:, 3:], axis=1, keepdims=True)
    FEEL(imu, qpos, qvel, qacc, np.zeros((1, 6, 5), np.float32), 0)
    estimated = imu.estimate
    for i in range(5):
        force = quaternion_matrix(qpos[i, 3:]).T @ (qacc[i, :3] + np.array((0, 0, 9.81)))
        expected = quaternion_matrix(estimated.qpos[i, 3:]) @ force - (0, 0, 9.81)
        np.testing.assert_allclose(estimated.qvel[i, :3], STEP * expected, atol=1e-9)
    np.testing.assert_array_equal(estimated.qvel[:, 3:], qvel[:, 3:])


def test_a_fix_is_off_by_its_noises():
    """The first correction after a truthful start is the gain times the noise."""
    drones = 4000
    imu = sensors_of(drones, baro_noise=0.3, compass_noise=0.05)
    level, rest = np.tile((0, 0, 0, 1.0, 0, 0, 0), (drones, 1)), np.zeros((drones, 6))
    error = np.full((2, drones), 0.07)
    BEARINGS(imu, level, rest, error, np.random.default_rng(4).standard_normal((1, 2, drones)), Off())
    estimated, gains = imu.estimate, imu.estimate.gains
    assert estimated.qvel[:, :2] == pytest.approx(gains.velocity * 0.07)
    assert estimated.qpos[:, 2].std() == pytest.approx(gains.height * 0.3, rel=0.05)
    assert 2 * estimated.qpos[:, 6].std() == pytest.approx(gains.heading * 0.05, rel=0.05)
