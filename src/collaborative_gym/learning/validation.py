"""Validations of members beside those with whom they learn."""

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.evaluation.play import play_episodes, worlds_for
from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.guests import Guests, Invitation
from collaborative_gym.math import Array
from collaborative_gym.tasks.task import Task

Pairing = tuple[tuple[str, ...], str]
"""Who sits in each seat, by name, and the seat that is validated."""


def validate(
    task: Task,
    casting: Casting,
    policies: Mapping[str, Any],
    pairings: Sequence[Pairing],
    *,
    episodes: int,
    seed: int,
    num_threads: int,
) -> dict[str, float]:
    """Return means over episodes, which all pairings share evenly.

    They are those of the seat that is validated: `return`, `completion`, `performance`,
    and against opponents `points`, 1 for a game that is won and 0.5 for a draw.

    Args:
      task: what is played.
      casting: whose seats there are.
      policies: by name, of all who sit somewhere.
      pairings: who plays with whom.
      episodes: least number of episodes.
      seed: of the episodes.
      num_threads: physics threads, 0 for one per CPU.
    """
    each = math.ceil(episodes / len(pairings))
    episodes = each * len(pairings)
    num_envs = worlds_for(episodes)
    with closing(VectorEnv(task, num_envs, seed=seed, num_threads=num_threads)) as env:
        guests = Guests(env, casting)
        guests.invite(Invitation(policies))

        def act(observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
            # Which pairing an episode has, depends on the episode alone.
            playing = env.progress["episode"] % len(pairings)
            guests.seat([list(pairings[i][0]) for i in playing])
            actions = env.idle()
            guests.act(observations, actions)
            return actions

        rows, _ = play_episodes(env, act, episodes, seed)
    is_divided, sums = len(task.sides) > 1, {}
    for row in rows:
        _, seat = pairings[row["episode"] % len(pairings)]
        before = f"{seat}/" if is_divided else ""
        for name in ("return", "completion", "performance"):
            sums.setdefault(name, []).append(float(row[f"{before}{name}"]))
        if is_divided:
            own = points(row, seat, list(casting.seats))
            sums.setdefault("points", []).append(own)
    return {name: math.fsum(each) / len(rows) for name, each in sums.items()}


def points(row: Mapping[str, Any], side: str, sides: Sequence[str]) -> float:
    """Return 1 if a side has won an episode, 0.5 for a draw, else 0."""
    own = row[f"{side}/score"]
    best = max(row[f"{other}/score"] for other in sides if other != side)
    return 0.5 * ((own > best) + (own >= best))
