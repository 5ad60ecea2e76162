"""Conversion of an autopilot's motor outputs to rotor thrusts: order, spin and thrust curve.

ArduPilot and PX4 number the motors of a quad X in the same way:

| motor | position | spin, seen from above |
| --- | --- | --- |
| 1 | front right | anticlockwise |
| 2 | rear left | anticlockwise |
| 3 | front left | clockwise |
| 4 | rear right | clockwise |

(ArduPilot: Connect ESCs and Motors, QUAD X. PX4: Airframe Reference, Quadrotor x.) A motor is matched to a rotor of the
airframe by position and spin, not by the order in the airframe's file.

The thrust of a motor at the output u, from 0 to 1, is the share (1 - e) u + e u^2 of its maximum. The exponent e is the
autopilot's default, so that an unconfigured autopilot gets the thrust that it requests.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import Airframe
from moflock_mj.errors import AirframeError

CURVE = {"ardupilot": 0.65, "px4": 0.0}
"""Exponent e by autopilot: the defaults of ArduPilot's MOT_THST_EXPO and PX4's THR_MDL_FAC."""

PWM_LOW, PWM_HIGH = 1000, 2000
"""Pulse widths, us, at and below which a motor is stopped, and at which it has full thrust."""

_CLOCKWISE, _ANTICLOCKWISE = 1, -1
_QUAD_X = (
    ("front right", 1, -1, _ANTICLOCKWISE),
    ("rear left", -1, 1, _ANTICLOCKWISE),
    ("front left", 1, 1, _CLOCKWISE),
    ("rear right", -1, -1, _CLOCKWISE),
)
"""Name, signs of x (forward) and y (left), and spin, of motors 1 to 4."""


def rotor_order(airframe: Airframe) -> NDArray[np.intp]:
    """Numbers of the rotors of motors 1 to 4, (4,).

    Raises:
        AirframeError: the airframe is not a quad X, or a rotor has the opposite spin.
    """
    order = []
    for name, forward, left, spin in _QUAD_X:
        here = [
            rotor
            for rotor, (x, y) in enumerate(airframe.rotor_positions)
            if math.copysign(1, x) == forward and math.copysign(1, y) == left and x and y
        ]
        if len(here) != 1:
            raise AirframeError(f"airframe {airframe.name}: {len(here)} rotors {name}: a quad X must have 1")
        ratio = airframe.yaw_ratio[here[0]]
        if ratio * spin <= 0:
            turn = "anticlockwise" if spin == _ANTICLOCKWISE else "clockwise"
            raise AirframeError(
                f"airframe {airframe.name}: yaw ratio of the rotor {name} is {ratio:g}: it must turn {turn}"
            )
        order.append(here[0])
    return np.array(order)


def outputs_of_pwm(pwm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert pulse widths, us, to outputs from 0 to 1; 0 for a motor without pulses."""
    return np.clip((pwm - PWM_LOW) / (PWM_HIGH - PWM_LOW), 0.0, 1.0)


class Motors:
    """The motors of a flock.

    Args:
        airframe: airframe of all vehicles.
        curve: exponent e, from 0 to 1.

    Raises:
        AirframeError: the airframe is not a quad X of the autopilots' convention.
    """

    def __init__(self, airframe: Airframe, curve: float) -> None:
        self._order = rotor_order(airframe)
        self._thrust_max, self._curve = airframe.thrust_max, curve

    def command(self, outputs: NDArray[np.float64], thrust_command: NDArray[np.float64]) -> None:
        """Write the commanded thrust of each rotor.

        Args:
            outputs: outputs of motors 1 to 4, (N, 4), from 0 to 1.
            thrust_command: thrusts of the rotors, (N, 4), N; written.
        """
        share = outputs * (1 - self._curve + self._curve * outputs)
        thrust_command[:, self._order] = self._thrust_max * share
