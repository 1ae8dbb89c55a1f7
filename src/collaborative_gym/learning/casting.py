"""Casting: members that learn, and guests, in the seats of the worlds."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from collaborative_gym.errors import UnknownName, unknown
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.team import Learner
from collaborative_gym.policies.policy import split_word
from collaborative_gym.tasks.task import Task

SELF, LEAGUE, POPULATION = "self", "league", "population"
"""Words for opponents and partners other than policies."""

MAIN, EXPLOITERS = "main", ("main_exploiter", "league_exploiter")
"""The members of a league that learn."""

MOST_CASTS = 64
"""Casts of a population, whose number grows as a power of that of the seats; with more,
each would have too few worlds (our choice)."""

Cast = tuple[str | None, ...]
"""The name in each seat of a world: a member that learns, or None for a guest."""


@dataclass(frozen=True)
class Casting:
    """Seats, and the casts among which the worlds are divided for good.

    A seat is what one policy commands as a whole: a side, or a robot of a team. The
    members of a run are the policies that learn in it. Each has networks for every
    seat. Without seats, the only member plays all.

    Attributes:
      seats: the agents of each seat, by its name.
      casts: names by seat, in the order of `seats`.
      shares: share of the worlds of each cast; none for equal shares.
    """

    seats: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    casts: tuple[Cast, ...] = ((),)
    shares: tuple[float, ...] = ()

    @property
    def members(self) -> tuple[str, ...]:
        """The members that learn, by name; a single one has an empty name."""
        names = (name for cast in self.casts for name in cast if name is not None)
        return tuple(dict.fromkeys(names)) or ("",)

    def learned(self, member: str) -> dict[str, tuple[str, ...]]:
        """Return the seats in which a member learns."""
        return {
            seat: agents
            for i, (seat, agents) in enumerate(self.seats.items())
            if any(cast[i] == member for cast in self.casts)
        }

    def guests(self) -> Iterator[tuple[str, str]]:
        """Yield the members and the seats in which guests play with each of them."""
        for cast in dict.fromkeys(self.casts):
            for host in dict.fromkeys(name for name in cast if name is not None):
                for seat, name in zip(self.seats, cast, strict=True):
                    if name is None:
                        yield host, seat

    def check(self, num_worlds: int) -> None:
        """Raise ValueError if a cast would get none of so many worlds."""
        if set(self.spread(num_worlds)) < set(self.casts):
            raise ValueError(
                f"{num_worlds} worlds are too few for {len(self.casts)} teams of"
                f" players; give more num_envs, a smaller"
                " population or fewer num_collectors"
            )

    def spread(self, num_worlds: int) -> list[Cast]:
        """Return each world's cast. Neighbours differ: worlds end one after another."""
        shares = np.array(self.shares or [1.0] * len(self.casts))
        shares /= shares.sum()
        given = np.zeros(len(shares))
        found = []
        for world in range(num_worlds):
            # The cast that is furthest behind; rounding must not decide among equals.
            i = int(np.argmax(np.round(shares * (world + 1) - given, 9)))
            given[i] += 1
            found.append(self.casts[i])
        return found

    def worlds(self, learner: Learner, num_worlds: int) -> dict[str, np.ndarray]:
        """Return by agent in which of the worlds a learner commands it."""
        casts = self.spread(num_worlds)
        seats = {a: i for i, own in enumerate(self.seats.values()) for a in own}
        return {
            agent: np.flatnonzero(
                [not cast or cast[seats[agent]] == learner.member for cast in casts]
            )
            for agent in learner.agents
        }

    def num_rows(self, learner: Learner, num_worlds: int) -> int:
        """Return how many rows a learner has in so many worlds."""
        rows = [len(each) for each in self.worlds(learner, num_worlds).values()]
        return sum(rows) if learner.stacked else rows[0]


