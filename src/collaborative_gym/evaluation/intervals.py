"""95 % intervals of means, medians and shares, and means that no bad value moves.

`benchmarks/coverage.py` measures their coverage.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_Z = 1.959964
"""Half width of the normal distribution's 95 % interval, in standard deviations."""

_FREEDOM = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 60, 120, math.inf)
_T = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.306, 2.228, 2.131, 2.086, 2.042)
_T += (2.000, 1.980, _Z)
"""The same of Student's t distribution, by its degrees of freedom."""

_LEAST = 5
"""Least number of values whose median has an interval. With five, that is from the
least to the greatest, and holds 93.75 %."""


@dataclass(frozen=True)
class Estimate:
    """A number and its 95 % interval; NaN where nothing can be said."""

    value: float
    low: float = math.nan
    high: float = math.nan


def mean_of(strata: Sequence[np.ndarray], *, is_share: bool) -> list[Estimate]:
    """Return the mean of each column, with Student's t interval.

    Args:
      strata: each of (values, columns); intervals leave out how they differ.
      is_share: whether values are from 0 to 1; if all are alike, it is then Wilson's.
    """
    return _trimmed(strata, 0, is_share)


def iqm_of(strata: Sequence[np.ndarray], *, is_share: bool) -> list[Estimate]:
    """Return the interquartile mean of each column, with Yuen's (1974) interval.

    The arguments are those of `mean_of`.
    """
    return _trimmed(strata, sum(map(len, strata)) // 4, is_share)


def _trimmed(strata: Sequence[np.ndarray], cut: int, is_share: bool) -> list[Estimate]:
    """Return the means without the `cut` least and greatest of all values.

    In the error, each of these counts as the last value that is kept.
    """
    values = np.sort(np.concatenate(strata), axis=0)
    count = len(values)
    kept = values[cut : count - cut]
    squares = sum(
        np.square(own - own.mean(axis=0)).sum(axis=0) * len(own) / max(len(own) - 1, 1)
        for own in (np.clip(each, kept[0], kept[-1]) for each in strata)
    )
    size, freedom = len(kept), len(kept) - len(strata)
    if min(map(len, strata)) < 2 or freedom < 1:
        return _estimates(kept.mean(axis=0))
    error = np.sqrt(squares / count * (count - 1) / (size * (size - 1)))
    return _around(kept.mean(axis=0), error, freedom, count, is_share)


def median_of(strata: Sequence[np.ndarray]) -> list[Estimate]:
    """Return the median of each column, with an interval between two of the values.

    `strata` are those of `mean_of`; infinite numbers stand for never.
    """
    values = np.sort(np.concatenate(strata), axis=0)
    count = len(values)
    middle = np.median(values, axis=0)
    if count < _LEAST:
        return _estimates(middle)
    # Probability that at most k of the values lie below the median.
    chances = np.cumsum([math.comb(count, k) for k in range(count)]) / 2.0**count
    cut = max(int(np.searchsorted(chances, 0.025, side="right")) - 1, 0)
    high = np.where(np.isnan(middle), math.nan, values[-1 - cut])
    return _estimates(middle, values[cut], high)


def share_of(hits: np.ndarray) -> list[Estimate]:
    """Return the share of true values in each column of (values, columns)."""
    shares = hits.mean(axis=0)
    return _estimates(shares, *wilson(shares, len(hits)))


def _estimates(*numbers: np.ndarray) -> list[Estimate]:
    return [Estimate(*map(float, each)) for each in zip(*numbers, strict=True)]


def chance_of(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> Estimate:
    """Return the probability that one value beats another; a tie counts a half.

    The interval is DeLong's (1988): the mean of several pairs of values, each of (n,).
    """
    chances, parts, counts = [], [], []
    for one, other in pairs:
        wins = (np.sign(one[:, None] - other[None]) + 1.0) / 2.0
        chances.append(wins.mean())
        counts.append(min(wins.shape))
        parts += [(wins.mean(axis), n) for axis, n in ((1, len(one)), (0, len(other)))]
    chance = float(np.mean(chances))
    if min(counts) < 2:
        return Estimate(chance)
    squares = np.array([own.var(ddof=1) / n for own, n in parts])
    least = np.array([n - 1 for _, n in parts])
    whole, of_each = squares.sum(), np.square(squares) / least
    freedom = whole**2 / of_each.sum() if whole else 1.0
    error = math.sqrt(whole) / len(chances)
    return _around(np.array([chance]), error, freedom, sum(counts), True)[0]


def jackknifed(values: Sequence[float], whole: float, *, is_share: bool) -> Estimate:
    """Return `whole`, with an interval from the values without each run in turn."""
    count, own = len(values), np.array(values)
    if count < 2 or np.isnan(own).any():
        return Estimate(whole)
    error = math.sqrt((count - 1) / count * np.square(own - own.mean()).sum())
    return _around(np.array([whole]), error, count - 1, count, is_share)[0]


def _around(
    value: np.ndarray, error: Any, freedom: float, count: int, is_share: bool
) -> list[Estimate]:
    """Return Student's t intervals around values with these standard errors.

    A share without an error has Wilson's interval for so many values, because there may
    be what none of them showed; other numbers without an error have no interval.
    """
    # Rounding leaves errors that are none.
    error = np.where(np.abs(error) > 1e-9 * (1.0 + np.abs(value)), error, math.nan)
    width = np.interp(-1.0 / freedom, -1.0 / np.array(_FREEDOM), _T) * error
    low, high = value - width, value + width
    if is_share:
        least, most = wilson(value, count)
        low = np.where(np.isnan(width), least, np.maximum(low, 0.0))
        high = np.where(np.isnan(width), most, np.minimum(high, 1.0))
    return _estimates(value, low, high)


def iqm(values: np.ndarray) -> float:
    """Return the interquartile mean, that of the middle half."""
    count = len(values)
    return float(np.sort(values)[count // 4 : count - count // 4].mean())


def wilson(share: Any, count: int) -> tuple[Any, Any]:
    """Return the ends of Wilson's (1927) 95 % interval of shares, of `count` values."""
    square = _Z**2 / count
    middle = (share + square / 2.0) / (1.0 + square)
    width = np.sqrt(share * (1.0 - share) * square + square**2 / 4.0) / (1.0 + square)
    # Exact, so that a share at an end of the scale reads as that end.
    low, high = np.maximum(0.0, middle - width), np.minimum(1.0, middle + width)
    return np.round(low, 12), np.round(high, 12)
