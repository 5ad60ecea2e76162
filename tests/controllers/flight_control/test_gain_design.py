"""The design of the gains: margins, what is refused, and the loops as the computer really samples them."""

from __future__ import annotations

import dataclasses
import math

import control
import numpy as np
import pytest

from controllers.flight_control.gain_design import Bandwidths, GainDesignError, design_gains
from moflock_mj.dynamics.airframe_models import airframe_names, load_airframe

STEP = 0.005


@pytest.mark.parametrize("name", airframe_names())
@pytest.mark.parametrize("step", [0.002, STEP, 0.01])
def test_every_loop_has_its_margins(name, step):
    for loop in design_gains(load_airframe(name), step=step).margins:
        assert loop.gain_margin >= 6, loop
        assert loop.phase_margin >= 45, loop
        assert loop.delay_margin > 3 * step, loop


def test_loops_cross_where_they_are_asked_to():
    crossover = {m.loop: m.crossover for m in design_gains(load_airframe("x500"), step=STEP).margins}
    for loop, field in (
        ("roll rate", "roll_pitch_rate"),
        ("tilt", "tilt"),
        ("yaw rate", "yaw_rate"),
        ("climb", "climb"),
    ):
        assert crossover[loop] == pytest.approx(getattr(Bandwidths(), field), rel=1e-6)
    assert crossover["velocity"] == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize("name", airframe_names())
def test_margins_are_those_of_the_sampled_loops(name):
    """Exact in z: a command sets thrust by the next step, that acts for one step, the angle moves with the new rate."""
    airframe = load_airframe(name)
    design = design_gains(airframe, step=STEP)
    gains, reported = design.gains, {m.loop: m for m in design.margins}
    omega = np.geomspace(1, 300, 4000)
    z = np.exp(1j * omega * STEP)
    lag = gains.rotor_blend / (z - (1 - gains.rotor_blend))
    rate = gains.rate_gain_x / airframe.inertia[0] * lag * STEP / (z - 1)
    tilt = gains.tilt_gain * rate / (1 + rate) * STEP * z / (z - 1)
    for loop, sampled in (("roll rate", rate), ("tilt", tilt)):
        phase = np.degrees(np.unwrap(np.angle(sampled)))
        gain_margin, phase_margin, _, crossover = control.margin((abs(sampled), phase, omega))
        assert crossover == pytest.approx(reported[loop].crossover, rel=0.02)
        assert phase_margin == pytest.approx(reported[loop].phase_margin, abs=2.5)
        assert 20 * math.log10(gain_margin) == pytest.approx(reported[loop].gain_margin, abs=1.5)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"a_max": 13.0}, r"a_max: 13 m/s\^2 is too much for the airframe x500.*at most 12.5 m/s\^2"),
        ({"tau": 0.0}, "tau: 0 "),
        ({"tau": 0.05}, "the velocity loop's gain margin is .* dB.*at least 6 dB"),
        ({"tilt_max": 1.6}, "tilt_max: 1.6 rad.*0 and pi/2"),
        ({"step": 0.02}, "the roll rate loop's phase margin is .* degrees.*at least 45 degrees"),
        ({"step": math.nan}, "step: nan"),
        ({"bandwidths": Bandwidths(tilt=40.0)}, "the tilt loop's"),
    ],
)
def test_refusals_name_field_value_and_limit(settings, message):
    with pytest.raises(GainDesignError, match=message):
        design_gains(load_airframe("x500"), **{"step": STEP, **settings})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"thrust_max": 5.0}, "thrust to weight of 1.02.*1.11"),
        ({"yaw_ratio": (0.0,) * 4}, "do not control"),
        ({"rotor_positions": ((0.2, -0.1), (-0.1, 0.1), (0.1, 0.1), (-0.1, -0.1))}, "equal thrusts exert a torque"),
        ({"rotor_lag": 0.2}, "margin"),
    ],
)
def test_airframes_that_cannot_be_flown_are_refused(change, message):
    airframe = dataclasses.replace(load_airframe("x500"), **change)
    with pytest.raises(GainDesignError, match=message):
        design_gains(airframe, step=STEP)


def test_gains_are_finite():
    assert all(np.isfinite(value).all() for value in design_gains(load_airframe("crazyflie"), step=STEP).gains)
