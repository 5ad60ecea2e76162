"""Fitness of each order parameter, from 0 to 1; larger is better."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.metrics.order_parameters import OrderParameters
from moflock_mj.scenario.scenario import Scenario


class Fitness(NamedTuple):
    """The six fitnesses, the paper's two objectives and the product of all six; or arrays of them over time.

    Attributes:
        wall, speed, corr, coll, disc, cluster: fitness of one order parameter each, in [0, 1].
        F_1: wall times speed.
        F_2: corr times coll times disc times cluster.
        product: F_1 times F_2.
    """

    wall: float
    speed: float
    corr: float
    coll: float
    disc: float
    cluster: float
    F_1: float
    F_2: float
    product: float


def rising(phi: ArrayLike, phi0: float, width: float) -> NDArray[np.float64]:
    """F1 of the paper: 0 below phi0 - width, 1 above phi0, and half a cosine period between."""
    below = np.minimum(np.maximum((np.asarray(phi) - phi0) / width, -1), 0)
    return np.asarray((1 + np.cos(np.pi * below)) / 2)


def gaussian(phi: ArrayLike, width: float) -> NDArray[np.float64]:
    """F2 of the paper: exp(-phi^2 / width^2)."""
    return np.exp(-((np.asarray(phi) / width) ** 2))


def falling(phi: ArrayLike, width: float) -> NDArray[np.float64]:
    """F3 of the paper: width^2 / (phi + width)^2."""
    return (width / (np.asarray(phi) + width)) ** 2


def fitness_of(order_parameters: OrderParameters, scenario: Scenario) -> Fitness:
    """Fitness of order parameters, as floats from floats and as arrays from arrays."""
    phi = order_parameters
    fifth = scenario.drones / 5
    wall = gaussian(phi.wall, scenario.r_tol)
    speed = rising(phi.vel, scenario.v_flock, scenario.v_tol)
    corr = np.maximum(phi.corr, 0.0)
    coll = falling(phi.coll, scenario.a_tol)
    disc = falling(phi.disc, fifth)
    cluster = rising(phi.cluster, fifth, fifth)
    f_1, f_2 = wall * speed, corr * coll * disc * cluster
    values = (wall, speed, corr, coll, disc, cluster, f_1, f_2, f_1 * f_2)
    return Fitness(*(value if np.ndim(value) else float(value) for value in values))  # type: ignore[arg-type]
