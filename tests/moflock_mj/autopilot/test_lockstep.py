"""N autopilots over real sockets and one world."""

from __future__ import annotations

import contextlib
import threading

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.autopilot.lockstep import INTERFACES, LockStep, PhysicsPlan
from moflock_mj.errors import AirframeError, FleetError, LinkError, ScenarioError
from tests.moflock_mj.autopilot.stand_in import STAND_INS

CALM = Scenario(sigma_inner=0.0, sigma_outer=0.0)
KINDS = tuple(INTERFACES)


@contextlib.contextmanager
def world_of(kind, vehicles=1, notice=None, **plan):
    """A world that listens at any free ports, as fast as it can."""
    notices = [] if notice is None else notice
    world = LockStep(
        PhysicsPlan(autopilot=kind, vehicles=vehicles, port=0, speed=100.0, scenario=CALM, **plan), notices.append
    )
    world.open()
    try:
        yield world
    finally:
        world.close()


@contextlib.contextmanager
def flown_by(pilots):
    """Stand-ins that step in threads of their own until the end."""
    done = threading.Event()

    def fly(pilot):
        with contextlib.suppress(OSError):
            while not done.is_set() and not getattr(pilot, "hangs", False):
                pilot.step()

    threads = [threading.Thread(target=fly, args=[pilot], daemon=True) for pilot in pilots]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        done.set()
        for pilot in pilots:
            pilot.socket.close()
        for thread in threads:
            thread.join(10.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_stand_in_of_each_kind_takes_off_and_hovers(kind):
    with world_of(kind, vehicles=2) as world:
        start = world.bodies.qpos[:, :2].copy()
        pilots = [STAND_INS[kind](link.port, 2.0 + link.number) for link in world.links]
        with flown_by(pilots):
            assert world.gather(lambda: False)
            world.run(8.0)
        np.testing.assert_allclose(world.bodies.qpos[:, 2], [2.0, 3.0], atol=0.1)
        np.testing.assert_allclose(world.bodies.qpos[:, :2], start, atol=0.3)
        assert np.abs(world.bodies.qvel).max() < 0.2
        assert all(link.counts.dropped == 0 and link.counts.restarts == 0 for link in world.links)
        exchanges = round(8.0 / world.period)
        assert all(abs(pilot.steps - exchanges) <= 1 for pilot in pilots)
