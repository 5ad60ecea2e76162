"""Every policy of the registry: flown, logged, read, resumed, and its points and bounds there and back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from controllers.policies.registry import POLICIES, spec_of, values_of
from moflock_mj import Scenario, fly, load_point, read_log
from moflock_mj.analysis.verification import resume, verify
from moflock_mj.parameters.bounds import bounds_of, load_bounds, policy_bounds
from moflock_mj.parameters.points import dump_point

SCENARIO = Scenario(drones=3, duration=13.0, arena_side=100.0)
each_policy = pytest.mark.parametrize("policy", POLICIES)


def point_of(policy):
    """The middle of the policy's bounds, pulled a little to one side, so that no two parameters are alike."""
    bounds = policy_bounds(policy)
    return bounds.params(bounds.from_unit(np.linspace(0.4, 0.6, len(bounds.lower))))


@each_policy
def test_a_flight_is_logged_read_verified_and_resumed(policy, tmp_path):
    point = point_of(policy)
    flight = fly(point, scenario=SCENARIO, dynamics="point_mass", seed=2, log=tmp_path / "a.mcap")
    assert flight.complete
    assert np.isfinite(flight.samples.position).all()
    assert flight.samples.velocity[1:].any()
    logged = read_log(tmp_path / "a.mcap")
    assert spec_of(logged.params) is POLICIES[policy]
    assert (logged.params, logged.scenario, logged.fitness) == (point, SCENARIO, flight.fitness)
    assert logged.metadata["policy"] == policy
    assert verify(logged).identical
    resumed = resume(logged, 10.0, log=tmp_path / "b.mcap")
    np.testing.assert_array_equal(resumed.samples.position, flight.samples.position[101:])
    again = read_log(tmp_path / "b.mcap")
    assert again.params == point
    np.testing.assert_array_equal(again.digests, logged.digests[101:])


@each_policy
def test_the_parameters_matter(policy):
    point, bounds = point_of(policy), policy_bounds(policy)
    other = bounds.params(bounds.from_unit(np.full(len(bounds.lower), 0.9)))
    flights = [fly(params, scenario=SCENARIO, dynamics="point_mass", seed=2) for params in (point, other)]
    assert (flights[0].samples.position != flights[1].samples.position).any()


@each_policy
def test_a_point_file_there_and_back(policy, tmp_path):
    point = point_of(policy)
    path = tmp_path / "point.json"
    path.write_text(dump_point(point))
    assert load_point(path) == point
    assert list(json.loads(path.read_text())["params"]) == list(POLICIES[policy].names)


@each_policy
def test_bounds_there_and_back(policy, tmp_path):
    bounds = policy_bounds(policy)
    assert bounds.spec is POLICIES[policy]
    assert bounds_of(bounds.to_dict(), policy) == bounds
    lines = [f"policy = {json.dumps(policy)}", *(f"{name} = {pair}" for name, pair in bounds.to_dict().items())]
    (tmp_path / "bounds.toml").write_text("\n".join(lines) + "\n")
    (tmp_path / "bounds.json").write_text(json.dumps({"policy": policy} | bounds.to_dict()))
    assert load_bounds(tmp_path / "bounds.toml") == load_bounds(tmp_path / "bounds.json") == bounds
    unit = np.linspace(0.0, 1.0, len(bounds.lower))
    point = bounds.params(bounds.from_unit(unit))
    bounds.check(point)
    np.testing.assert_allclose(bounds.to_unit(list(values_of(point).values())), unit, atol=1e-12)


@each_policy
def test_each_parameter_has_a_unit_a_meaning_and_bounds(policy):
    spec = POLICIES[policy]
    assert spec.name == policy
    assert len(set(spec.names)) == len(spec.parameters)
    for parameter in spec.parameters:
        assert parameter.unit
        assert parameter.meaning
        assert parameter.low < parameter.high
