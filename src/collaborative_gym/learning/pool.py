"""The guests of a run: how often each is drawn, and validations beside them."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import naming
from collaborative_gym.evaluation.play import play_episodes, worlds_for
from collaborative_gym.learning.casting import LEAGUE, Casting
from collaborative_gym.learning.guests import Guests, Invitation
from collaborative_gym.math import Array
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import commanding, read_policy, split_word
from collaborative_gym.tasks.task import Task

Latest = Callable[[str], NetworkPolicy]
"""Returns a member's policy as it is now."""


@dataclass(frozen=True)
class Iteration:
    """The results of one rollout and one update.

    Attributes:
      episodes: a row for each episode that ended and was played in full, as
        `evaluation.episode_row` returns it.
      updates: by learner, the numbers that `display.UPDATE` names.
      seated: who sat in each seat meanwhile, by name, for each row of `episodes`.
    """

    episodes: list[dict[str, Any]]
    updates: dict[str, dict[str, float]]
    seated: list[tuple[str, ...]] = field(default_factory=list)


class Pool:
    """Guests of whom each is as likely as the others.

    Args:
      casting: who sits where.
      policies: by name, as `read_guests` returns them.

    Attributes:
      policies: of all guests, by name.
    """

    def __init__(self, casting: Casting, policies: Mapping[str, Any]):
        self.policies = dict(policies)
        self._casting = casting
        self._given = {
            name: policy.digest
            for name, policy in policies.items()
            if isinstance(policy, NetworkPolicy)
        }

    def invitation(self, latest: Latest) -> Invitation:
        """Return who may be drawn in the coming rollout."""
        odds: dict[str, dict[str, dict[str, float]]] = {}
        for host, seat in self._casting.guests():
            names = self._names(seat)
            odds.setdefault(host, {})[seat] = dict.fromkeys(names, 1.0 / len(names))
        return Invitation(self.policies, odds)

    def validate(
        self, task: Task, latest: Latest, *, episodes: int, seed: int, num_threads: int
    ) -> dict[str, float]:
        """Return means over episodes of the first member beside all who may join it.

        They are those of its own seat: `return`, `completion`, `performance`, and
        against opponents `points`, 1 for a game that is won and 0.5 for a draw.

        Args:
          task: what is played.
          latest: members' policies.
          episodes: least number of episodes; all pairings have equally many.
          seed: the episodes' seed.
          num_threads: physics threads, 0 for one per CPU.
        """
        members = self._casting.members
        policies = {name: latest(name) for name in members} | self.policies
        pairings = self._pairings(members[0])
        episodes = math.ceil(episodes / len(pairings)) * len(pairings)
        count = worlds_for(episodes)
        with closing(VectorEnv(task, count, seed=seed, num_threads=num_threads)) as env:
            guests = Guests(env, self._casting)
            guests.invite(Invitation(policies))

            def act(observations: Mapping[str, Array]) -> dict[str, np.ndarray]:
                # Which pairing an episode has, depends on the episode alone.
                playing = env.progress["episode"] % len(pairings)
                guests.seat([list(pairings[i][0]) for i in playing])
                actions = env.idle()
                guests.act(observations, actions)
                return actions

            rows, _ = play_episodes(env, act, episodes, seed)
        is_divided, columns = len(task.sides) > 1, {}
        for row in rows:
            _, seat = pairings[row["episode"] % len(pairings)]
            before = f"{seat}/" if is_divided else ""
            for name in ("return", "completion", "performance"):
                columns.setdefault(name, []).append(float(row[f"{before}{name}"]))
            if is_divided:
                own = points(row, seat, list(self._casting.seats))
                columns.setdefault("points", []).append(own)
        return {name: math.fsum(each) / len(rows) for name, each in columns.items()}

    def study(
        self, iteration: Iteration, steps: int, latest: Latest
    ) -> list[tuple[str, str | None]]:
        """Return the members that begin anew after an iteration.

        Args:
          iteration: its results.
          steps: environment steps done so far.
          latest: members' policies.

        Returns:
          By member, the one whose copy it becomes, None for its first networks.
        """
        return []

    def publish(self) -> None:
        """Write files about the guests."""

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on."""
        return {"given": self._given}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        Raises:
          ValueError: if a policy that was given is another one by now.
        """
        for name, digest in state.get("given", {}).items():
            if self._given.get(name) != digest:
                raise ValueError(
                    f"the policy {name!r} has changed since this run began; bring the"
                    " former one back, or start another run"
                )

    def _pairings(self, member: str) -> list[tuple[tuple[str, ...], str]]:
        """Return who may sit beside a member: names by seat, and its own seat."""
        found = []
        has_guests = any(None in cast for cast in self._casting.casts)
        for cast in dict.fromkeys(self._casting.casts):
            # Games of a member with itself say nothing about it.
            if member not in cast or (has_guests and None not in cast):
                continue
            choices = [
                self._names(seat) if name is None else [name]
                for seat, name in zip(self._casting.seats, cast, strict=True)
            ]
            own = list(self._casting.seats)[cast.index(member)]
            found += [
                (tuple(each[i % len(each)] for each in choices), own)
                for i in range(max(map(len, choices)))
            ]
        return found

    def _names(self, seat: str) -> list[str]:
        return [name for name in self.policies if split_word(name)[0] in ("", seat)]


def points(row: Mapping[str, Any], side: str, sides: Sequence[str]) -> float:
    """Return 1 if a side has won an episode, 0.5 for a draw, else 0."""
    own = row[f"{side}/score"]
    best = max(row[f"{other}/score"] for other in sides if other != side)
    return 0.5 * ((own > best) + (own >= best))


def read_guests(task: Task, casting: Casting, words: Sequence[str]) -> dict[str, Any]:
    """Return the policy that each word names, checked in all seats that it may have.

    Args:
      task: what is learned.
      casting: who sits where.
      words: as `make_casting` takes them.

    Raises:
      FileNotFoundError: if there is no such file; this and the others name the guest.
      KeyError: if there is no such policy.
      ValueError: if one is damaged, or for another environment or seat.
    """
    kind = "opponent" if len(task.sides) > 1 else "partner"
    free = dict.fromkeys(seat for _, seat in casting.guests())
    found: dict[str, Any] = {}
    given = [word for word in words if word != LEAGUE] if free else []
    if not given:
        return found
    with closing(VectorEnv(task, 1, num_threads=1, strain=True)) as env:
        for word in given:
            own, name = split_word(word)
            with naming(f"{kind} {word!r}"):
                found[word] = read_policy(name, env)
                for seat in free:
                    if own in ("", seat):
                        commanding(casting.seats[seat], found[word], env, False)
    return found
