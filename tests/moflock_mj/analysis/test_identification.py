"""Identification: what a point mass with a known response is found to be, and what airframes are."""

import numpy as np
import pytest

from moflock_mj import MoflockError, Scenario
from moflock_mj.analysis.identification import identify
from moflock_mj.analysis.step_response import step_response
from moflock_mj.scenario.effect_configs import PointMassConfig


def test_a_late_point_mass_answers_as_the_delayed_equation_says():
    """V' = (c - v)(t - d) / tau from rest: nothing until d, then a line, then a parabola (method of steps)."""
    response = PointMassConfig(tau=0.8, a_max=50.0, delay=0.2)
    scenario = Scenario(point_mass=response)
    flown = step_response(scenario, np.array([[[2.0], [0.0]]]), 0.6, "point_mass")
    t, delay, tau = flown.t, response.delay, response.tau
    line = np.maximum(t - delay, 0) / tau
    parabola = np.maximum(t - 2 * delay, 0) ** 2 / (2 * tau**2)
    np.testing.assert_allclose(flown.velocity[:, 0, 0], 2.0 * (line - parabola), atol=0.01)
    np.testing.assert_array_equal(flown.velocity[:, 1], 0)


@pytest.mark.slow
@pytest.mark.parametrize("airframe", ["x500", "crazyflie"])
def test_the_calibrated_point_mass_answers_like_the_airframe(airframe):
    found = identify(Scenario(airframe=airframe))
    assert found.error_rms < 0.02
    assert found.error_rms < 0.2 * found.undelayed_rms < found.asked_rms
    assert found.response.tau == pytest.approx(1.0, abs=0.05)
    assert 0.05 < found.response.delay < 0.2
    # A lag of tau falls by 3 dB at 1 / tau, one with a delay in its loop a little later.
    assert 1.0 < found.linear.bandwidth < 1.3
    assert found.linear.error_rms < 1e-3
    assert found.step.rise_time == pytest.approx(np.log(9) * found.response.tau, rel=0.15)
    assert {loop.loop for loop in found.margins} >= {"velocity", "tilt"}


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"airframe": "boat"}, "airframe: 'boat' is unknown"), ({"a_max": 30.0}, "a_max: 30 m/s")],
)
def test_what_cannot_be_identified_is_refused(changes, words):
    with pytest.raises(MoflockError, match=words):
        identify(Scenario(**changes))
