"""A deployment from take-off to landing."""

from __future__ import annotations

import pytest

from moflock_mj.deployment.member import Stage
from tests.support.rehearsal import SCENARIO, rehearse


@pytest.mark.parametrize("autopilot", ["ardupilot", pytest.param("px4", marks=pytest.mark.slow)])
def test_a_flock_takes_off_flies_by_the_policy_and_lands(autopilot, tmp_path):
    deployed, truth, _ = rehearse(autopilot=autopilot, log=tmp_path / "a.mcap")
    assert deployed.error is None
    assert set(deployed.stages) == {Stage.DOWN}
    assert not truth.armed[-1].any()
    assert deployed.figures.flocked == pytest.approx(SCENARIO.duration, abs=0.11)
    assert truth.nearest() > 3
    assert truth.farthest() < SCENARIO.arena_side / 2
