"""Intervals of the bootstrap and of shares, and means that no bad value moves."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

_RESAMPLES = 2000
"""Draws of the bootstrap; more would change an interval by less than a tenth."""

_ENDS = (0.025, 0.975)
"""Quantiles between which 95 % of the draws lie."""


_Z = 1.959964
"""Standard deviations on either side of a normal mean that hold 95 %."""


@dataclass(frozen=True)
class Estimate:
    """A number and how sure it is.

    Attributes:
      value: the number; NaN if it is not known.
      low: lower end of its 95 % bootstrap interval; NaN where nothing can be drawn.
      high: upper end of it.
    """

    value: float
    low: float = math.nan
    high: float = math.nan


def resample(*strata: np.ndarray) -> list[np.ndarray]:
    """Return each stratum drawn again, with replacement, (draws, values, ...).

    The draws are the same every time, so that equal values give equal intervals.

    Args:
      strata: each of (values, ...); no value moves from one to another.
    """
    rng = np.random.default_rng(0)
    return [
        stratum[rng.integers(0, len(stratum), (_RESAMPLES, len(stratum)))]
        for stratum in strata
    ]


def bounds(drawn: np.ndarray) -> np.ndarray:
    """Return the ends of the interval of what was drawn, (2, ...)."""
    return np.quantile(drawn, _ENDS, axis=0)


def estimate(
    of: Callable[..., np.ndarray], strata: Sequence[np.ndarray]
) -> list[Estimate]:
    """Return what a function gives of strata, with the stratified bootstrap's interval.

    If a stratum has only one value, there is no interval.

    Args:
      of: takes the strata, each of (..., values, columns), and returns (..., columns).
      strata: each of (values, columns).
    """
    found = of(*strata)
    if min(map(len, strata)) < 2:
        return [Estimate(float(value)) for value in found]
    # An infinite number stands for never; there is nothing half-way to it.
    low, high = np.quantile(of(*resample(*strata)), _ENDS, axis=0, method="nearest")
    return [Estimate(*map(float, ends)) for ends in zip(found, low, high, strict=True)]


def iqm(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the interquartile mean along an axis, that of the middle half."""
    count = values.shape[axis]
    middle = np.arange(count // 4, count - count // 4)
    return np.sort(values, axis).take(middle, axis).mean(axis)


def wilson(share: float, count: int) -> tuple[float, float]:
    """Return the ends of Wilson's (1927) 95 % interval of a share of so many."""
    square = _Z**2 / count
    middle = (share + square / 2.0) / (1.0 + square)
    width = math.sqrt(share * (1.0 - share) * square + square**2 / 4.0) / (1.0 + square)
    # Exact, so that a share at an end of the scale reads as that end.
    return round(max(0.0, middle - width), 12), round(min(1.0, middle + width), 12)
