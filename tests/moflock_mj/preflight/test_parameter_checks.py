"""Checks of a point in a scenario: named points pass, and each check has something that it fails."""

from __future__ import annotations

import dataclasses
import math

import pytest

from moflock_mj import Scenario, fly
from moflock_mj.parameters.points import load_point, point_names
from moflock_mj.preflight.parameter_checks import parameter_items
from moflock_mj.preflight.results import CheckResult
from moflock_mj.preflight.simulation_checks import fly_trials, trial_items
from moflock_mj.scenario.acceptance import AcceptanceLimits
from moflock_mj.scenario.effect_configs import WindConfig
from moflock_mj.scenario.faults import FaultConfig

KNEE = load_point("knee")


@pytest.mark.parametrize("name", [name for name in point_names() if name != "model_optimum"])
def test_named_points_pass_in_the_papers_scenario(name):
    wrong = [item for item in parameter_items(load_point(name), Scenario()) if item.result is not CheckResult.PASS]
    assert wrong == []


def test_the_model_optimum_is_beyond_the_papers_bounds():
    wrong = [item.name for item in parameter_items(load_point("model_optimum"), Scenario()) if item.result != "pass"]
    assert wrong == ["bounds of r0_shill", "bounds of v_shill"]


@pytest.mark.parametrize(
    ("name", "params", "scenario"),
    [
        ("bounds of c_frict", {"c_frict": 9.0}, {}),
        ("alignment begins outside repulsion", {"r0_frict": KNEE.r0_rep - 1}, {}),
        ("repulsion within radio range", {}, {"r_comm": KNEE.r0_rep - 1}),
        ("distance until drones react to each other", {}, {"t_del": 3.0}),
        ("braking at walls", {"a_shill": 9.0}, {"tilt_max": 0.3}),
        ("braking among drones", {"a_frict": 13.0}, {}),
        ("walls turn the flock", {"v_shill": 5.0}, {}),
        ("stopping distance", {}, {"arena_side": 20.0}),
        ("space in the arena", {}, {"arena_side": 20.0}),
        ("speeds", {}, {"v_flock": 7.0}),
        ("strength in this air", {}, {"wind": WindConfig(speed=30.0)}),
        ("loops", {}, {"a_max": 30.0}),
        ("gain margin of repulsion with 1000 ms of delay", {"p_rep": 2.0}, {}),
        ("phase margin of repulsion with 4000 ms of delay", {"p_rep": 0.3}, {"t_del": 4.0}),
    ],
)
def test_each_check_can_fail_and_says_what_to_do(name, params, scenario):
    items = {item.name: item for item in parameter_items(KNEE._replace(**params), Scenario(**scenario))}
    assert items[name].result is CheckResult.FAILURE
    assert items[name].advice


def test_the_margins_of_repulsion_are_those_of_its_loop():
    """At the crossover of 2 p e^(-s T) / (s (1 + s)): |L| = 1, and 180 degrees less what the loop turns by there."""
    p, delay = 0.3, 1.0 + 0.2 / 2 + 0.05
    crossover = math.sqrt((math.sqrt(1 + 16 * p * p) - 1) / 2)
    margin = 90 - math.degrees(math.atan(crossover) + crossover * delay)
    items = parameter_items(KNEE._replace(p_rep=p), Scenario(), link_delay=0.05)
    found = next(item for item in items if item.name == "phase margin of repulsion with 1050 ms of delay")
    assert found.value == pytest.approx(margin, abs=0.01)


def test_a_slower_link_costs_margin():
    margins = [
        next(
            item.value
            for item in parameter_items(KNEE, Scenario(), link_delay=delay)
            if "phase margin of r" in item.name
        )
        for delay in (0.0, 0.5)
    ]
    assert margins[1] < margins[0]


SMALL = Scenario(drones=3, duration=4.0, arena_side=100.0)


def test_flights_are_those_of_their_seeds_in_the_scenario_to_be_flown():
    told = []
    scenario = SMALL.replace(faults=(FaultConfig(drone=1, kind="power_off", at=2.0),))
    flights = fly_trials(KNEE, scenario, (3, 4), workers=2, progress=told.append)
    alone = fly(KNEE, scenario=scenario, dynamics="rigid_body", seed=4, keep_samples=False)
    assert flights[1].order_parameters == alone.order_parameters
    assert [flight.body.lost for flight in flights] == [1, 1]
    assert all(0 <= share <= 1 for share in told)
    # Who falls by the scenario's own fault is not held against the point.
    assert not [item for item in trial_items(flights, scenario) if item.name.startswith("drones lost") and item.advice]


def test_what_flights_can_fail_by():
    flights = fly_trials(KNEE, SMALL, (1,))
    body, motion = flights[0].body, flights[0].motion
    bad = dataclasses.replace(
        flights[0],
        body=body._replace(lost=1, touched=2, saturated_share=0.5, altitude_error_max=3.0),
        motion=motion._replace(separation_min=0.4, outside_max=40.0),
    )
    assert {item.result for item in trial_items(flights, SMALL)} == {CheckResult.PASS}
    failed = trial_items([flights[0], bad], SMALL)
    assert {item.result for item in failed} == {CheckResult.FAILURE}
    assert all(item.advice for item in failed)
    lenient = SMALL.replace(verdict=AcceptanceLimits(touched_flights=0.5))
    touches = next(item for item in trial_items([flights[0], bad], lenient) if item.name == "flights with contacts")
    assert touches.result is CheckResult.WARNING
