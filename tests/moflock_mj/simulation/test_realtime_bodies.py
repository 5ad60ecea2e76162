"""Bodies in real time: they stand, rise, sink and stop their rotors."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.airframe import ROTORS
from moflock_mj import Scenario
from moflock_mj.dynamics.airframe_models import airframe_names
from moflock_mj.scenario.effect_configs import BatteryConfig, DownwashConfig, ImuConfig, WindConfig
from moflock_mj.simulation.random_numbers import RandomStreams
from moflock_mj.simulation.realtime_bodies import RealtimeBodies
from moflock_mj.world.constants import GRAVITY

PLACES = np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])


def bodies_of(airframe="x500", **scenario):
    return RealtimeBodies(Scenario(airframe=airframe, sigma_inner=0.0, **scenario), PLACES, RandomStreams.of(1))


@pytest.mark.parametrize("airframe", airframe_names())
def test_bodies_stand_still_whatever_the_noise(airframe):
    bodies = bodies_of(airframe)
    bodies.advance(400)
    np.testing.assert_allclose(bodies.qpos[:, :2], PLACES, atol=1e-6)
    np.testing.assert_allclose(bodies.qpos[:, 2], bodies.ground, atol=1e-3)
    assert np.abs(bodies.qvel).max() < 1e-3


def test_bodies_fly_in_wind_on_what_they_estimate():
    windy = Scenario(
        sigma_inner=0.0,
        wind=WindConfig(speed=5.0, turbulence="light"),
        imu=ImuConfig(),
        battery=BatteryConfig(),
        downwash=DownwashConfig(),
    )
    bodies = RealtimeBodies(windy, PLACES, RandomStreams.of(1))
    bodies.stopped[:] = 0
    for tick in range(1500):
        bodies.altitude[:] = min(bodies.ground + 1.5 * tick * 0.02, 5.0)
        bodies.advance(4)
    np.testing.assert_allclose(bodies.qpos[:, 2], 5.0, atol=0.7)
    assert np.linalg.norm(bodies.qvel[:, :2], axis=1).max() < 1.0
    assert np.linalg.norm(bodies.qpos[:, :2] - PLACES, axis=1).max() < 15.0


def test_only_whole_cycles_are_flown():
    with pytest.raises(ValueError, match="steps: 6 must be a multiple of the interval, 4"):
        bodies_of().advance(6)


@pytest.mark.parametrize("airframe", airframe_names())
def test_each_body_has_a_height_of_its_own(airframe):
    bodies = bodies_of(airframe, sigma_outer=0.0)
    heights = np.array([bodies.ground, 2.0, 4.0])
    bodies.stopped[1:] = 0
    for tick in range(600):
        bodies.altitude[:] = np.minimum(bodies.ground + 1.5 * tick * 0.02, heights)
        bodies.advance(4)
    np.testing.assert_allclose(bodies.qpos[:, 2], heights, atol=0.02)
    np.testing.assert_allclose(bodies.qpos[:, :2], PLACES, atol=0.01)


def test_a_takeoff_does_not_sag_after_a_long_stand():
    """The observer must not have taken the ground for an updraught."""
    bodies = bodies_of(sigma_outer=0.0)
    bodies.advance(2000)
    bodies.stopped[:] = 0
    heights = []
    for tick in range(400):
        bodies.altitude[:] = min(bodies.ground + 1.5 * tick * 0.02, 5.0)
        bodies.advance(4)
        heights.append(bodies.qpos[0, 2])
    assert np.diff(heights).min() > -1e-3
    assert heights[-1] == pytest.approx(5.0, abs=0.05)


def test_stopped_rotors_let_a_body_fall():
    bodies = bodies_of(sigma_outer=0.0)
    bodies.qpos[:, 2] = 3.0
    bodies.advance(100)
    np.testing.assert_allclose(bodies.qpos[:, 2], 3.0 - 9.81 * 0.5**2 / 2, atol=0.02)


def test_gps_errors_walk_once_in_each_fix_and_stay_small():
    """Their deviation in the long run is that of the scenario: sigma_inner of the velocity, damped."""
    bodies = RealtimeBodies(Scenario(), PLACES, RandomStreams.of(1))
    errors = []
    for _ in range(1000):
        bodies.advance(40)
        errors.append(bodies.velocity_error.copy())
        before = bodies.velocity_error.copy()
        bodies.advance(36)
        np.testing.assert_array_equal(bodies.velocity_error, before)
        bodies.advance(4)
    assert np.var(errors) == pytest.approx(0.005, rel=0.4)
    np.testing.assert_allclose(bodies.qpos[:, :2], PLACES, atol=1e-6)


def test_the_outer_noise_comes_with_height():
    """Free bodies that weigh nothing: deviation sqrt(2 sigma_outer t) of the velocity high up, half of it half way."""
    share = np.repeat([0.0, 0.5, 1.0], 60)
    places = np.stack((5.0 * np.arange(share.size), np.zeros(share.size)), axis=1)
    bodies = RealtimeBodies(Scenario(sigma_outer=0.2), places, RandomStreams.of(1), controlled=False)
    bodies.qpos[:, 2] = bodies.ground + 5.0 * share + 3.0 * (share == 1)
    bodies.thrust_command[:] = bodies.airframe.mass * GRAVITY / ROTORS
    bodies.advance(100)
    flown = 100 * bodies.step
    for part, factor in ((share == 0.5, 0.5), (share == 1.0, 1.0)):
        deviation = bodies.qvel[part, :2].std()
        assert deviation == pytest.approx(factor * np.sqrt(2 * 0.2 * flown), rel=0.25)
    assert np.abs(bodies.qvel[share == 0.0, :2]).max() < 1e-3
