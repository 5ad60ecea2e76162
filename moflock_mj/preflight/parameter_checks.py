"""The part of a pre-flight check that needs neither flight nor vehicle: the point, the scenario and their loops."""

from __future__ import annotations

import math

from controllers.airframe import Airframe
from controllers.flight_control.gain_design import (
    GAIN_MARGIN_MIN,
    PHASE_MARGIN_MIN,
    GainDesignError,
    design_gains,
    maximum_horizontal_force,
)
from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.effects.feasibility import check_air
from moflock_mj.errors import MoflockError
from moflock_mj.parameters.bounds import paper_bounds
from moflock_mj.preflight.results import FLOCK, POINT, CheckItem, CheckResult, check
from moflock_mj.scenario.scenario import Scenario

_SEARCH_ANOTHER = "choose another point: moflock pick, moflock validate"
_FULL = 0.5
"""Share of the arena that a flock at the distances of its repulsion may take."""


def offline_items(params: VasarhelyiParams, scenario: Scenario, *, link_delay: float = 0.0) -> list[CheckItem]:
    """All checks of a point in a scenario.

    Args:
        params: the point.
        scenario: to be flown.
        link_delay: s, measured on the links, one way, on top of the scenario's t_del.
    """
    airframe = load_airframe(scenario.airframe)
    return [
        *_bounds(params),
        *_ranges(params, scenario),
        *_braking(params, scenario, airframe),
        *_room(params, scenario),
        _strength(scenario, airframe),
        *_loops(scenario, airframe),
        *_spacing_loop(params, scenario, link_delay),
    ]


def _bounds(params: VasarhelyiParams) -> list[CheckItem]:
    """Each parameter within the paper's bounds; beyond them by more than their width is no point of this policy."""
    bounds, items = paper_bounds(), []
    for name, value, low, high in zip(VasarhelyiParams._fields, params, bounds.lower, bounds.upper, strict=True):
        beyond = max(low - value, value - high, 0.0)
        items.append(
            check(
                f"bounds of {name}",
                POINT,
                good=beyond == 0,
                value=value,
                limit=f"{low:g} to {high:g}",
                advice=f"beyond what was ever searched: {_SEARCH_ANOTHER}",
                otherwise=CheckResult.WARNING if beyond <= high - low else CheckResult.FAILURE,
            )
        )
    return items


def _ranges(params: VasarhelyiParams, scenario: Scenario) -> list[CheckItem]:
    """Ranges that must be in order for the terms of the policy to follow each other."""
    reaction = scenario.t_del + scenario.t_gps + scenario.tau
    closing = 2 * scenario.v_max * reaction
    return [
        check(
            "alignment begins outside repulsion",
            POINT,
            good=params.r0_frict >= params.r0_rep,
            value=params.r0_frict,
            limit=f"r0_frict at least r0_rep, {params.r0_rep:g} m",
            unit="m",
            advice=f"drones would be pushed apart before they match speeds: {_SEARCH_ANOTHER}",
        ),
        check(
            "repulsion within earshot",
            POINT,
            good=params.r0_rep <= scenario.r_comm,
            value=params.r0_rep,
            limit=f"r0_rep at most r_comm, {scenario.r_comm:g} m",
            unit="m",
            advice="drones cannot keep off what they do not hear: use radios of longer range, or another point",
        ),
        check(
            "alignment within earshot",
            POINT,
            good=params.r0_frict <= scenario.r_comm,
            value=params.r0_frict,
            limit=f"r0_frict at most r_comm, {scenario.r_comm:g} m",
            unit="m",
            advice="drones match speeds with nobody that far away: the point was found for longer ranges",
            otherwise=CheckResult.WARNING,
        ),
        check(
            "way until drones react to each other",
            FLOCK,
            good=closing <= params.r0_rep,
            value=closing,
            limit=f"2 v_max (t_del + t_gps + tau) at most r0_rep, {params.r0_rep:g} m",
            unit="m",
            advice="two drones that meet close in on each other faster than they react: lower v_max, or choose a point "
            "with a larger r0_rep",
        ),
    ]


