"""Ratings of players from the games that they won and lost."""

from collections.abc import Sequence
from itertools import permutations

import numpy as np

_MEAN = 1500.0  # mean of all players' ratings; only differences say anything

_SCALE = 400.0 / np.log(10.0)
"""Elo's scale: 400 points more are ten times the chances (Elo, 1978)."""

_PRIOR = 1.0
"""Games that each player has drawn, as we assume, with an average one; our choice. So a
player that won all of its games has a finite rating, which grows with their number."""

_NEAR = 1e-10  # change of the strengths at which Newton's method ends


def bradley_terry(points: np.ndarray) -> np.ndarray:
    """Return the ratings on Elo's scale, (..., players), with a mean of 1500.

    They are the likeliest ones in the model of Bradley and Terry (1952), in which
    player i beats player j with the probability 1 / (1 + 10^((r_j - r_i) / 400)).
    Unlike Elo's own updates, they do not depend on the order of games. One drawn game
    with an average player is added for each player, so that all ratings are finite.

    Args:
      points: of each player, a row, against each other, a column, in all games: 1 for
        a win, 0.5 for a draw; (..., players, players). The diagonal does not count.
    """
    return _fit(points)[0]


def rated(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ratings and their standard errors, (players,) each.

    The errors are those of the curvature of the likelihood, as if games did not depend
    on one another. So a player that won all of its games has one, too. `points` are
    those of `bradley_terry`, (players, players).
    """
    ratings, curvature = _fit(points)
    centred = np.eye(len(points)) - 1.0 / len(points)
    spread = centred @ np.linalg.inv(curvature) @ centred
    return ratings, _SCALE * np.sqrt(spread.diagonal())


def _fit(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ratings, and the curvature of the likelihood there."""
    count = points.shape[-1]
    points = points * (1.0 - np.eye(count))
    games = points + np.swapaxes(points, -1, -2)
    strength, curvature = np.zeros(points.shape[:-1]), np.eye(count)
    for _ in range(1000):
        chance = _logistic(strength[..., :, None] - strength[..., None, :])
        average = _logistic(strength)
        slope = (points - games * chance).sum(-1) + _PRIOR * (0.5 - average)
        bend = games * chance * (1.0 - chance)
        own = bend.sum(-1) + _PRIOR * average * (1.0 - average)
        curvature = own[..., None] * np.eye(count) - bend
        step = np.linalg.solve(curvature, slope[..., None])[..., 0]
        # Far from the end, whole steps of Newton's method may lead astray.
        largest = np.abs(step).max(-1, keepdims=True, initial=0.0)
        strength = strength + step / np.maximum(largest, 1.0)
        if largest.max(initial=0.0) < _NEAR:
            break
    ratings = _MEAN + _SCALE * (strength - strength.mean(-1, keepdims=True))
    return ratings, curvature


def cyclic_triples(
    names: Sequence[str], beats: np.ndarray
) -> list[tuple[str, str, str]]:
    """Return triples of players in which each beats the next, and the last the first.

    A row of `beats` says which players, in columns, a player beats.
    """
    return [
        (names[i], names[j], names[k])
        for i, j, k in permutations(range(len(names)), 3)
        if i < min(j, k) and beats[i, j] and beats[j, k] and beats[k, i]
    ]


def _logistic(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-x))
