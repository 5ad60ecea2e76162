"""Coverage: a slow twin, and cases with a known answer."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from moflock_mj.world.square import Square
from optimize.evaluation.coverage import SIGHT, coverage


def slow_coverage(position, arena_side):
    cells = max(round(arena_side / 10.0), 1)
    centres = (np.arange(cells) + 0.5) * arena_side / cells - arena_side / 2
    seen = np.zeros((cells, cells), bool)
    share = []
    for sample in position:
        for x, y, _ in sample:
            distance = np.hypot(centres[:, None] - x, centres[None, :] - y)
            seen |= distance <= SIGHT
        share.append(seen.mean())
    return np.array(share)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 1000), side=st.sampled_from([3.0, 47.0, 100.0, 333.0]))
def test_as_its_slow_twin(seed, side):
    position = np.random.default_rng(seed).uniform(-side, side, (6, 3, 3))
    np.testing.assert_allclose(coverage(position, Square(side)), slow_coverage(position, side), atol=1e-12)


def test_a_drone_that_hovers_sees_the_cells_around_it():
    # Centres at 5, 15 and 25 m along each axis; of those, (5, 5), (5, 15), (15, 5) and (15, 15) lie within 25 m.
    share = coverage(np.zeros((3, 1, 3)), Square(1000.0))
    assert share.tolist() == [4 * 4 / 100**2] * 3


def test_a_sweep_sees_all_and_the_share_never_falls():
    lanes = np.linspace(-90, 90, 7)
    along = np.linspace(-100, 100, 60)
    position = np.array([[[x, y, 0.0]] for y in lanes for x in along])
    share = coverage(position, Square(200.0))
    assert share[-1] == 1.0
    assert (np.diff(share) >= 0).all()


def test_outside_the_arena_nothing_is_seen():
    assert coverage(np.full((2, 4, 3), 1e6), Square(500.0)).tolist() == [0.0, 0.0]
