"""Intervals, against published numbers and by how often they hold the truth."""

import math

import numpy as np
import pytest

from collaborative_gym.evaluation.intervals import (
    chance_of,
    iqm_of,
    jackknifed,
    mean_of,
    median_of,
    share_of,
    wilson,
)
from collaborative_gym.evaluation.report import Statistic


def test_wilsons_interval_is_the_published_one():
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3.
    assert wilson(81 / 263, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0.0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(1.0, 29) == pytest.approx((0.8830, 1.0), abs=5e-5)


@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_intervals_over_few_runs_hold_the_truth(count):
    scores = np.random.default_rng(0).normal(size=(count, 4000))
    for estimates in (
        mean_of([scores], is_share=False),
        iqm_of([scores], is_share=False),
        median_of([scores]) if count >= 5 else (),
    ):
        held = [each.low <= 0.0 <= each.high for each in estimates]
        assert not held or 0.93 < np.mean(held) < 0.99


def test_what_differs_between_strata_is_no_part_of_an_interval():
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(2, 6, 1))
    apart = mean_of([one, other + 100.0], is_share=False)[0]
    near = mean_of([one, other], is_share=False)[0]
    assert apart.high - apart.low == pytest.approx(near.high - near.low)


@pytest.mark.parametrize("of", [mean_of, iqm_of])
def test_shares_that_are_all_alike_leave_room_and_returns_say_nothing(of):
    alike = np.ones((5, 1))
    (share,) = of([alike], is_share=True)
    assert (share.low, share.high) == wilson(1.0, 5)
    (number,) = of([alike], is_share=False)
    assert number.value == 1.0 and math.isnan(number.low)
    (share,) = of([np.array([[1.0], [0.9], [1.0], [0.5], [1.0]])], is_share=True)
    assert 0.0 <= share.low < share.value < share.high <= 1.0


def test_medians_lie_between_values_of_which_some_are_never():
    taken = np.array([3.0, 1.0, math.inf, 2.0, 4.0])[:, None]
    (median,) = median_of([taken])
    assert (median.value, median.low, median.high) == (3.0, 1.0, math.inf)
    assert math.isnan(median_of([taken[:4]])[0].low)
    (median,) = median_of([np.arange(20.0)[:, None]])
    assert (median.low, median.high) == (5.0, 14.0)  # tables of the sign test


def test_chances_and_shares_are_within_0_and_1():
    better, worse = np.arange(10.0, 15.0), np.arange(5.0)
    sure = chance_of([(better, worse)])
    assert (sure.value, sure.low, sure.high) == (1.0, *wilson(1.0, 5))
    mixed = chance_of([(np.array([1.0, 3.0, 5.0]), np.array([2.0, 3.0, 0.0]))])
    assert mixed.value == pytest.approx(6.5 / 9.0)
    assert 0.0 <= mixed.low < mixed.value < mixed.high <= 1.0
    (share,) = share_of(np.array([[True]] * 3 + [[False]]))
    assert (share.low, share.high) == wilson(0.75, 4)
    assert math.isnan(chance_of([(better[:1], worse)]).low)


def test_the_jackknife_of_a_mean_is_students_t():
    values = np.array([0.3, 0.1, 0.8, 0.4])
    left = [np.delete(values, i).mean() for i in range(4)]
    found = jackknifed(left, values.mean(), is_share=False)
    (known,) = mean_of([values[:, None]], is_share=False)
    assert (found.low, found.high) == pytest.approx((known.low, known.high))


def test_a_statistic_of_episodes_takes_wilsons_or_students_interval():
    yes = Statistic.of([1.0] * 5 + [0.0] * 3, is_share=True)
    assert (yes.low, yes.high) == wilson(5 / 8, 8)
    some = Statistic.of([1.0] * 5 + [0.5] * 3, is_share=True)
    assert some.low < some.mean < some.high <= 1.0
    assert some.mean - some.low == pytest.approx(2.36 * 0.2588 / 8**0.5, rel=0.01)
    assert math.isnan(Statistic.of([2.0, 2.0]).low)


def test_no_time_is_negative():
    assert Statistic.of([1.0, 9.0]).low < 0.0
    assert Statistic.of([1.0, 9.0], at_least=0.0).low == 0.0
    assert math.isnan(Statistic.of([2.0, 2.0], at_least=0.0).low)
