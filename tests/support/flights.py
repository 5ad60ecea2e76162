"""Small flights."""

from __future__ import annotations

from moflock_mj import Scenario, fly, load_point

SMALL = Scenario(drones=4, duration=12.0, arena_side=100.0)


def fly_small(point="A", scenario=SMALL, **settings):
    """A flight of four point masses."""
    return fly(load_point(point), scenario=scenario, **{"dynamics": "point_mass"} | settings)
