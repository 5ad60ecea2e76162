"""Attitude and rate loop: against rotation vectors and matrices, and cases with a known answer."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controllers.flight_control.attitude import heading_rate, rate_torque, tilt_rates
from controllers.geometry import body_axes


def test_body_axes_are_mujocos_rotation_matrix():
    for seed in range(20):
        quaternion = np.random.default_rng(seed).normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, quaternion)
        assert body_axes(*quaternion) == pytest.approx(matrix, abs=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, math.pi / 2, 3.0])
@pytest.mark.parametrize("length", [1.0, 11.5])
def test_tilt_rates_turn_about_the_axis_from_thrust_to_target(angle, length):
    for direction in np.linspace(0, 2 * np.pi, 7):
        n = np.array([math.sin(angle) * math.cos(direction), math.sin(angle) * math.sin(direction), math.cos(angle)])
        axis = np.cross((0, 0, 1), n)
        expected = axis / (math.sin(angle) or 1.0) * 2 * math.sin(angle / 2) * 5.0
        assert (*tilt_rates(*(length * n), 5.0, 100.0), 0) == pytest.approx(expected, abs=1e-11)


def test_tilt_rates_are_bounded_and_finite_upside_down():
    assert np.hypot(*tilt_rates(0.6, 0.0, -0.8, 9.0, 6.0)) == pytest.approx(6.0)
    assert tilt_rates(0.0, 0.0, -1.0, 9.0, 6.0) == (0.0, 0.0)


def test_heading_rate_turns_back_to_the_worlds_x_axis():
    for yaw in np.linspace(-3.1, 3.1, 25):
        # The world's x axis, seen from a body that has turned left by `yaw`, has turned right.
        rate = heading_rate(math.cos(yaw), -math.sin(yaw), 2.0)
        assert rate * yaw <= 0
        assert abs(rate) == pytest.approx(2.0 if abs(yaw) > math.pi / 2 else 2.0 * abs(math.sin(yaw)))


def test_rate_torque_is_the_gain_and_the_gyroscopic_term():
    rng = np.random.default_rng(3)
    wanted, w, gain, inertia = rng.normal(size=(4, 3))
    slow = gain * (wanted - w) + np.cross(w, inertia * w)
    assert rate_torque(*wanted, *w, *gain, *inertia) == pytest.approx(slow, abs=1e-12)
