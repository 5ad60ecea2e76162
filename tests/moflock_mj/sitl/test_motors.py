"""Which motor turns which rotor, and how much it pushes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from controllers.flight_control.mixer import wrench_matrix
from moflock_mj.dynamics.airframe_models import airframe_names, load_airframe
from moflock_mj.errors import AirframeError
from moflock_mj.sitl.motors import Motors, outputs_of_pwm, rotor_order


@pytest.mark.parametrize(("airframe", "order"), [("x500", [0, 1, 2, 3]), ("crazyflie", [0, 2, 3, 1])])
def test_motors_are_found_by_where_they_are(airframe, order):
    assert rotor_order(load_airframe(airframe)).tolist() == order


@pytest.mark.parametrize("airframe", airframe_names())
@pytest.mark.parametrize(
    ("stronger", "axis"),
    [
        ((1, 2), 3),  # front right, rear left: their drag turns the body clockwise, our torque about z is negative
        ((2, 3), 1),  # rear left, front left: rolls right
        ((1, 3), 2),  # front: pitches up, our torque about y is negative
    ],
)
def test_autopilots_pairs_turn_the_body_as_they_expect(airframe, stronger, axis):
    vehicle = load_airframe(airframe)
    outputs, command = np.full((1, 4), 0.4), np.zeros((1, 4))
    outputs[0, [motor - 1 for motor in stronger]] = 0.6
    Motors(vehicle, 0.0).command(outputs, command)
    total, *torque = wrench_matrix(vehicle) @ command[0]
    assert total == pytest.approx(2.0 * vehicle.thrust_max)
    expected = {1: 1.0, 2: -1.0, 3: -1.0}[axis]
    assert np.sign(torque[axis - 1]) == expected
    others = [abs(t) for k, t in enumerate(torque, 1) if k != axis]
    assert max(others) < 1e-9


def test_a_rotor_that_turns_the_other_way_is_refused():
    x500 = load_airframe("x500")
    turned = dataclasses.replace(x500, yaw_ratio=tuple(-ratio for ratio in x500.yaw_ratio))
    with pytest.raises(AirframeError, match=r"rotor front right is 0\.016: it must turn anticlock"):
        rotor_order(turned)


def test_a_plus_is_refused():
    x500 = load_airframe("x500")
    plus = dataclasses.replace(x500, rotor_positions=((0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25)))
    with pytest.raises(AirframeError, match="0 rotors front right: a quad X must have 1"):
        rotor_order(plus)


@pytest.mark.parametrize(("curve", "share"), [(0.0, 0.5), (1.0, 0.25), (0.65, 0.35 * 0.5 + 0.65 * 0.25)])
def test_the_curve_of_thrust(curve, share):
    x500 = load_airframe("x500")
    command = np.zeros((1, 4))
    Motors(x500, curve).command(np.array([[0.0, 1.0, 0.5, 0.5]]), command)
    np.testing.assert_allclose(command[0] / x500.thrust_max, [0.0, 1.0, share, share])


def test_pulses():
    pwm = np.array([0.0, 900, 1000, 1250, 2000, 2200])
    np.testing.assert_allclose(outputs_of_pwm(pwm), [0, 0, 0, 0.25, 1, 1])
