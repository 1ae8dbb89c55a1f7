"""Random numbers that depend on the seed and the episode alone.

Episode e of seed s draws from a counter-based generator (Philox) keyed by (s, e). So an
episode starts the same way in any world of any batch, whatever was run before it.
"""

import hashlib
import math
from collections.abc import Mapping
from copy import copy
from enum import IntEnum

import numpy as np

from collaborative_gym.errors import check_count
from collaborative_gym.math import Array

_TRAINING, _VALIDATION = 1 << 40, 1 << 41
"""Added to the seed of a training run. So its episodes differ from those by which its
policy is chosen, and both from those of `evaluate` for a seed that people use."""


class Stream(IntEnum):
    """Uses of random numbers; streams of one episode are independent."""

    WORLD = 0
    POLICY = 1
    DISTURBANCES = 2
    STYLE = 3


def check_seed(seed: int) -> int:
    """Return a caller's seed as an `int` of at most 63 bits.

    A longer seed is replaced by 63 bits of its digest, and reports name that number.

    Raises:
      TypeError: if it is not an integer.
      ValueError: if it is negative.
    """
    number = check_count("seed", seed, at_most=math.inf)
    if number < 2**63:
        return number
    content = number.to_bytes((number.bit_length() + 7) // 8, "big")
    digest = hashlib.blake2b(content, digest_size=8).digest()
    return int.from_bytes(digest, "big") >> 1


def training_seed(seed: int) -> int:
    """Return the seed of a run's training episodes."""
    return _TRAINING + check_run_seed(seed)


def validation_seed(seed: int) -> int:
    """Return the seed of a run's validation episodes."""
    return _VALIDATION + check_run_seed(seed)


def check_run_seed(seed: int) -> int:
    """Return a run's seed, checked as `check_seed` does and to be below 2**40."""
    number = check_seed(seed)
    if number >= _TRAINING:
        raise ValueError(f"a training seed must be below 2**40, got {number}")
    return number


def episode_generator(seed: int, episode: int, stream: Stream) -> np.random.Generator:
    """Return the generator of one episode, at its beginning."""
    key = np.array([seed, episode], dtype=np.uint64)
    counter = np.array([0, 0, 0, stream], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))


class EpisodeRandom:
    """The generators of some episodes. Each draw has a row from every one of them.

    Args:
      seeds: one per episode.
      episodes: their indices.
      stream: what the random numbers are for.

    Attributes:
      keys: the seed and the index of each episode.
    """

    def __init__(self, seeds: Array, episodes: Array, stream: Stream = Stream.WORLD):
        self.keys = [*zip(map(int, seeds), map(int, episodes), strict=True)]
        self._generators = [episode_generator(*key, stream) for key in self.keys]

    def __len__(self) -> int:
        return len(self._generators)

    def rows(self, which: np.ndarray) -> "EpisodeRandom":
        """Return the generators of these rows, which go on from where they are."""
        chosen = copy(self)
        chosen.keys = [self.keys[i] for i in which]
        chosen._generators = [self._generators[i] for i in which]
        return chosen

    def uniform(self, low, high, size: int | tuple[int, ...] = ()) -> np.ndarray:
        """Return uniform draws, (episodes, *size); the bounds broadcast to `size`."""
        shape = (size,) if isinstance(size, int) else size
        unit = np.stack([generator.random(shape) for generator in self._generators])
        # In place, because these may be thousands of numbers for each world.
        unit *= np.subtract(high, low)
        unit += low
        return unit

    def within(self, bound, size: int | tuple[int, ...] = ()) -> np.ndarray:
        """Return uniform draws between minus and plus the bound, (episodes, *size)."""
        return self.uniform(np.negative(bound), bound, size)


class EpisodeDraws:
    """Uniform numbers from -1 to 1 that each world's episode has for itself.

    Args:
      num_envs: number of worlds.
      size: shape of one episode's numbers.
      stream: what the random numbers are for.
    """

    def __init__(self, num_envs: int, size: tuple[int, ...], stream: Stream):
        self._stream = stream
        self._numbers = np.zeros((num_envs, *size), np.float32)
        self._playing = np.full((num_envs, 2), -1)

    def now(self, progress: Mapping[str, Array]) -> np.ndarray:
        """Return the worlds' numbers, (num_envs, *size) float32, not to be changed.

        `progress` has the `seed` and the `episode` of each world.
        """
        playing = np.stack([progress["seed"], progress["episode"]], axis=1)
        begun = (playing != self._playing).any(axis=1)
        if begun.any():
            rng = EpisodeRandom(*playing[begun].T, self._stream)
            self._numbers[begun] = rng.within(1.0, self._numbers.shape[1:])
        self._playing = playing
        return self._numbers
