"""Confidence intervals of means over flights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

CONFIDENCE = 0.95


def half_width(values: ArrayLike, axis: int) -> NDArray[np.float64]:
    """Half the width of the mean's 95 % confidence interval (Student's t), over at least two values along `axis`."""
    values = np.asarray(values, np.float64)
    count = values.shape[axis]
    quantile = stats.t.ppf((1 + CONFIDENCE) / 2, count - 1)
    return np.asarray(values.std(axis=axis, ddof=1) * quantile / np.sqrt(count))
