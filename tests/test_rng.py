"""Random numbers of an episode."""

import numpy as np
import pytest

from collaborative_gym.rng import (
    EpisodeDraws,
    EpisodeRandom,
    Stream,
    check_seed,
    episode_generator,
)


def draw(seed, episode, stream=Stream.WORLD):
    return episode_generator(seed, episode, stream).random(4).tolist()


def test_seed_episode_and_stream_decide_the_numbers():
    assert draw(1, 2) == draw(1, 2)
    others = [draw(2, 1), draw(1, 3), draw(0, 2), draw(1, 2, Stream.POLICY)]
    assert all(other != draw(1, 2) for other in others)
    assert len({tuple(other) for other in others}) == 4


def test_the_numbers_never_change():
    """A change here changes every episode of every environment."""
    assert draw(0, 0)[:2] == [0.011546754286331562, 0.24154919656271812]


def test_an_episode_draws_the_same_beside_others():
    alone = EpisodeRandom([7], [3])
    beside = EpisodeRandom([7, 7, 8], [2, 3, 3])
    for size in ((), 2, (2, 3)):
        one, three = alone.uniform(-1, 1, size), beside.uniform(-1, 1, size)
        shape = (size,) if isinstance(size, int) else size
        assert three.shape == (3, *shape)
        np.testing.assert_array_equal(one[0], three[1])
    assert len(beside) == 3


def test_draws_fill_their_bounds():
    low, high = np.array([-2.0, 5.0]), np.array([-1.0, 5.0])
    values = EpisodeRandom([0] * 200, range(200)).uniform(low, high, 2)
    assert (values >= low).all()
    assert (values <= high).all()
    assert values[:, 0].min() < -1.95
    assert values[:, 0].max() > -1.05


def test_numbers_of_an_episode_stay_until_its_end():
    draws = EpisodeDraws(2, (3,), Stream.STYLE)
    first = draws.now({"seed": np.array([0, 0]), "episode": np.array([0, 1])}).copy()
    assert abs(first).max() <= 1.0
    assert not np.array_equal(first[0], first[1])
    # World 0 goes on to another episode, later world 1 plays that of world 0.
    second = draws.now({"seed": np.array([0, 0]), "episode": np.array([2, 1])}).copy()
    np.testing.assert_array_equal(second[1], first[1])
    assert not np.array_equal(second[0], first[0])
    third = draws.now({"seed": np.array([1, 0]), "episode": np.array([0, 0])})
    np.testing.assert_array_equal(third[1], first[0])
    assert not np.array_equal(third[0], first[0])


def test_seeds_are_checked():
    assert check_seed(np.int32(5)) == 5
    assert check_seed(2**63 - 1) == 2**63 - 1
    assert draw(2**63 - 1, 0) != draw(0, 0)
    for wrong, error in ((-1, ValueError), (True, TypeError), (1.0, TypeError)):
        with pytest.raises(error, match="seed must be"):
            check_seed(wrong)


def test_seeds_of_any_size_have_their_own_numbers():
    large = [2**63, 2**63 + 1, 2**64 - 1, 2**64, 2**200, 2**200 + 1, 10**5000]
    folded = [check_seed(seed) for seed in large]
    assert folded == [check_seed(np.uint64(2**63)), *folded[1:]]
    assert all(0 <= seed < 2**63 for seed in folded)
    assert len({tuple(draw(seed, 0)) for seed in [0, *folded]}) == 1 + len(large)
    # A change here changes the episodes of every large seed.
    assert check_seed(2**64) == 8425315350720491227
