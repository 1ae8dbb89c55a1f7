"""Ratings from results that can be worked out by hand."""

import numpy as np
import pytest

from collaborative_gym.tournaments.ratings import bradley_terry, cyclic_triples


def points_of(strengths, games):
    """Return what players of these ratings are expected to take from one another."""
    differences = np.subtract.outer(strengths, strengths) / 400.0
    return games / (1.0 + 10.0**-differences)


def test_ratings_are_those_that_the_results_came_from():
    strengths = np.array([1700.0, 1500.0, 1450.0, 1350.0])
    found = bradley_terry(points_of(strengths, 1e6))
    np.testing.assert_allclose(found, strengths, atol=0.01)


def test_two_players_have_the_elo_difference_of_their_points():
    # Each of them besides drew a game with an average player.
    found = bradley_terry(np.array([[0.0, 750_000.0], [250_000.0, 0.0]]))
    assert found[0] - found[1] == pytest.approx(400 * np.log10(3), abs=0.01)
    assert found.mean() == pytest.approx(1500.0)


def test_who_won_everything_has_a_finite_rating_that_grows_with_the_games():
    few, many = (
        bradley_terry(np.array([[0.0, games], [0.0, 0.0]])) for games in (10.0, 1000.0)
    )
    assert np.isfinite(many).all()
    assert 100 < few[0] - few[1] < many[0] - many[1] < 3000
    nobody = bradley_terry(np.zeros((3, 3)))
    np.testing.assert_allclose(nobody, 1500.0)


def test_ratings_do_not_depend_on_the_order_of_players():
    rng = np.random.default_rng(0)
    points = rng.integers(0, 50, (8, 8)).astype(float)
    points[3] = 50.0
    points[:, 3] = 0.0
    order = rng.permutation(8)
    np.testing.assert_allclose(
        bradley_terry(points)[order], bradley_terry(points[order][:, order]), atol=1e-6
    )


def test_many_results_are_rated_at_once():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 50, (5, 4, 4))
    np.testing.assert_allclose(
        bradley_terry(points), [bradley_terry(each) for each in points]
    )


def test_cycles_are_found_once_each():
    beats = np.zeros((4, 4), bool)
    for i, j in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)):
        beats[i, j] = True
    assert cyclic_triples("abcd", beats) == [("a", "b", "c")]
    assert cyclic_triples("acb", beats[[0, 2, 1]][:, [0, 2, 1]]) == [("a", "b", "c")]
    assert not cyclic_triples("abcd", np.triu(np.ones((4, 4), bool), 1))
