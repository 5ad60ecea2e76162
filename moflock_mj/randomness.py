"""Random numbers: one seed, one independent generator per concern."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Streams(NamedTuple):
    """Independent generators; what one concern draws never shifts what another gets."""

    start: np.random.Generator
    sensing: np.random.Generator
    communication: np.random.Generator
    disturbance: np.random.Generator
    wind: np.random.Generator
    inertial: np.random.Generator
    walk: np.random.Generator
    fix: np.random.Generator
    faults: np.random.Generator

    @classmethod
    def of(cls, seed: int) -> Streams:
        """The generators that belong to a seed, a whole number from 0."""
        children = np.random.SeedSequence(seed).spawn(len(cls._fields))
        return cls(*(np.random.Generator(np.random.SFC64(child)) for child in children))
