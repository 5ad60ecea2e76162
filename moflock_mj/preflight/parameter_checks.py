"""The part of a pre-flight check that needs neither flights nor vehicles: point, scenario and control loops."""

from __future__ import annotations

from typing import NamedTuple

from controllers.airframe import Airframe
from controllers.flight_control.gain_design import (
    GAIN_MARGIN_MIN,
    PHASE_MARGIN_MIN,
    GainDesignError,
    design_gains,
    maximum_horizontal_force,
)
from controllers.policies.interface import FlightConditions
from controllers.policies.registry import spec_of, values_of
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.effects.battery import make_battery
from moflock_mj.effects.drag import make_drag
from moflock_mj.effects.feasibility import check_feasible
from moflock_mj.errors import MoflockError
from moflock_mj.preflight.results import FLOCK, POINT, CheckItem, CheckResult, check
from moflock_mj.scenario.scenario import Scenario

_OTHER_POINT = "choose another point: moflock pick, moflock validate"


def parameter_items(params: NamedTuple, scenario: Scenario, *, link_delay: float = 0.0) -> list[CheckItem]:
    """All checks of a point in a scenario.

    Args:
        params: the point.
        scenario: scenario of the deployment.
        link_delay: measured one-way delay of the links, s, in addition to the scenario's t_del.
    """
    airframe = load_airframe(scenario.airframe)
    return [
        *_bounds(params),
        *_policy_items(params, _conditions(scenario, airframe, link_delay)),
        *_speeds(scenario, airframe),
        _strength(scenario, airframe),
        *_loops(scenario, airframe),
    ]


def _bounds(params: NamedTuple) -> list[CheckItem]:
    """Check each parameter against its bounds: a warning outside, a failure more than their width outside."""
    items, values = [], values_of(params)
    for parameter in spec_of(params).parameters:
        value, low, high = values[parameter.name], parameter.low, parameter.high
        beyond = max(low - value, value - high, 0.0)
        items.append(
            check(
                f"bounds of {parameter.name}",
                POINT,
                good=beyond == 0,
                value=value,
                limit=f"{low:g} to {high:g}",
                advice=f"outside the bounds of every search: {_OTHER_POINT}",
                otherwise=CheckResult.WARNING if beyond <= high - low else CheckResult.FAILURE,
            )
        )
    return items


def _conditions(scenario: Scenario, airframe: Airframe, link_delay: float) -> FlightConditions:
    return FlightConditions(
        drones=scenario.drones,
        v_flock=scenario.v_flock,
        v_max=scenario.v_max,
        r_comm=scenario.r_comm,
        t_gps=scenario.t_gps,
        delay=scenario.t_del + link_delay,
        tau=scenario.point_mass.tau if scenario.point_mass else scenario.tau,
        a_max=min(scenario.a_max, maximum_horizontal_force(airframe, scenario.tilt_max)),
        airframe=airframe.name,
        arena_area=scenario.arena.area(),
    )


def _policy_items(params: NamedTuple, conditions: FlightConditions) -> list[CheckItem]:
    """The policy's own checks."""
    return [
        check(
            found.name,
            FLOCK if found.whole_flock else POINT,
            good=found.good,
            value=found.value,
            limit=found.limit,
            unit=found.unit,
            advice=found.advice,
            otherwise=CheckResult.FAILURE if found.fatal else CheckResult.WARNING,
        )
        for found in spec_of(params).checks(params, conditions)
    ]


def _speeds(scenario: Scenario, airframe: Airframe) -> list[CheckItem]:
    """Check that the flock can stop within the arena and fly at its cruise speed."""
    hardest = min(scenario.a_max, maximum_horizontal_force(airframe, scenario.tilt_max))
    stopping = scenario.v_max * (scenario.tau + scenario.t_gps) + scenario.v_max**2 / (2 * hardest)
    quarter = min(scenario.arena.extent()) / 2
    return [
        check(
            "stopping distance",
            FLOCK,
            good=stopping <= quarter,
            value=stopping,
            limit=f"at most a quarter of the arena, {quarter:g} m",
            unit="m",
            advice="lower v_max and v_flock, or use a larger arena",
        ),
        check(
            "speeds",
            FLOCK,
            good=scenario.v_flock <= scenario.v_max,
            value=scenario.v_flock,
            limit=f"v_flock at most v_max, {scenario.v_max:g} m/s",
            unit="m/s",
            advice="raise v_max or lower v_flock: the cruise speed exceeds the maximum speed",
        ),
    ]


def _strength(scenario: Scenario, airframe: Airframe) -> CheckItem:
    """Check that the airframe can withstand wind and drag, and lift its battery."""
    try:
        check_feasible(scenario, airframe, make_drag(scenario, airframe), make_battery(scenario, airframe))
    except MoflockError as problem:
        return CheckItem(
            name="strength in this air",
            about=FLOCK,
            result=CheckResult.FAILURE,
            value=str(problem),
            advice="wait for less wind, charge the battery, or use a stronger airframe",
        )
    push = maximum_horizontal_force(airframe, scenario.tilt_max)
    return CheckItem(
        name="strength in this air",
        about=FLOCK,
        result=CheckResult.PASS,
        value=push,
        unit="m/s^2",
        limit="wind, drag and weight",
    )


def _loops(scenario: Scenario, airframe: Airframe) -> list[CheckItem]:
    """Check the stability margins of the airframe's control loops."""
    try:
        design = design_gains(
            airframe,
            step=scenario.step_for("rigid_body"),
            tau=scenario.tau,
            a_max=scenario.a_max,
            tilt_max=scenario.tilt_max,
        )
    except GainDesignError as problem:
        text = str(problem)
        return [
            CheckItem(
                name="loops",
                about=FLOCK,
                result=CheckResult.FAILURE,
                value=text,
                advice="use a stronger airframe, or lower a_max",
            )
        ]
    worst_gain = min(design.margins, key=lambda loop: loop.gain_margin)
    worst_phase = min(design.margins, key=lambda loop: loop.phase_margin)
    return [
        _margin(f"gain margin, {worst_gain.loop} loop", worst_gain.gain_margin, GAIN_MARGIN_MIN, "dB"),
        _margin(f"phase margin, {worst_phase.loop} loop", worst_phase.phase_margin, PHASE_MARGIN_MIN, "degrees"),
    ]


def _margin(name: str, value: float, least: float, unit: str) -> CheckItem:
    return check(
        name,
        FLOCK,
        good=value >= least,
        value=value,
        limit=f"at least {least:g} {unit}",
        unit=unit,
        advice="use an airframe with faster rotors, or lower a_max",
    )
