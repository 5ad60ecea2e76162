"""What the sensors tell: at rest, in free fall, turned about, beside slow twins."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.mavlink.frames import Origin
from moflock_mj.scenario.effect_configs import ImuConfig
from moflock_mj.simulation.random_numbers import RandomStreams
from moflock_mj.simulation.realtime_bodies import RealtimeBodies
from moflock_mj.sitl.sensors import (
    DECLINATION,
    FIELD_STRENGTH,
    INCLINATION,
    SimulatedSensors,
    attitude_of_body,
    ned,
    pressure_at,
    to_body,
)

EXACT = ImuConfig(gyro_noise=0, gyro_walk=0, accel_noise=0, accel_walk=0, baro_noise=0)
STEP = 1 / 1200


def sensors_of(imu=EXACT, **scenario):
    fields = {"sigma_inner": 0.0, "sigma_outer": 0.0, "step": STEP, **scenario}
    bodies = RealtimeBodies(
        Scenario(**fields), np.array([[3.0, 4.0], [-5.0, 0.0]]), RandomStreams.of(1), 1, controlled=False
    )
    return bodies, SimulatedSensors(bodies, imu, STEP, Origin(), RandomStreams.of(2))


def matrix(quaternion):
    """Rotation matrix by MuJoCo."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.ascontiguousarray(quaternion))
    return out.reshape(3, 3)


