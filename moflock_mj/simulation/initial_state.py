"""Where the drones are when a flight begins."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.state import TrueState

_DENSEST = math.pi / math.sqrt(12)
"""Share of the plane that equal circles can cover (Thue 1892)."""

_TRIES = 20_000
"""Random places that may be refused in a row before a start counts as impossible."""


def make_initial_state(scenario: Scenario, rng: np.random.Generator) -> TrueState:
    """Place the drones.

    Raises:
        ScenarioError: more drones than the spacing can place.
    """
    drones = scenario.drones
    world = TrueState.at_rest(drones)
    world.position[2] = scenario.altitude
    if scenario.start == "moflock":
        world.position[:2] = scenario.arena.sample(rng, drones).T
        world.velocity[:2] = rng.uniform(-scenario.start_speed, scenario.start_speed, 2)[:, None]
    else:
        world.position[:2] = _spaced(scenario, rng).T
    return world


def grid(drones: int, spacing: float) -> NDArray[np.float64]:
    """(N, 2), m: places in a square grid about the origin."""
    columns = math.ceil(math.sqrt(drones))
    rows = math.ceil(drones / columns)
    numbers = np.arange(drones)
    x = (numbers % columns - (columns - 1) / 2) * spacing
    y = (numbers // columns - (rows - 1) / 2) * spacing
    return np.stack((x, y), axis=1)


def _spaced(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    """Uniform places in the arena, each at least start_spacing from the others: (N, 2), m."""
    drones, arena, spacing = scenario.drones, scenario.arena, scenario.start_spacing
    refusal = ScenarioError(f"drones: {drones} do not fit into the {arena.title} with start_spacing {spacing:g} m")
    if drones > 1 and drones * math.pi * (spacing / 2) ** 2 > _DENSEST * arena.inset(-spacing / 2).area():
        raise refusal
    places = np.empty((drones, 2))
    for i in range(drones):
        for _ in range(_TRIES):
            (place,) = arena.sample(rng, 1)
            if not np.any(np.sum((places[:i] - place) ** 2, axis=1) < spacing**2):
                places[i] = place
                break
        else:
            raise refusal
    return places
