"""Target tracking: angular speed and distance of a flock around a target.

Source: Bansal, Sethi, Anicho and Nagar, section Results: order parameter of the target, and the fitted sine.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeWarning, curve_fit

from moflock_mj.errors import FlightError, ScenarioError
from moflock_mj.flight import continue_flight
from moflock_mj.metrics.samples import Samples
from moflock_mj.parameters.points import with_target
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.results import Flight, Progress
from moflock_mj.simulation.simulation import Simulation

TRANSIENT = 100.0
"""Initial time of a flight in which the flock approaches the target, s."""

_MIN_SAMPLES = 8
"""Smallest number of samples after the transient; a sine has four unknowns."""


class Sine(NamedTuple):
    """Sine amplitude sin(omega t + phase) + offset.

    Attributes:
        amplitude: amplitude, m, at least 0.
        omega: angular frequency, rad/s, at least 0.
        phase: phase, rad.
        offset: offset, m.
    """

    amplitude: float
    omega: float
    phase: float
    offset: float

    def at(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values at times in s, m."""
        return np.asarray(self.amplitude * np.sin(self.omega * t + self.phase) + self.offset)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class TargetResult:
    """Result of a flight around a target.

    Attributes:
        target: (x, y) of the target, m, world.
        flight: the flight with its samples.
        t: (T,), time, s.
        distance: (T,), d_target, the distance from the target to the mean position of all drones, m.
        sine: sine fitted to the distance after the transient.
        residual: root mean square of the residual of the fit, m.
    """

    target: tuple[float, float]
    flight: Flight
    t: NDArray[np.float64]
    distance: NDArray[np.float64]
    sine: Sine
    residual: float

    @property
    def F_target(self) -> float:
        """Ratio omega / amplitude of the sine, rad/(s m), larger for a faster and closer flock."""
        return self.sine.omega / self.sine.amplitude if self.sine.amplitude > 0 else math.inf


def track_target(
    params: NamedTuple,
    *,
    target: tuple[float, float] = (0.0, 0.0),
    scenario: Scenario | None = None,
    dynamics: str = "point_mass",
    seed: int = 1,
    transient: float = TRANSIENT,
    log: str | Path | None = None,
    progress: Progress | None = None,
) -> TargetResult:
    """Fly a flock around a target and fit a sine to its distance.

    Args:
        params: the 12 parameters of Vasarhelyi's policy.
        target: (x, y) of the target, m, world.
        scenario: scenario of the flight; the paper's if absent.
        dynamics: "point_mass" or "rigid_body".
        seed: seed of all random numbers.
        transient: initial time that the fit excludes, s.
        log: path of an MCAP file to write, or None.
        progress: callback with the simulated time and the running fitness.

    Raises:
        MoflockError: the flight is not possible, or too short for a fit.
    """
    scenario = scenario or Scenario()
    if scenario.duration < transient + _MIN_SAMPLES * scenario.sample_period:
        raise ScenarioError(
            f"duration: {scenario.duration:g} s is too short: it must be over the {transient:g} s of transient"
        )
    simulation = Simulation(with_target(params, target, 2 * max(scenario.arena.extent())), scenario, dynamics, seed)
    flight = continue_flight(simulation, log=log, progress=progress)
    samples = cast("Samples", flight.samples)
    distance = target_distance(samples.position, target)
    steady = samples.t >= transient
    sine = fit_sine(samples.t[steady], distance[steady])
    residuals = distance[steady] - sine.at(samples.t[steady])
    return TargetResult(
        target=(float(target[0]), float(target[1])),
        flight=flight,
        t=samples.t,
        distance=distance,
        sine=sine,
        residual=float(np.sqrt(np.mean(residuals**2))),
    )


def target_distance(position: NDArray[np.float64], target: tuple[float, float]) -> NDArray[np.float64]:
    """Horizontal distance from the target to the mean position of the flock, (T,), m, from positions (T, N, 3), m."""
    centre = position[..., :2].mean(axis=1)
    return np.asarray(np.linalg.norm(centre - np.asarray(target), axis=1))


def fit_sine(t: NDArray[np.float64], y: NDArray[np.float64]) -> Sine:
    """Fit a sine by least squares, with an initial guess from the largest bin of the Fourier transform.

    Args:
        t: (T,), evenly spaced times, s.
        y: (T,), values, m.

    Raises:
        FlightError: the fit does not converge.
    """
    spectrum = np.abs(np.fft.rfft(y - y.mean()))
    frequency = np.fft.rfftfreq(len(t), t[1] - t[0])[1 + np.argmax(spectrum[1:])]
    guess = Sine(math.sqrt(2) * float(np.std(y)), 2 * math.pi * float(frequency), 0.0, float(np.mean(y)))
    if guess.amplitude == 0:
        return guess
    # With the paper's initial phase of 0 only, the fit may converge to a local minimum.
    fits = [_least_squares(t, y, guess._replace(phase=quarter * math.pi / 2)) for quarter in range(4)]
    found = [fit for fit in fits if fit is not None]
    if not found:
        raise FlightError("target: no sine fits the distance")
    return min(found, key=lambda fit: float(np.sum((y - fit.at(t)) ** 2)))


def _least_squares(t: NDArray[np.float64], y: NDArray[np.float64], guess: Sine) -> Sine | None:
    """Fit a sine from a guess, with positive amplitude and frequency; None if the fit diverges."""

    def sine(t: NDArray[np.float64], a: float, omega: float, phase: float, offset: float) -> NDArray[np.float64]:
        return np.asarray(a * np.sin(omega * t + phase) + offset)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)  # warns about the covariance, which is not used
            (a, omega, phase, offset), _ = curve_fit(sine, t, y, p0=guess, maxfev=2000)
    except RuntimeError:
        return None
    phase = phase if omega >= 0 else math.pi - phase
    phase = phase if a >= 0 else phase + math.pi
    return Sine(abs(float(a)), abs(float(omega)), float(phase % (2 * math.pi)), float(offset))
