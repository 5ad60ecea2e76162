"""The mixer: what it shares out comes back as the same wrench, and what it gives up first."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.flight_control.mixer import mix, wrench, wrench_matrix
from moflock_mj.dynamics.airframe_models import airframe_names, load_airframe

AIRFRAMES = {name: load_airframe(name) for name in airframe_names()}


def mixed(airframe, total, *torques):
    command = np.empty(4)
    mixer = np.linalg.inv(wrench_matrix(airframe))
    mix(np.ascontiguousarray(mixer), airframe.thrust_max, float(total), *map(float, torques), command)
    return command


def slow_mix(airframe, total, torque_x, torque_y, torque_z):
    """Priorities one by one: roll and pitch, then collective, then yaw."""
    mixer, top = np.linalg.inv(wrench_matrix(airframe)), airframe.thrust_max
    tilting = mixer[:, 1] * torque_x + mixer[:, 2] * torque_y
    span = np.ptp(tilting)
    if span > top:
        tilting = tilting * top / span
    base = np.clip(total / 4, -tilting.min(), top - tilting.max()) + tilting
    turning = mixer[:, 3] * torque_z
    room = np.where(turning > 0, top - base, base)
    shares = [r / abs(t) for r, t in zip(room, turning, strict=True) if abs(t) > 1e-200]
    return base + turning * np.clip(min(shares, default=1.0), 0, 1)


wanted = st.tuples(
    st.sampled_from(sorted(AIRFRAMES)),
    st.floats(-1, 6),  # total, in largest thrusts of one rotor
    *[st.floats(-3, 3)] * 3,  # torques, in largest thrusts times 0.1 m (roll, pitch) or the yaw ratio
)


def scaled(name, total, x, y, z):
    airframe = AIRFRAMES[name]
    f, ratio = airframe.thrust_max, abs(airframe.yaw_ratio[0])
    arm = abs(airframe.rotor_positions[0][0])
    return airframe, total * f, x * f * arm, y * f * arm, z * f * ratio


@given(wanted)
@settings(max_examples=300, deadline=None)
def test_agrees_with_its_slow_twin_within_the_rotors_range(case):
    airframe, *request = scaled(*case)
    command = mixed(airframe, *request)
    assert command == pytest.approx(slow_mix(airframe, *request), abs=1e-12)
    assert (command >= 0).all()
    assert (command <= airframe.thrust_max).all()


@given(wanted)
@settings(max_examples=300, deadline=None)
def test_roll_and_pitch_are_exact_wherever_their_span_fits(case):
    airframe, total, x, y, z = scaled(*case)
    matrix = wrench_matrix(airframe)
    span = np.ptp(np.linalg.inv(matrix)[:, 1:3] @ (x, y))
    got = wrench(matrix, mixed(airframe, total, x, y, z))
    if span <= airframe.thrust_max:
        assert got[1:3] == pytest.approx((x, y), abs=1e-12)
    else:  # scaled together: the direction is kept
        assert x * got[2] == pytest.approx(y * got[1], abs=1e-12)
        assert np.dot((x, y), got[1:3]) > 0
    # Yaw is given up before anything else: with and without it, all the rest is the same.
    assert got[:3] == pytest.approx(wrench(matrix, mixed(airframe, total, x, y, 0))[:3], abs=1e-12)
    assert got[3] * z >= -1e-12
    assert abs(got[3]) <= abs(z) + 1e-12


@pytest.mark.parametrize("name", AIRFRAMES)
def test_what_fits_comes_back_exactly(name):
    airframe = AIRFRAMES[name]
    request = (4 * airframe.hover_thrust(), 0.1 * airframe.thrust_max * 0.03, 0.0, 0.2 * airframe.thrust_max * 0.005)
    assert wrench(wrench_matrix(airframe), mixed(airframe, *request)) == pytest.approx(request, abs=1e-12)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_signs(name):
    """Roll to the right loads the left rotors, pitch down the rear ones, yaw those whose drag turns it that way."""
    airframe = AIRFRAMES[name]
    x, y = np.array(airframe.rotor_positions).T
    small = 0.1 * airframe.thrust_max * 0.03
    hover = 4 * airframe.hover_thrust()
    assert (np.sign(mixed(airframe, hover, small, 0, 0) - hover / 4) == np.sign(y)).all()
    assert (np.sign(mixed(airframe, hover, 0, small, 0) - hover / 4) == -np.sign(x)).all()
    yaw = 0.1 * airframe.thrust_max * abs(airframe.yaw_ratio[0])
    assert (np.sign(mixed(airframe, hover, 0, 0, yaw) - hover / 4) == np.sign(airframe.yaw_ratio)).all()
