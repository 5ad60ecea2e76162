"""Target tracking: the sine of synthetic distances, and flights around a target."""

from __future__ import annotations

import numpy as np
import pytest

from moflock_mj import MoflockError, Scenario, fly, load_point
from moflock_mj.analysis.target_tracking import Sine, fit_sine, target_distance, track_target

SHORT = Scenario(drones=6, arena_side=200.0, duration=90.0, step=0.1)


@pytest.mark.parametrize("phase", [0.0, 1.0, 3.0, 5.5])
@pytest.mark.parametrize("omega", [0.02, 0.071, 0.5])
def test_recovers_a_sine_from_noise(omega, phase):
    t = np.arange(100, 600, 0.1)
    true = Sine(25.0, omega, phase, 60.0)
    found = fit_sine(t, true.at(t) + np.random.default_rng(0).normal(0, 2, t.size))
    assert found.amplitude == pytest.approx(25, abs=0.3)
    assert found.omega == pytest.approx(omega, rel=0.01)
    assert found.offset == pytest.approx(60, abs=0.3)
    assert np.abs(found.at(t) - true.at(t)).max() < 1


def test_a_constant_distance_has_no_sine():
    found = fit_sine(np.arange(0, 50, 0.1), np.full(500, 7.0))
    assert (found.amplitude, found.offset) == (0, 7)


def test_distance_is_that_of_the_centre_of_mass():
    position = np.array([[[0, 0, 5], [6, 8, 5]], [[1, 1, 5], [1, 1, 5.0]]])
    np.testing.assert_allclose(target_distance(position, (0.0, 0.0)), [5, np.sqrt(2)])


@pytest.mark.slow
def test_a_target_holds_the_flock():
    target = (40.0, -30.0)
    held = track_target(load_point("B"), target=target, scenario=SHORT, seed=3, transient=40)
    free = fly(load_point("B"), scenario=SHORT, dynamics="point_mass", seed=3)
    steady = held.t >= 40
    assert held.distance[steady].mean() < target_distance(free.samples.position, target)[steady].mean()
    assert held.F_target == pytest.approx(held.sine.omega / held.sine.amplitude)
    assert held.t.shape == held.distance.shape == (901,)


def test_the_same_seed_gives_the_same_flight():
    first, second = (track_target(load_point("A"), scenario=SHORT, seed=5, transient=10) for _ in range(2))
    np.testing.assert_array_equal(first.distance, second.distance)


@pytest.mark.slow
def test_rigid_bodies_track_too():
    result = track_target(load_point("A"), scenario=SHORT.replace(duration=12.0, step=None), dynamics="rigid_body",
                          transient=2.0)  # fmt: skip
    assert result.flight.body is not None
    assert np.isfinite(result.distance).all()


def test_what_cannot_be_tracked_is_refused():
    with pytest.raises(MoflockError, match="duration: 90 s"):
        track_target(load_point("A"), scenario=SHORT)
    with pytest.raises(MoflockError, match="target_y"):
        track_target(load_point("A"), target=(0.0, float("nan")), scenario=SHORT, transient=10)
