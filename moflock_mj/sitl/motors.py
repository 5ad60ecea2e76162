"""From an autopilot's motor outputs to the thrust of our rotors: order, spin, curve.

ArduPilot and PX4 number the motors of a quad X alike:

| motor | where | turns, seen from above |
| --- | --- | --- |
| 1 | front right | anticlockwise |
| 2 | rear left | anticlockwise |
| 3 | front left | clockwise |
| 4 | rear right | clockwise |

(ArduPilot: Connect ESCs and Motors, QUAD X. PX4: Airframe Reference, Quadrotor x.) Which of our rotors that is goes by
where it sits and how it turns, whatever its number in the airframe's file.

A motor at the output u, from 0 to 1, pushes with the share (1 - e) u + e u^2 of its largest thrust. The exponent e is
what the autopilot itself supposes where nobody has measured: with it the thrust that it wants is the thrust it gets.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import Airframe
from moflock_mj.errors import AirframeError

CURVE = {"ardupilot": 0.65, "px4": 0.0}
"""The exponent e by autopilot: defaults of ArduPilot's MOT_THST_EXPO and PX4's THR_MDL_FAC."""

PWM_LOW, PWM_HIGH = 1000, 2000
"""us: a motor stands at the lower one, and under it, and is at full thrust at the higher one."""

_CLOCKWISE, _ANTICLOCKWISE = 1, -1
_QUAD_X = (
    ("front right", 1, -1, _ANTICLOCKWISE),
    ("rear left", -1, 1, _ANTICLOCKWISE),
    ("front left", 1, 1, _CLOCKWISE),
    ("rear right", -1, -1, _CLOCKWISE),
)
"""Name, signs of x (forward) and y (left), and spin, of motors 1 to 4."""


def rotor_order(airframe: Airframe) -> NDArray[np.intp]:
    """(4,), which of our rotors motors 1 to 4 turn.

    Raises:
        AirframeError: the airframe is no quad X, or a rotor turns the other way.
    """
    order = []
    for name, forward, left, spin in _QUAD_X:
        here = [
            rotor
            for rotor, (x, y) in enumerate(airframe.rotor_positions)
            if math.copysign(1, x) == forward and math.copysign(1, y) == left and x and y
        ]
        if len(here) != 1:
            raise AirframeError(f"airframe {airframe.name}: it has {len(here)} rotors {name}: a quad X has 1")
        ratio = airframe.yaw_ratio[here[0]]
        if ratio * spin <= 0:
            turn = "anticlockwise" if spin == _ANTICLOCKWISE else "clockwise"
            raise AirframeError(
                f"airframe {airframe.name}: yaw ratio of the rotor {name} is {ratio:g}: autopilots have it turn {turn}"
            )
        order.append(here[0])
    return np.array(order)


def outputs_of_pwm(pwm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outputs from 0 to 1 of pulse widths, us; 0 for a motor without pulses."""
    return np.clip((pwm - PWM_LOW) / (PWM_HIGH - PWM_LOW), 0.0, 1.0)


class Motors:
    """The motors of a flock.

    Args:
        airframe: of all vehicles.
        curve: the exponent e, from 0 to 1.

    Raises:
        AirframeError: the airframe is not what autopilots fly as a quad X.
    """

    def __init__(self, airframe: Airframe, curve: float) -> None:
        self._order = rotor_order(airframe)
        self._thrust_max, self._curve = airframe.thrust_max, curve

    def command(self, outputs: NDArray[np.float64], thrust_command: NDArray[np.float64]) -> None:
        """Write the thrust that each of our rotors is to have.

        Args:
            outputs: (N, 4), from 0 to 1, of motors 1 to 4.
            thrust_command: (N, 4), N; written.
        """
        share = outputs * (1 - self._curve + self._curve * outputs)
        thrust_command[:, self._order] = self._thrust_max * share
