"""The round arena: its wall as a slow twin finds it, and closed forms."""

import math

import numpy as np
import pytest

from controllers.compiling import entry_kernel
from moflock_mj import Scenario, fly, load_point
from moflock_mj.world.circle import Circle, locate_round_wall

locate = entry_kernel(locate_round_wall)


def test_the_wall_is_that_of_its_slow_twin():
    arena, rng = Circle(80.0), np.random.default_rng(3)
    position = rng.uniform(-120, 120, (2, 50))
    position[:, 0] = 0.0
    distance, normal = np.empty((1, 50)), np.empty((1, 2, 50))
    locate(arena, position, distance, normal)
    for i, (x, y) in enumerate(position.T):
        away = math.hypot(x, y)
        assert distance[0, i] == pytest.approx(80.0 - away, abs=1e-12)
        expected = (-x / away, -y / away) if away else (1.0, 0.0)
        assert normal[0, :, i] == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(arena.distance_outside(position.T), -distance[0], atol=1e-12)


def test_places_are_uniform():
    places = Circle(10.0).sample(np.random.default_rng(1), 20_000)
    radius = np.linalg.norm(places, axis=1)
    assert radius.max() <= 10.0
    # Of a uniform disc a quarter lies within half of the radius, and the mean radius is 2 R / 3.
    assert np.mean(radius < 5.0) == pytest.approx(0.25, abs=0.01)
    assert radius.mean() == pytest.approx(20 / 3, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_a_flock_stays_in_it(dynamics):
    scenario = Scenario(drones=10, duration=60.0, arena=Circle(150.0))
    flight = fly(load_point("knee"), scenario=scenario, dynamics=dynamics, seed=4)
    assert flight.motion.outside_max < 10.0
    assert np.linalg.norm(flight.samples.position[..., :2], axis=-1).max() > 100.0


def test_it_is_read_from_a_table():
    scenario = Scenario.from_toml('[arena]\nshape = "circle"\nradius = 120\n')
    assert scenario.arena == Circle(120.0)
    assert scenario.arena_side is None
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert Scenario.from_dict(scenario.to_dict()) == scenario
