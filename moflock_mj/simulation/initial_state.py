"""Initial state of the drones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.state import TrueState

_MAX_DENSITY = math.pi / math.sqrt(12)
"""Largest fraction of the plane that equal circles can cover (Thue 1892)."""

_MAX_TRIES = 20_000
"""Number of consecutive rejected random positions after which a start is impossible."""


def make_initial_state(scenario: Scenario, rng: np.random.Generator) -> TrueState:
    """Create the initial state of a scenario.

    Raises:
        ScenarioError: the arena is too small for the drones at this spacing.
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
    """Positions in a square grid about the origin: (N, 2), m."""
    columns = math.ceil(math.sqrt(drones))
    rows = math.ceil(drones / columns)
    numbers = np.arange(drones)
    x = (numbers % columns - (columns - 1) / 2) * spacing
    y = (numbers // columns - (rows - 1) / 2) * spacing
    return np.stack((x, y), axis=1)


def _spaced(scenario: Scenario, rng: np.random.Generator) -> NDArray[np.float64]:
    """Uniform random positions in the arena, at least start_spacing apart: (N, 2), m."""
    drones, arena, spacing = scenario.drones, scenario.arena, scenario.start_spacing
    refusal = ScenarioError(f"drones: {drones} do not fit into the {arena.title} with start_spacing {spacing:g} m")
    if drones > 1 and drones * math.pi * (spacing / 2) ** 2 > _MAX_DENSITY * arena.inset(-spacing / 2).area():
        raise refusal
    positions = np.empty((drones, 2))
    for i in range(drones):
        for _ in range(_MAX_TRIES):
            (position,) = arena.sample(rng, 1)
            if not np.any(np.sum((positions[:i] - position) ** 2, axis=1) < spacing**2):
                positions[i] = position
                break
        else:
            raise refusal
    return positions