def _braking(params: VasarhelyiParams, scenario: Scenario, airframe: Airframe) -> list[CheckItem]:
    """Braking curves against what a body can do."""
    hardest = min(scenario.a_max, maximum_horizontal_force(airframe, scenario.tilt_max))
    return [
        check(
            "braking at walls",
            POINT,
            good=params.a_shill <= hardest,
            value=params.a_shill,
            limit=f"a_shill at most {hardest:.3g} m/s^2, what {airframe.name} can do",
            unit="m/s^2",
            advice=f"it would run through the wall: {_SEARCH_ANOTHER}, or use a stronger airframe",
        ),
        check(
            "braking among drones",
            POINT,
            good=params.a_frict <= 2 * hardest,
            value=params.a_frict,
            limit=f"a_frict at most {2 * hardest:.3g} m/s^2: both drones of a pair brake",
            unit="m/s^2",
            advice=f"two drones that meet could not brake as they expect: {_SEARCH_ANOTHER}",
        ),
        check(
            "walls turn the flock",
            POINT,
            good=params.v_shill > scenario.v_flock,
            value=params.v_shill,
            limit=f"v_shill over v_flock, {scenario.v_flock:g} m/s",
            unit="m/s",
            advice="walls would be overrun: choose a point with a larger v_shill, or lower v_flock",
        ),
    ]


def _room(params: VasarhelyiParams, scenario: Scenario) -> list[CheckItem]:
    """Whether the flock has room to stop and to be."""
    hardest = min(scenario.a_max, params.a_shill)
    stopping = scenario.v_max * (scenario.tau + scenario.t_gps) + scenario.v_max**2 / (2 * hardest)
    # Hexagonal packing gives each drone an area of sqrt(3)/2 times its distance squared.
    taken = scenario.drones * math.sqrt(3) / 2 * params.r0_rep**2 / scenario.arena_side**2
    return [
        check(
            "stopping distance",
            FLOCK,
            good=stopping <= scenario.arena_side / 4,
            value=stopping,
            limit=f"at most a quarter of the arena, {scenario.arena_side / 4:g} m",
            unit="m",
            advice="lower v_max and v_flock, or take a larger arena",
        ),
        check(
            "room in the arena",
            FLOCK,
            good=taken <= _FULL,
            value=100 * taken,
            limit=f"drones r0_rep apart take at most {100 * _FULL:g} % of the arena",
            unit="%",
            advice="fly fewer drones or take a larger arena: there is no room to flock in",
            otherwise=CheckResult.WARNING if taken <= 1 else CheckResult.FAILURE,
        ),
        check(
            "speeds",
            FLOCK,
            good=scenario.v_flock <= scenario.v_max,
            value=scenario.v_flock,
            limit=f"v_flock at most v_max, {scenario.v_max:g} m/s",
            unit="m/s",
            advice="raise v_max or lower v_flock: drones could not fly as fast as they want to",
        ),
    ]


def _strength(scenario: Scenario, airframe: Airframe) -> CheckItem:
    """Whether the airframe holds wind, drag and its battery."""
    try:
        check_air(scenario, airframe)
    except MoflockError as problem:
        return CheckItem(
            name="strength in this air",
            about=FLOCK,
            result=CheckResult.FAILURE,
            value=str(problem),
            advice="wait for less wind, charge, or use a stronger airframe",
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
    """Margins of the airframe's own loops."""
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


def _spacing_loop(params: VasarhelyiParams, scenario: Scenario, link_delay: float) -> list[CheckItem]:
    """Margins of the loop that keeps two drones apart, through the links.

    Both move by p_rep (m/s for each m of distance), with the velocity response of the airframe, 1 / (1 + tau s), on
    positions that are t_del and the links' delay old, and on average half of a beat.
    """
    import control  # noqa: PLC0415 - takes most of a second

    delay = scenario.t_del + link_delay + scenario.t_gps / 2
    s = control.tf("s")
    numerator, denominator = control.pade(delay, 6) if delay > 0 else ([1.0], [1.0])
    response = scenario.point_mass.tau if scenario.point_mass else scenario.tau
    loop = 2 * params.p_rep / (s * (1 + response * s)) * control.tf(numerator, denominator)
    gain, phase, _, _ = map(float, control.margin(loop))
    decibels = 20 * math.log10(gain) if 0 < gain < math.inf else math.inf
    what = f"with {1e3 * (scenario.t_del + link_delay):.0f} ms of delay"
    return [
        _margin(f"gain margin of repulsion {what}", decibels, GAIN_MARGIN_MIN, "dB"),
        _margin(f"phase margin of repulsion {what}", phase, PHASE_MARGIN_MIN, "degrees"),
    ]


def _margin(name: str, value: float, least: float, unit: str) -> CheckItem:
    return check(
        name,
        FLOCK,
        good=value >= least,
        value=value,
        limit=f"at least {least:g} {unit}",
        unit=unit,
        advice="shorten the delay (radios, rates), or choose a point with a smaller p_rep",
    )