def turned(rng, drones):
    quaternions = rng.standard_normal((drones, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def test_at_rest():
    bodies, sensors = sensors_of()
    for _ in range(600):  # they sink a little into the ground first
        bodies.advance(1)
        motion = sensors.motion()
    np.testing.assert_allclose(motion.specific_force, [[0, 0, -9.81]] * 2, atol=0.05)
    np.testing.assert_allclose(motion.gyro, 0, atol=1e-3)
    np.testing.assert_allclose(motion.attitude, [[math.sqrt(0.5), 0, 0, math.sqrt(0.5)]] * 2, atol=1e-6)
    np.testing.assert_allclose(motion.position, [[4, 3, -0.06], [0, -5, -0.06]], atol=1e-3)


def test_in_free_fall():
    bodies, sensors = sensors_of()
    bodies.qpos[:, 2] = 50.0
    bodies.qpos[:, 3:] = turned(np.random.default_rng(1), 2)
    for _ in range(120):
        bodies.advance(1)
        motion = sensors.motion()
    np.testing.assert_allclose(motion.specific_force, 0, atol=1e-9)
    np.testing.assert_allclose(motion.velocity[:, 2], 9.81 * 0.1)


def test_a_push_along_the_nose_and_a_turn_to_the_right():
    bodies, sensors = sensors_of()
    bodies.qpos[:, 2] = 50.0
    bodies.qvel[:, :3] = (0.01, 0, 0)  # in one step, before the first reading
    bodies.qvel[:, 3:] = (0.1, 0.2, 0.3)
    motion = sensors.motion()
    # The mean of six readings, of which five were at rest.
    np.testing.assert_allclose(motion.specific_force, [[0.01 / STEP / 6, 0, -9.81]] * 2)
    np.testing.assert_allclose(motion.gyro, [[0.1, -0.2, -0.3]] * 2)


def test_who_reads_at_another_rate_still_gets_the_velocity_that_was_gained():
    """ArduPilot's simulated IMUs: the specific force, held until the next reading, is summed up at their own rates."""
    bodies, sensors = sensors_of()
    bodies.qpos[:, 2] = 50.0
    rates, rng = np.array([1000, 800, 760]), np.random.default_rng(1)
    gained, sampled, errors = np.zeros((3, 2)), np.zeros(3), []
    for step in range(20 * 1200):
        bodies.qvel[:, 0] += math.sqrt(2 * 0.2 * STEP) * rng.standard_normal(2)  # the paper's outer noise
        due = sampled / rates <= step * STEP
        gained[due] += sensors.motion().specific_force[:, 0] / rates[due, None]
        sampled += due
        if step % 1200 == 0:
            errors.append(gained - bodies.qvel[:, 0])
    gone_astray = np.sqrt(np.mean(np.diff(errors, axis=0) ** 2, axis=(0, 2)))
    assert gone_astray.max() < 0.1, f"{gone_astray} m/s in a second"


def test_frames_beside_rotation_matrices():
    rng = np.random.default_rng(1)
    quaternions, vectors = turned(rng, 20), rng.standard_normal((20, 3))
    exchange = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
    flip = np.diag([1.0, -1, -1])
    for quaternion, vector, seen, attitude in zip(
        quaternions, vectors, to_body(quaternions, vectors), attitude_of_body(quaternions), strict=True
    ):
        np.testing.assert_allclose(seen, flip @ matrix(quaternion).T @ vector, atol=1e-12)
        np.testing.assert_allclose(matrix(attitude), exchange @ matrix(quaternion) @ flip, atol=1e-12)
        assert attitude[0] >= 0
    np.testing.assert_array_equal(ned(ned(vectors)), vectors)


def test_noise_and_biases_have_the_deviations_asked_for():
    imu = ImuConfig(gyro_walk=0, accel_walk=0)
    _, sensors = sensors_of(imu)
    readings = [sensors.motion() for _ in range(2000)]
    assert np.std([reading.gyro for reading in readings]) == pytest.approx(imu.gyro_noise / math.sqrt(STEP), rel=0.05)
    force = np.array([reading.specific_force for reading in readings])
    assert np.std(force[:, :, 0]) == pytest.approx(imu.accel_noise / math.sqrt(STEP), rel=0.05)
    _, sensors = sensors_of(ImuConfig(gyro_noise=0, accel_noise=0, gyro_walk=0.01, accel_walk=0.1))
    walks = np.array([sensors.motion().gyro for _ in range(2400)])
    # After T = 2 s: deviation 0.01 sqrt(2); six of them.
    assert 0.004 < np.sqrt(np.mean(walks[-1] ** 2)) < 0.03


def test_gps_errors_are_the_scenarios():
    bodies, sensors = sensors_of(sigma_inner=0.05)
    for _ in range(600):
        bodies.advance(1)
    motion = sensors.motion()
    assert np.abs(bodies.velocity_error).max() > 0
    np.testing.assert_allclose(motion.velocity[:, :2], bodies.velocity_error.T[:, ::-1], atol=1e-3)
    np.testing.assert_allclose(motion.position[:, :2] - [[4, 3], [0, -5]], bodies.position_error.T[:, ::-1], atol=1e-3)


def test_the_magnetic_field_points_north_and_down():
    bodies, sensors = sensors_of()
    bodies.qpos[1, 3:] = (math.sqrt(0.5), 0, 0, math.sqrt(0.5))  # turned left from east: north
    field = np.mean([sensors.surroundings().magnetic_field for _ in range(500)], axis=0)
    flat, down = FIELD_STRENGTH * math.cos(INCLINATION), FIELD_STRENGTH * math.sin(INCLINATION)
    north, east = flat * math.cos(DECLINATION), flat * math.sin(DECLINATION)
    np.testing.assert_allclose(field, [[east, -north, down], [north, east, down]], atol=5e-4)


@pytest.mark.parametrize(("altitude", "pressure"), [(0.0, 101_325.0), (1000.0, 89_874.6), (5000.0, 54_019.9)])
def test_pressure_is_the_standard_atmospheres(altitude, pressure):
    """Table of ISO 2533."""
    assert pressure_at(np.array([altitude]))[0] == pytest.approx(pressure, rel=1e-4)


def test_the_barometer_is_at_the_origins_altitude():
    _, sensors = sensors_of()
    read = sensors.surroundings()
    np.testing.assert_allclose(read.pressure_altitude, 488.06)
    np.testing.assert_allclose(read.temperature, 15 - 0.0065 * 488.06)
    np.testing.assert_allclose(read.pressure, pressure_at(np.array([488.06]))[0])
