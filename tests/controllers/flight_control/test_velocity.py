"""Velocity loop, observer and altitude hold: against slow twins and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.flight_control.altitude import altitude_acceleration, collective_thrust
from controllers.flight_control.velocity import observe_axis, velocity_acceleration
from controllers.geometry import clip_length


def test_velocity_acceleration_is_the_point_masss():
    rng = np.random.default_rng(5)
    for _ in range(50):
        desired, measured = rng.normal(scale=6, size=(2, 2))
        tau, a_max = rng.uniform(0.3, 2), rng.uniform(1, 8)
        wanted = (desired - measured) / tau
        wanted *= min(1, a_max / np.linalg.norm(wanted))
        assert velocity_acceleration(*desired, *measured, 1 / tau, a_max) == pytest.approx(wanted, abs=1e-12)


def test_clip_length_keeps_the_direction():
    assert clip_length(3.0, 4.0, 10.0) == (3.0, 4.0)
    assert clip_length(3.0, 4.0, 1.0) == pytest.approx((0.6, 0.8))
    assert clip_length(0.0, 0.0, 0.0) == (0.0, 0.0)


def test_observer_finds_a_constant_disturbance():
    """Both poles at b: the error of the estimate is d (1 + b t) exp(-b t)."""
    step, b, d = 0.001, 0.5, 1.5
    predicted, disturbance, velocity = 0.0, 0.0, 0.0
    for k in range(20_000):
        t = k * step
        assert disturbance == pytest.approx(d - d * (1 + b * t) * np.exp(-b * t), abs=2e-3)
        modelled = np.sin(t)
        predicted, disturbance = observe_axis(predicted, disturbance, velocity, modelled, 2 * b, b * b, 10.0, step)
        velocity += step * (modelled + d)


def test_observer_is_bounded():
    predicted, disturbance = 0.0, 0.0
    for k in range(10_000):
        predicted, disturbance = observe_axis(predicted, disturbance, 0.1 * k, 0.0, 0.4, 0.04, 2.0, 0.005)
    assert disturbance == 2.0


@pytest.mark.parametrize(
    ("height", "climb_rate", "expected"),
    [(20, 0, 0), (19, 0, 5 * 1.5), (20, 1, -5), (0, 0, 7), (0, 3, 0), (100, -3, 0), (19, 1.5, 0)],
)
def test_altitude_acceleration(height, climb_rate, expected):
    assert altitude_acceleration(20.0, height, climb_rate, 1.5, 5.0, 3.0, 7.0 + 1e-12) == pytest.approx(
        min(expected, 7)
    )


def test_collective_thrust_lifts_the_same_up_to_the_largest_tilt():
    floor = np.cos(0.8)
    for tilt in np.linspace(0, 0.8, 9):
        assert collective_thrust(20.0, np.cos(tilt), floor) * np.cos(tilt) == pytest.approx(20.0)
    beyond = [collective_thrust(20.0, np.cos(tilt), floor) for tilt in np.linspace(0.8, np.pi, 40)]
    assert (np.diff(beyond) <= 0).all()
    assert beyond[-1] == 0
