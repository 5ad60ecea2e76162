"""Wind: gusts against the closed forms of the Dryden model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.effects.wind import FOOT, GUST_DRAWS, blow, dryden_scales, make_wind
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario import effect_configs
from tests.support.compiled import compiled
from tests.support.twins import dryden_correlation, next_gusts

PERIOD = 0.5
BLOW = compiled(blow, 3)


def gusty(drones, **changes):
    section = effect_configs.WindConfig(**({"speed": 10.0, "direction": 0.3, "turbulence": "moderate"} | changes))
    scenario = Scenario(drones=drones, wind=section)
    return make_wind(scenario, PERIOD, np.random.default_rng(1))


def test_scales_at_the_ends_of_the_low_altitude_model():
    """At 1000 ft the scales are equal, 1000 ft and a tenth of W20; at 20 ft as a table of the formulas has them."""
    assert dryden_scales(1000 * FOOT, 20.0) == pytest.approx((1000 * FOOT, 1000 * FOOT, 2.0, 2.0))
    length_u, length_w, sigma_u, sigma_w = dryden_scales(20 * FOOT, 10.0)
    assert (length_w / FOOT, sigma_w) == pytest.approx((20.0, 1.0))
    assert length_u / FOOT == pytest.approx(20 / 0.19346**1.2)
    assert sigma_u == pytest.approx(1 / 0.19346**0.4)


def test_named_turbulence_is_that_of_15_30_and_45_knots():
    winds = [effect_configs.WindConfig(turbulence=name).gust_wind for name in ("none", "light", "moderate", "severe")]
    assert winds == pytest.approx([0, 7.717, 15.433, 23.15], abs=1e-3)
    assert effect_configs.WindConfig(w20=9.0).gust_wind == 9.0


def test_gusts_agree_with_their_slow_twin():
    wind = gusty(4)
    rng = np.random.default_rng(2)
    slow = wind.filters.T.copy()
    for _ in range(20):
        velocity, draws = rng.normal(scale=8, size=(3, 4)), rng.standard_normal((1, GUST_DRAWS, 4))
        expected = next_gusts(slow, wind, velocity.T, draws[0].T)
        BLOW(wind, velocity, draws)
        np.testing.assert_allclose(wind.velocity.T, expected, atol=1e-9)


def test_variance_and_correlation_are_those_of_dryden():
    """Drones at rest in the mean wind would see its speed; these move with the air, so that T is L over 1 m/s."""
    drones, lags = 4000, 12
    wind = gusty(drones)
    rng = np.random.default_rng(3)
    series = [wind.velocity.copy()]
    for _ in range(lags):
        BLOW(wind, wind.velocity.copy(), rng.standard_normal((1, GUST_DRAWS, drones)))
        series.append(wind.velocity.copy())
    series = np.array(series) - np.append(wind.speed * wind.along, 0)[:, None]
    across = np.array([-wind.along[1], wind.along[0]])
    gusts = [(series[:, :2].swapaxes(1, 2) @ wind.along, wind.sigma_u, wind.length_u, False)]
    gusts += [(series[:, :2].swapaxes(1, 2) @ across, wind.sigma_u, wind.length_u, True)]
    gusts += [(series[:, 2], wind.sigma_w, wind.length_w, True)]
    for gust, sigma, length, lateral in gusts:
        assert gust.var(axis=1) == pytest.approx(sigma**2, rel=0.1)
        for lag in (2, lags):
            found = np.mean(gust[0] * gust[lag]) / sigma**2
            assert found == pytest.approx(dryden_correlation(lateral, lag * PERIOD, length), abs=0.06)


def test_an_airspeed_shortens_the_time_by_as_much():
    """One period at 12 m/s is twelve at 1 m/s, in the gusts' mean."""
    waiting, moving = gusty(2), gusty(2)
    calm = np.zeros((1, GUST_DRAWS, 2))
    BLOW(moving, moving.velocity + np.array([[0], [0], [12.0]]), calm)
    for _ in range(12):
        BLOW(waiting, waiting.velocity.copy(), calm)
    np.testing.assert_allclose(moving.filters, waiting.filters, rtol=1e-9)


def test_without_turbulence_the_wind_is_steady():
    wind = gusty(3, turbulence="none")
    for _ in range(5):
        BLOW(wind, np.zeros((3, 3)), np.random.default_rng(4).standard_normal((1, GUST_DRAWS, 3)))
    mean = 10 * np.array([math.cos(0.3), math.sin(0.3), 0])
    np.testing.assert_allclose(wind.velocity, np.repeat(mean[:, None], 3, axis=1), atol=1e-12)


def test_gusts_above_their_model_are_refused():
    high = Scenario(altitude=400.0, wind=effect_configs.WindConfig(turbulence="light"))
    with pytest.raises(ScenarioError, match=r"altitude: 400 m.*at most 304\.8 m"):
        make_wind(high, PERIOD, np.random.default_rng(1))
