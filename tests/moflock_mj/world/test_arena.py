"""Every shape of arena agrees with itself, and all other code asks an arena by its methods alone."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import moflock_mj
from moflock_mj import Scenario
from moflock_mj.errors import ScenarioError
from moflock_mj.world.arena import SHAPES, arena_fields, arena_table, read_arena, shape_of
from moflock_mj.world.walls import locate_walls
from tests.support.compiled import compiled

ROOT = Path(moflock_mj.__file__).parent.parent
MAY_NAME_A_SHAPE = ("moflock_mj/__init__.py", "moflock_mj/scenario/scenario.py")
"""The public names, and the scenario, where `arena_side` is short for a square."""


def arena_of(shape, first, step):
    """An arena whose numbers are the first one, the first one and a step, and so on, as far as their bounds allow."""
    fields = arena_fields(shape)
    numbers = [min(max(first + step * place, field.low), field.high) for place, field in enumerate(fields)]
    return SHAPES[shape].ARENA(*numbers)


ARENAS = [arena_of(shape, *numbers) for shape in SHAPES for numbers in ((60.0, 0.0), (80.0, 30.0))]
each_arena = pytest.mark.parametrize("arena", ARENAS, ids=str)


def walls_of(arena, places):
    """Distances (W, N) and normals (W, 2, N) of the walls as seen from places (N, 2)."""
    distance = np.zeros((arena.walls, len(places)))
    normal = np.zeros((arena.walls, 2, len(places)))
    compiled(locate_walls, 4)(arena, np.ascontiguousarray(places.T), distance, normal)
    return distance, normal


def places_around(arena):
    """Places inside of the arena and about as many outside of it."""
    return np.random.default_rng(1).uniform(-1.5, 1.5, (500, 2)) * arena.extent()


@each_arena
def test_the_outline_is_anticlockwise_within_the_extent_and_encloses_the_area(arena):
    outline = arena.outline()
    assert (np.abs(outline) <= np.array(arena.extent()) * (1 + 1e-12)).all()
    x, y = outline.T
    enclosed = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2
    assert enclosed == pytest.approx(arena.area(), rel=0.02)  # a round arena's outline has corners
    np.testing.assert_allclose(arena.distance_outside(outline), 0.0, atol=1e-9)


@each_arena
def test_samples_lie_inside_and_all_over_it(arena):
    sample = arena.sample(np.random.default_rng(1), 4000)
    assert sample.shape == (4000, 2)
    assert (arena.distance_outside(sample) <= 0).all()
    assert (np.abs(sample).max(axis=0) > 0.95 * np.array(arena.extent())).all()
    smaller = arena.inset(0.1 * min(arena.extent()))
    share = np.mean(smaller.distance_outside(sample) <= 0)
    assert share == pytest.approx(smaller.area() / arena.area(), abs=0.03)


@each_arena
def test_an_inset_moves_every_wall_inwards(arena):
    smaller, larger = arena.inset(3.0), arena.inset(-3.0)
    assert type(smaller) is type(larger) is type(arena)
    assert smaller.area() < arena.area() < larger.area()
    np.testing.assert_allclose(arena.distance_outside(smaller.outline()), -3.0, atol=1e-9)
    np.testing.assert_allclose(larger.distance_outside(arena.outline()), -3.0, atol=1e-9)
    np.testing.assert_allclose(smaller.inset(-3.0), arena, rtol=1e-12)


@each_arena
def test_distances_are_those_of_the_nearest_wall(arena):
    places = places_around(arena)
    distance, _ = walls_of(arena, places)
    nearest, outside = distance.min(axis=0), arena.distance_outside(places)
    within = nearest >= 0
    assert 0.2 < within.mean() < 0.8
    np.testing.assert_allclose(outside[within], -nearest[within], atol=1e-9)
    np.testing.assert_array_equal(outside > 0, ~within)
    high = np.column_stack([places, np.full(len(places), 7.0)])
    np.testing.assert_array_equal(arena.distance_outside(high), outside)


@each_arena
def test_normals_are_unit_vectors_away_from_their_walls(arena):
    places = arena.sample(np.random.default_rng(2), 300)
    distance, normal = walls_of(arena, places)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    for wall in range(arena.walls):
        at_the_wall = places - (distance[wall] * normal[wall]).T
        np.testing.assert_allclose(walls_of(arena, at_the_wall)[0][wall], 0.0, atol=1e-9)


@each_arena
def test_a_round_arena_has_its_circle(arena):
    circle = arena.circle()
    if circle is not None:
        x, y, radius = circle
        assert (radius, radius) == pytest.approx((arena.extent()[0] - abs(x), arena.extent()[1] - abs(y)))
    assert str(arena.title)


@each_arena
def test_a_table_a_dictionary_and_toml_there_and_back(arena):
    assert read_arena(arena_table(arena)) == arena
    assert arena_table(arena)["shape"] == shape_of(arena)
    scenario = Scenario(drones=3, arena=arena)
    for again in (
        Scenario.from_toml(scenario.to_toml()),
        Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))),
    ):
        assert again == scenario
        assert type(again.arena) is type(arena)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_table_with_a_number_missing_out_of_bounds_or_too_many_is_refused(shape):
    table = arena_table(arena_of(shape, 60.0, 0.0))
    for field in arena_fields(shape):
        for value in (field.low - 1, 2 * field.high + 1, float("nan"), "wide"):
            with pytest.raises(ScenarioError, match=rf"arena\.{field.name}"):
                read_arena(table | {field.name: value})
        with pytest.raises(ScenarioError, match=rf"arena\.{field.name}"):
            read_arena({name: value for name, value in table.items() if name != field.name})
    with pytest.raises(ScenarioError, match="wings"):
        read_arena(table | {"wings": 2})


@pytest.mark.parametrize("table", [{"shape": "moon"}, {}, 3])
def test_a_table_of_no_shape_is_refused(table):
    with pytest.raises(ScenarioError, match="arena"):
        read_arena(table)


def imports_in(source):
    """Full names of all that a module imports; a relative import is not used here."""
    nodes = list(ast.walk(ast.parse(source.read_text())))
    modules = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    members = {f"{node.module}.{a.name}" for node in nodes if isinstance(node, ast.ImportFrom) for a in node.names}
    return modules | members


def test_no_other_module_imports_a_shape():
    """Where one did, another shape would need an edit there."""
    shapes = set()
    for module in SHAPES.values():
        name = module.ARENA.__name__
        shapes |= {module.__name__, f"{module.__name__}.{name}", f"moflock_mj.{name}"}
    sources = [path for package in ("controllers", "moflock_mj", "optimize") for path in (ROOT / package).rglob("*.py")]
    importing = {str(path.relative_to(ROOT)) for path in sources if imports_in(path) & shapes}
    assert {path for path in importing if not path.startswith("moflock_mj/world/")} <= set(MAY_NAME_A_SHAPE)
    assert {"moflock_mj/world/arena.py", "moflock_mj/scenario/scenario.py"} <= importing
