"""Fixtures that several packages share; each process of a parallel run makes its own, once."""

from __future__ import annotations

import pytest

from moflock_mj.errors import RenderError
from moflock_mj.rendering.gl import find_gl

pytest.register_assert_rewrite("tests.support")

from tests.support.flights import SMALL, fly_small  # noqa: E402 - after its assertions are made to explain themselves


@pytest.fixture(scope="session")
def small_flight():
    """A flight of four point masses for twelve seconds."""
    return fly_small()


@pytest.fixture(scope="session")
def small_log(tmp_path_factory):
    """The log of that flight."""
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    flown = fly_small(log=path, keep_samples=False)
    assert (flown.flown, flown.scenario) == (SMALL.duration, SMALL)
    return path


@pytest.fixture(scope="session")
def gl():
    """Skip a test that renders where nothing can."""
    try:
        find_gl()
    except RenderError:
        pytest.skip("no EGL and no OSMesa: apt-get install libegl1 libosmesa6")
