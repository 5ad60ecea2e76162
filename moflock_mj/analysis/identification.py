"""Identification of an airframe with its controllers as a first-order response with a limit and a pure delay.

The rigid body flies velocity steps, and least squares fit the point mass to its response. A linear model by eigensystem
realization (Juang and Pappa 1985, python-control's `era`) is identified in addition.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.flight_control.gain_design import Margins, design_gains
from moflock_mj.analysis.step_response import step_response
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.scenario.effect_configs import PointMassConfig
from moflock_mj.scenario.scenario import Scenario

STEP_SIZES = (1.0, 3.0, 6.0)
"""Sizes of the velocity steps, m/s."""

DIRECTIONS = 8
"""Number of horizontal directions of the steps."""

LEG_SECONDS = 8.0
"""Duration of each step, s, many times the settling time."""

_LINEAR_STEP = 0.05
"""Sampling period of the linear model, s."""

_LINEAR_ORDER = 4
"""Order of the linear model: velocity, tilt, body rate and thrust along one axis."""


class LinearModel(NamedTuple):
    """Linear model for small steps.

    Attributes:
        bandwidth: frequency at which the gain is 3 dB below its static value, rad/s.
        error_rms: root mean square error for the smallest step, m/s.
    """

    bandwidth: float
    error_rms: float


class StepInfo(NamedTuple):
    """Characteristics of the smallest step, from python-control's `step_info`.

    Attributes:
        rise_time: time from 10 % to 90 %, s.
        settling_time: time after which the error stays within 2 %, s.
        overshoot: overshoot, % of the step.
    """

    rise_time: float
    settling_time: float
    overshoot: float


class Identification(NamedTuple):
    """Result of the identification of an airframe.

    Attributes:
        airframe: name of the airframe.
        response: point mass with the best fit.
        error_rms: root mean square error of that response over all steps and times, m/s.
        error_max: largest error of that response, m/s.
        undelayed_rms: root mean square error of the best response without delay, m/s.
        asked_rms: root mean square error of the response in the scenario (tau, a_max), m/s.
        linear: linear model.
        step: characteristics of the smallest step of the rigid body.
        margins: stability margins of the loops, as designed.
    """

    airframe: str
    response: PointMassConfig
    error_rms: float
    error_max: float
    undelayed_rms: float
    asked_rms: float
    linear: LinearModel
    step: StepInfo
    margins: tuple[Margins, ...]


def identify(scenario: Scenario) -> Identification:
    """Fly velocity steps, each with a reversal and a stop, with the scenario's airframe, and fit the point mass.

    Raises:
        MoflockError: the airframe is unknown, or too weak for the scenario.
    """
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = np.array([(math.cos(angle), math.sin(angle)) for _ in STEP_SIZES for angle in angles]).T  # (2, N)
    sizes = np.repeat(STEP_SIZES, DIRECTIONS)
    legs = np.array([1.0, -1.0, 0.0])[:, None] * sizes  # (K, N), along each direction
    commands = legs[:, None, :] * along
    measured = step_response(scenario, commands, LEG_SECONDS)
    step = float(measured.t[1])

    def misfit(response: PointMassConfig) -> NDArray[np.float64]:
        simulated = step_response(scenario.replace(point_mass=response), commands, LEG_SECONDS, "point_mass")
        return np.asarray(((simulated.velocity - measured.velocity) * along).sum(axis=1))

    nominal = PointMassConfig(tau=scenario.tau, a_max=scenario.a_max)
    best, undelayed = (_fit(misfit, nominal, free) for free in (("tau", "a_max", "delay"), ("tau", "a_max")))
    error = misfit(best)
    first = (measured.velocity * along).sum(axis=1)[: round(LEG_SECONDS / step), 0] / STEP_SIZES[0]
    linear = _linear(first, step)
    design = design_gains(
        load_airframe(scenario.airframe),
        step=step,
        tau=scenario.tau,
        a_max=scenario.a_max,
        tilt_max=scenario.tilt_max,
    )
    return Identification(
        airframe=scenario.airframe,
        response=best,
        error_rms=_rms(error),
        error_max=float(np.abs(error).max()),
        undelayed_rms=_rms(misfit(undelayed)),
        asked_rms=_rms(misfit(nominal)),
        linear=linear._replace(error_rms=STEP_SIZES[0] * linear.error_rms),
        step=_step_info(first, step),
        margins=design.margins,
    )


def calibrated(scenario: Scenario) -> Scenario:
    """Set the identified point mass of the airframe in a scenario, unless the scenario has its own.

    Raises:
        MoflockError: see `identify`.
    """
    return scenario if scenario.point_mass else scenario.replace(point_mass=identify(scenario).response)


def _fit(misfit: Any, nominal: PointMassConfig, free: tuple[str, ...]) -> PointMassConfig:
    """Fit the fields named in `free` by least squares of `misfit`."""
    from scipy.optimize import least_squares  # noqa: PLC0415

    lowest = {"tau": 0.05, "a_max": 0.1, "delay": 0.0}
    highest = {"tau": 60.0, "a_max": 100.0, "delay": LEG_SECONDS / 2}
    initial = {"tau": nominal.tau, "a_max": nominal.a_max, "delay": 0.1}

    def response(values: NDArray[np.float64]) -> PointMassConfig:
        return PointMassConfig(
            **{"tau": nominal.tau, "a_max": nominal.a_max} | dict(zip(free, values.tolist(), strict=True))
        )

    # The finite-difference step is large enough that the effect of a delay exceeds rounding errors.
    fit = least_squares(
        lambda values: misfit(response(values)).ravel(),
        [max(initial[name], lowest[name]) for name in free],
        bounds=([lowest[name] for name in free], [highest[name] for name in free]),
        diff_step=1e-3,
    )
    return response(fit.x)


def _linear(unit_response: NDArray[np.float64], step: float) -> LinearModel:
    """Identify a linear model from the response (T,) to a unit step."""
    import control  # noqa: PLC0415 - takes most of a second

    every = round(_LINEAR_STEP / step)
    period = every * step
    sampled = unit_response[::every]
    # A unit step response is the sum of the Markov parameters; python-control expects them divided by the period.
    markov = np.diff(sampled, prepend=0.0) / period
    half = len(markov) // 2 - 1
    model, _ = control.era(markov, _LINEAR_ORDER, m=half, n=half, dt=period)
    frequencies = np.geomspace(0.01, math.pi / period, 20_000)
    gain = np.abs(np.asarray(control.frequency_response(model, frequencies).complex).ravel())
    below_3_db = np.flatnonzero(gain < gain[0] / math.sqrt(2))
    modelled = np.asarray(control.step_response(model, T=period * np.arange(len(sampled))).y).ravel()
    return LinearModel(
        bandwidth=float(frequencies[below_3_db[0]]) if below_3_db.size else math.inf,
        error_rms=_rms(modelled - sampled),
    )


def _step_info(unit_response: NDArray[np.float64], step: float) -> StepInfo:
    import control  # noqa: PLC0415 - takes most of a second

    info = control.step_info(unit_response, timepts=step * np.arange(len(unit_response)), final_output=1.0)
    return StepInfo(float(info["RiseTime"]), float(info["SettlingTime"]), float(info["Overshoot"]))


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
