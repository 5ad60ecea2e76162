"""The whole controller: against its slow twin, and single drones in flight."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controllers.flight_control.cascade import rotor_wrench, track_velocity
from controllers.flight_control.gain_design import design_gains
from moflock_mj.dynamics.airframe_models import airframe_names, load_airframe
from tests.support.single_drone import SingleDrone

AIRFRAMES = airframe_names()


def slow_track_velocity(gains, desired, altitude, measured, qpos, qvel, thrust, observer):
    """The unsaturated controller with vectors and matrices.

    Returns the rotors' thrusts, what they were without yaw (which must fit as well), and the next observer.
    """
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, qpos[3:])
    rotation = rotation.reshape(3, 3)
    disturbance = observer[3:]

    wanted = np.append((desired - measured) * gains.velocity_gain, 0)
    wanted *= min(1, gains.a_max / max(np.linalg.norm(wanted), 1e-300))
    climb = np.clip(gains.altitude_gain * (altitude - qpos[2]), -gains.climb_rate_max, gains.climb_rate_max)
    limit = gains.vertical_acceleration_max
    wanted[2] = np.clip(gains.climb_gain * (climb - qvel[2]), -limit, limit)
    force = wanted + np.array((0, 0, gains.gravity)) - disturbance
    force[:2] *= min(1, gains.tilt_tangent * force[2] / max(np.linalg.norm(force[:2]), 1e-300))

    n = rotation.T @ (force / np.linalg.norm(force))
    rates = np.cross((0, 0, 1), n) * math.sqrt(2 / (1 + n[2])) * gains.tilt_gain
    rates *= min(1, gains.body_rate_max / max(np.linalg.norm(rates), 1e-300))
    rates[2] = gains.heading_gain * rotation[0, 1]
    inertia = np.array([gains.inertia_x, gains.inertia_y, gains.inertia_z])
    gain = np.array([gains.rate_gain_x, gains.rate_gain_y, gains.rate_gain_z])
    torque = gain * (rates - qvel[3:]) + np.cross(qvel[3:], inertia * qvel[3:])
    upright = rotation[2, 2]
    total = gains.mass * force[2] * upright / max(upright, gains.tilt_cosine) ** 2

    innovation = np.append(measured, qvel[2]) - observer[:3]
    modelled = rotation[:, 2] * thrust.sum() / gains.mass - (0, 0, gains.gravity)
    predicted = observer[:3] + gains.step * (modelled + disturbance + gains.observer_velocity_gain * innovation)
    next_disturbance = disturbance + gains.step * gains.observer_disturbance_gain * innovation
    bound = np.array((gains.wind_max, gains.wind_max, gains.disturbance_max))
    next_observer = np.append(predicted, np.clip(next_disturbance, -bound, bound))
    return gains.mixer @ (total, *torque), gains.mixer @ (total, *torque[:2], 0), next_observer


@pytest.mark.parametrize("name", AIRFRAMES)
def test_agrees_with_its_slow_twin(name):
    airframe = load_airframe(name)
    gains = design_gains(airframe, step=0.005).gains._replace(wind_max=1.5, disturbance_max=0.8)
    rng = np.random.default_rng(7)
    unsaturated = 0
    for _ in range(300):
        qpos = np.append((0, 0, 20 + rng.normal(scale=0.3)), (1, *rng.normal(scale=0.1, size=3)))
        qpos[3:] /= np.linalg.norm(qpos[3:])
        qvel = rng.normal(scale=0.3, size=6)
        desired, measured = rng.normal(scale=4, size=(2, 2))
        thrust = rng.uniform(0, airframe.thrust_max, 4)
        observer = rng.normal(size=6)
        expected, tilting, next_observer = slow_track_velocity(
            gains, desired, 20.0, measured, qpos, qvel, thrust, observer
        )
        command = np.empty(4)
        track_velocity(gains, *desired, 20.0, *measured, qpos, qvel, thrust, observer, command)
        assert observer == pytest.approx(next_observer, abs=1e-12)
        both = np.append(expected, tilting)
        if both.min() > 0 and both.max() < airframe.thrust_max:
            unsaturated += 1
            assert command == pytest.approx(expected, abs=1e-12)
    assert unsaturated > 25


@pytest.mark.parametrize("name", AIRFRAMES)
def test_hover_takes_the_weight_shared_by_four(name):
    drone = SingleDrone(name)
    track = drone.fly(1, (0, 0))
    weight = drone.airframe.mass * 9.81
    assert drone.thrust == pytest.approx(weight / 4, rel=1e-12)
    assert rotor_wrench(drone.gains, drone.thrust) == pytest.approx((weight, 0, 0, 0), abs=1e-12)
    assert track.position[-1] == pytest.approx((0, 0, 20), abs=1e-12)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_free_fall_without_thrust(name):
    drone = SingleDrone(name, altitude=100.0)
    drone.thrust[:] = 0
    track = drone.fly(2, (0, 0), controlled=False)
    assert track.velocity[:, 2] == pytest.approx(-9.81 * track.t, abs=1e-9)
    # MuJoCo's Euler step moves with the new velocity: half a step more than g t^2 / 2.
    assert track.position[-1, 2] == pytest.approx(100 - 9.81 * 2 * (2 + 0.005) / 2, abs=1e-9)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_velocity_step(name):
    track = SingleDrone(name).fly(12, (6, 0))
    assert track.speed.max() < 6 * 1.1
    assert abs(track.speed - 6)[track.t > 6].max() < 0.1
    assert track.acceleration.max() < 6 * 1.05
    assert 20 - track.position[:, 2].min() < 0.3
    # The point mass: 6 m/s^2 at first, then exponentially with tau; the body follows within the time it takes to tilt.
    assert track.speed == pytest.approx(6 * (1 - np.exp(-track.t)), abs=0.8)


@pytest.mark.parametrize("name", AIRFRAMES)
@pytest.mark.parametrize("heading", [0.0, 0.7, 2.5])
def test_recovers_from_60_degrees_of_tilt(name, heading):
    track = SingleDrone(name).tilted(math.radians(60), heading).fly(10, (0, 0))
    assert track.tilt[track.t > 1.5].max() < math.radians(5)
    assert 20 - track.position[:, 2].min() < 0.3
    assert track.speed[-1] < 0.01


@pytest.mark.parametrize("name", AIRFRAMES)
def test_recovers_from_upside_down(name):
    track = SingleDrone(name).tilted(math.radians(175), 0.7).fly(10, (0, 0))
    assert track.tilt[track.t > 2].max() < math.radians(5)
    assert track.position[-1, 2] == pytest.approx(20, abs=0.01)


@pytest.mark.parametrize("yaw", [-2.5, 1.0, 3.0])
def test_turns_back_to_its_heading(yaw):
    drone = SingleDrone()
    drone.data.qpos[3:] = (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2))
    track = drone.fly(8, (0, 0))
    assert drone.data.qpos[6] == pytest.approx(0, abs=1e-3)
    assert abs(track.position[:, 2] - 20).max() < 1e-6


@pytest.mark.parametrize("name", AIRFRAMES)
def test_wind_is_countered(name):
    mass = load_airframe(name).mass
    track = SingleDrone(name).fly(60, (3, 0), force=(0, 2 * mass, -0.5 * mass))
    assert track.velocity[-1] == pytest.approx((3, 0, 0), abs=1e-3)
    assert track.disturbance[-1] == pytest.approx((0, 2, -0.5), abs=1e-3)
    assert track.position[-1, 2] == pytest.approx(20, abs=1e-3)


def test_observer_does_not_wind_up():
    """Commands that tilt and thrust cannot follow leave no trace in what the observer takes for wind."""
    tilted = SingleDrone(tilt_max=math.radians(20)).fly(20, (30, 0))
    assert tilted.acceleration.max() < 9.81 * math.tan(math.radians(20)) * 1.05
    assert abs(tilted.disturbance).max() < 1e-3

    low = SingleDrone(altitude=100.0)
    low.data.qpos[2] = 20
    climbing = low.fly(40, (6, 6))
    assert climbing.position[:, 2].max() < 100.1
    assert climbing.position[-1, 2] == pytest.approx(100, abs=0.01)
    assert abs(climbing.disturbance).max() < 1e-3

    # Pushed down by more than the rotors can lift, for 2 s: once free it comes back without going far beyond.
    drone = SingleDrone(altitude=500.0)
    mass = drone.airframe.mass
    drone.fly(2, (0, 0), force=(0, 0, -1.2 * 9.81 * mass))
    assert drone.data.qpos[2] < 495
    assert drone.observer[5] >= -drone.gains.disturbance_max
    freed = drone.fly(40, (0, 0))
    assert freed.position[:, 2].max() < 503
    assert freed.position[-1, 2] == pytest.approx(500, abs=0.1)


def manoeuvre(t):
    """A circle, then full speed the other way."""
    return (6 * math.cos(0.5 * t), 6 * math.sin(0.5 * t)) if t < 5 else (-6.0, 0.0)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_mujocos_own_actuators_move_it_the_same(name):
    own = SingleDrone(name, own_actuators=True).tilted(0.9).fly(10, manoeuvre)
    flock = SingleDrone(name).tilted(0.9).fly(10, manoeuvre)
    assert own.position == pytest.approx(flock.position, abs=1e-6)
    assert own.velocity == pytest.approx(flock.velocity, abs=1e-6)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_half_the_step_changes_the_flight_by_less_than_a_hundredth(name):
    coarse = SingleDrone(name).fly(10, manoeuvre)
    fine = SingleDrone(name, step=0.0025).fly(10, manoeuvre)
    way = np.linalg.norm(np.diff(coarse.position, axis=0), axis=1).sum()
    assert np.linalg.norm(coarse.position - fine.position[::2], axis=1).max() < 0.01 * way
    assert np.linalg.norm(coarse.velocity - fine.velocity[::2], axis=1).max() < 0.01 * 6