def make_casting(
    task: Task,
    opponents: Sequence[str],
    partners: Sequence[str],
    *,
    hyperparameters: Hyperparameters,
) -> Casting:
    """Return the casting of a run.

    Args:
      task: what is learned.
      opponents: "self", "league" and policies, or policies alone, also of one side as
        in "side_2=FILE"; none for "self".
      partners: "population", or policies, also of one robot as in "robot_2=FILE".
      hyperparameters: the size of a population, and shares of a league's worlds.

    Raises:
      KeyError: if there is no such seat.
      ValueError: if the task has nobody to oppose or to help, or words do not fit.
    """
    seats = {agent: (agent,) for agent in task.agents}
    if len(task.sides) > 1:
        seats = {f"side_{i + 1}": tuple(own) for i, own in enumerate(task.sides)}
    words = tuple(opponents or partners)
    _check_words(task, opponents, partners)
    if words in ((), (SELF,)):
        return Casting()
    if words == (POPULATION,):
        members = [f"{i + 1}" for i in range(hyperparameters.population)]
        return Casting(seats, _mixed(members, len(seats)))
    bound = {seat for seat, _ in map(split_word, words) if seat}
    for seat in bound:
        if seat not in seats:
            option, kind = ("opponent", "side") if opponents else ("partner", "agent")
            raise UnknownName(f"{option}: {unknown(kind, seat, seats)}")
    if LEAGUE in words:
        return _league(seats, hyperparameters)
    if not bound:
        return Casting(seats, tuple(_each_alone("", seats)))
    if len(bound) == len(seats):
        raise ValueError(
            f"there is a policy for each seat ({', '.join(seats)}), so that nobody"
            " learns; leave one out"
        )
    if opponents:
        return Casting(seats, (tuple(None if s in bound else "" for s in seats),))
    # Robots of a team that learn beside a guest learn together, as one.
    own = tuple(agent for agent in task.agents if agent not in bound)
    guests = {agent: (agent,) for agent in task.agents if agent in bound}
    return Casting({"team": own} | guests, (("", *[None] * len(guests)),))


def _mixed(members: Sequence[str], num_seats: int) -> tuple[Cast, ...]:
    """Return all casts of members, or drawn ones if these would be too many.

    Of drawn ones, each member has each seat equally often.
    """
    if len(members) ** num_seats <= MOST_CASTS:
        return tuple(product(members, repeat=num_seats))
    rng, rounds = np.random.default_rng(0), MOST_CASTS // len(members)
    seats = [
        [str(name) for _ in range(rounds) for name in rng.permutation(members)]
        for _ in range(num_seats)
    ]
    return tuple(zip(*seats, strict=True))


def _each_alone(member: str, seats: Mapping[str, Any]) -> Iterator[Cast]:
    """Yield casts in which a member has one seat and guests have the others."""
    for own in seats:
        yield tuple(member if seat == own else None for seat in seats)


def _league(
    seats: Mapping[str, tuple[str, ...]], hyperparameters: Hyperparameters
) -> Casting:
    main, self_play = hyperparameters.league_main_share, hyperparameters.league_self
    casts: list[Cast] = [(MAIN,) * len(seats)] if self_play else []
    shares = [main * self_play] if self_play else []
    others = (1.0 - main) / len(EXPLOITERS)
    beside_guests = {MAIN: main * (1.0 - self_play)} | dict.fromkeys(EXPLOITERS, others)
    for member, share in beside_guests.items():
        casts += _each_alone(member, seats)
        shares += [share / len(seats)] * len(seats)
    return Casting(seats, tuple(casts), tuple(shares))


def _check_words(task: Task, opponents: Sequence[str], partners: Sequence[str]) -> None:
    """Raise ValueError if words do not fit the task or do not go together."""
    if opponents and len(task.sides) == 1:
        raise ValueError(
            f"{task.name} has one side, so there is no opponent; leave out"
            " opponent, or give a partner"
        )
    if partners and len(task.sides) > 1:
        raise ValueError(
            f"{task.name} has {len(task.sides)} sides; name whom to play"
            " against as opponent, not as partner"
        )
    for word in {SELF, LEAGUE} & set(partners):
        raise ValueError(
            f"{word} is for opponents; a partner is a policy, or {POPULATION}; a"
            f" file of that name is ./{word}"
        )
    words = tuple(opponents or partners)
    word = SELF if opponents else POPULATION
    if word in words and len(words) > 1:
        raise ValueError(
            f"{word} stands alone, got {' '.join(words)}; a file of that name is"
            f" ./{word}"
        )
    bound = [word for word in words if split_word(word)[0]]
    if bound and len(bound) < len(words):
        raise ValueError(
            f"{bound[0]} is for one seat and other policies are for any; name a seat"
            " for each, or for none"
        )
