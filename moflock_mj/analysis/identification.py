"""What an airframe with its controllers is to the flock: a first-order response with a bound and a pure delay.

Velocity steps are flown on the rigid-body plant, and the point mass that answers them most alike is found by least
squares. Beside it stands a linear model by eigensystem realization (Juang and Pappa 1985, python-control's `era`).
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
"""m/s."""

DIRECTIONS = 8

LEG_SECONDS = 8.0
"""Each step is held for this long, many times what it takes to settle."""

_LINEAR_STEP = 0.05
"""s; samples of the linear model."""

_LINEAR_ORDER = 4
"""Of the linear model: velocity, tilt, body rate and thrust along one axis."""


class LinearModel(NamedTuple):
    """The linear model, for small steps.

    Attributes:
        bandwidth: rad/s, at which its answer has fallen by 3 dB.
        error_rms: m/s, beside the smallest step.
    """

    bandwidth: float
    error_rms: float


class StepInfo(NamedTuple):
    """A step of the smallest size, as python-control's `step_info` measures it.

    Attributes:
        rise_time: s, from 10 % to 90 %.
        settling_time: s, to stay within 2 %.
        overshoot: % of the step.
    """

    rise_time: float
    settling_time: float
    overshoot: float


class Identification(NamedTuple):
    """What was found of an airframe.

    Attributes:
        airframe: its name.
        response: the point mass that answers most like it.
        error_rms: m/s, of that response, over all steps and times.
        error_max: m/s.
        undelayed_rms: m/s, of the best response without a delay.
        asked_rms: m/s, of the response that the scenario asks for.
        linear: the linear model.
        step: of the body.
        margins: of the loops, as designed.
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
    """Fly velocity steps with the scenario's airframe, each with a reversal and a stop, and fit the point mass.

    Raises:
        MoflockError: the airframe is unknown, or too weak for the scenario.
    """
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = np.array([(math.cos(angle), math.sin(angle)) for _ in STEP_SIZES for angle in angles]).T  # (2, N)
    sizes = np.repeat(STEP_SIZES, DIRECTIONS)
    legs = np.array([1.0, -1.0, 0.0])[:, None] * sizes  # (K, N), along each direction
    commands = legs[:, None, :] * along
    flown = step_response(scenario, commands, LEG_SECONDS)
    step = float(flown.t[1])

    def misfit(response: PointMassConfig) -> NDArray[np.float64]:
        answered = step_response(scenario.replace(point_mass=response), commands, LEG_SECONDS, "point_mass")
        return np.asarray(((answered.velocity - flown.velocity) * along).sum(axis=1))

    asked = PointMassConfig(tau=scenario.tau, a_max=scenario.a_max)
    best, undelayed = (_fit(misfit, asked, free) for free in (("tau", "a_max", "delay"), ("tau", "a_max")))
    error = misfit(best)
    first = (flown.velocity * along).sum(axis=1)[: round(LEG_SECONDS / step), 0] / STEP_SIZES[0]
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
        asked_rms=_rms(misfit(asked)),
        linear=linear._replace(error_rms=STEP_SIZES[0] * linear.error_rms),
        step=_step_info(first, step),
        margins=design.margins,
    )


def calibrated(scenario: Scenario) -> Scenario:
    """The scenario with the point mass of its airframe, unless it has one of its own already.

    Raises:
        MoflockError: see `identify`.
    """
    return scenario if scenario.point_mass else scenario.replace(point_mass=identify(scenario).response)


def _fit(misfit: Any, asked: PointMassConfig, free: tuple[str, ...]) -> PointMassConfig:
    """The response with the least squares of `misfit`, the named fields being free."""
    from scipy.optimize import least_squares  # noqa: PLC0415

    lowest = {"tau": 0.05, "a_max": 0.1, "delay": 0.0}
    highest = {"tau": 60.0, "a_max": 100.0, "delay": LEG_SECONDS / 2}
    begin = {"tau": asked.tau, "a_max": asked.a_max, "delay": 0.1}

    def response(values: NDArray[np.float64]) -> PointMassConfig:
        return PointMassConfig(
            **{"tau": asked.tau, "a_max": asked.a_max} | dict(zip(free, values.tolist(), strict=True))
        )

    # A delay moves the answer by shares of a step: smaller differences are lost in rounding.
    found = least_squares(
        lambda values: misfit(response(values)).ravel(),
        [max(begin[name], lowest[name]) for name in free],
        bounds=([lowest[name] for name in free], [highest[name] for name in free]),
        diff_step=1e-3,
    )
    return response(found.x)


def _linear(answer: NDArray[np.float64], step: float) -> LinearModel:
    """A linear model of a unit step's answer (T,)."""
    import control  # noqa: PLC0415 - takes most of a second

    every = round(_LINEAR_STEP / step)
    period = every * step
    sampled = answer[::every]
    # The answer to a unit step is the sum of the Markov parameters, which python-control takes over the period.
    markov = np.diff(sampled, prepend=0.0) / period
    half = len(markov) // 2 - 1
    model, _ = control.era(markov, _LINEAR_ORDER, m=half, n=half, dt=period)
    frequencies = np.geomspace(0.01, math.pi / period, 20_000)
    gain = np.abs(np.asarray(control.frequency_response(model, frequencies).complex).ravel())
    fallen = np.flatnonzero(gain < gain[0] / math.sqrt(2))
    modelled = np.asarray(control.step_response(model, T=period * np.arange(len(sampled))).y).ravel()
    return LinearModel(
        bandwidth=float(frequencies[fallen[0]]) if fallen.size else math.inf,
        error_rms=_rms(modelled - sampled),
    )


def _step_info(answer: NDArray[np.float64], step: float) -> StepInfo:
    import control  # noqa: PLC0415 - takes most of a second

    info = control.step_info(answer, timepts=step * np.arange(len(answer)), final_output=1.0)
    return StepInfo(float(info["RiseTime"]), float(info["SettlingTime"]), float(info["Overshoot"]))


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
