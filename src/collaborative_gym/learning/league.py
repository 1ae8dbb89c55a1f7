"""A league: a main policy, policies that look for its weaknesses, and their past.

After AlphaStar (Vinyals et al. 2019, Nature 575; numbers from the published
pseudocode). Three members learn. `main` plays itself, and former versions of itself and
of the exploiters, the more often the less it wins against them (prioritised fictitious
self-play). `main_exploiter` plays `main` as it is now, and `league_exploiter` plays
everybody's former versions. A member that beats all of these, or has learned for long,
leaves a frozen copy of itself as an opponent: `main-1` and so on. Then the main
exploiter begins anew, and sometimes the league exploiter does.

Two things differ from AlphaStar. A member that begins anew begins as a copy of `main`,
or with the networks with which the run began, because there is no policy learned from
people. And it leaves its own copy before that, not after. A copy inherits the results
of the member that it was copied from.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from collaborative_gym.files import write_text
from collaborative_gym.learning.casting import EXPLOITERS, MAIN, Casting
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.curve import draw_ratings
from collaborative_gym.learning.folder import LEAGUE_FILE, RATINGS
from collaborative_gym.learning.guests import Invitation, Odds
from collaborative_gym.learning.pool import Iteration, Latest, Pool, points
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import player_file
from collaborative_gym.tournaments.ratings import bradley_terry

_LEARN = (MAIN, *EXPLOITERS)

_WEIGHTS = {
    "squared": lambda rate: (1.0 - rate) ** 2,
    "variance": lambda rate: rate * (1.0 - rate),
    "capped": lambda rate: np.minimum(0.5, 1.0 - rate),
}
"""Weight of an opponent in a draw, by the share of points that one takes from it: for
hard ones, for those of equal strength, and for all that are not weak."""


@dataclass
class _Player:
    """A player in the league.

    Attributes:
      parent: from whom it was copied; empty for those that learn or were given.
      steps: of the run when it was copied.
      since: environment steps of a learning member since it left a copy.
    """

    parent: str = ""
    steps: int = 0
    since: float = 0.0


class League(Pool):
    """The guests of a league, and everybody's results.

    Args:
      casting: who sits where.
      policies: of guests who were never members, by name.
      hyperparameters: when copies are left, and who is drawn.
      folder: of the run.
      title: heads the picture.
      seed: the run's seed.
    """

    def __init__(
        self,
        casting: Casting,
        policies: Mapping[str, Any],
        *,
        hyperparameters: Hyperparameters,
        folder: Path,
        title: str,
        seed: int,
    ):
        super().__init__(casting, policies)
        self._numbers = hyperparameters
        self._folder, self._title, self._seed = folder, title, seed
        self._players = {name: _Player() for name in (*_LEARN, *policies)}
        # By home and away: games, and points of home; the older, the less they count.
        self._games: dict[str, dict[str, list[float]]] = {}
        self._steps = 0

    def invitation(self, latest: Latest) -> Invitation:
        """Return who may be drawn in the coming rollout."""
        if f"{MAIN}-0" not in self._players:
            self._copy(MAIN, latest)
        exploiter, other = EXPLOITERS
        odds = {
            MAIN: self._odds_of_main(),
            exploiter: self._odds_against_main(),
            other: self._odds(other, list(self.policies), "capped"),
        }
        seats = self._casting.seats
        by_seat = {member: dict.fromkeys(seats, own) for member, own in odds.items()}
        return Invitation(self.policies | {MAIN: latest(MAIN)}, by_seat)

    def study(
        self, iteration: Iteration, steps: int, latest: Latest
    ) -> list[tuple[str, str | None]]:
        """Count the games; copy members for which it is time."""
        for names, row in zip(iteration.seated, iteration.episodes, strict=True):
            self._count(names, row)
        done, self._steps = steps - self._steps, steps
        casts = self._casting.spread(self._numbers.num_envs)
        for member in _LEARN:
            share = sum(member in cast for cast in casts) / len(casts)
            self._players[member].since += share * done
        rng = np.random.default_rng([self._seed, steps])
        # Drawn in any case, so that one member changes no draw of another.
        chances = dict(zip(_LEARN, rng.random((2, len(_LEARN))).T, strict=True))
        anew: list[tuple[str, str | None]] = []
        for member in _LEARN:
            again, fresh = chances[member]
            if not self._is_due(member):
                continue
            self._copy(member, latest)
            resets = {EXPLOITERS[0]: 1.0, EXPLOITERS[1]: self._numbers.league_reset}
            if again < resets.get(member, 0.0):
                like = None if fresh < self._numbers.league_fresh else MAIN
                anew.append((member, like))
                self._inherit(member, like or f"{MAIN}-0")
        return anew

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on, but the policies, which have files."""
        players = {name: asdict(player) for name, player in self._players.items()}
        own = {"players": players, "games": self._games, "steps": self._steps}
        return super().state_dict() | own

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        Raises:
          FileNotFoundError: if the file of a player is gone.
          ValueError: if it is damaged, or a policy that was given has changed.
        """
        super().load_state_dict(state)
        self._players = {name: _Player(**own) for name, own in state["players"].items()}
        self._games, self._steps = state["games"], state["steps"]
        copies = [name for name, player in self._players.items() if player.parent]
        for path in (self._folder / player_file(name) for name in copies):
            if not path.exists():
                raise FileNotFoundError(
                    f"the league's player {path} is gone; bring it back, or start"
                    " another run"
                )
            self.policies[path.stem] = NetworkPolicy.load(path)

    def publish(self) -> None:
        """Write the table and the picture of all players.

        Raises:
          OSError: if one cannot be written.
        """
        ratings = self.ratings()
        content = {
            "steps": self._steps,
            "players": {
                name: {"parent": own.parent or None, "steps": self._age(name)}
                | {"rating": ratings[name]}
                for name, own in self._players.items()
            },
            "payoff": {
                home: {
                    away: {"games": games, "points": own, "rate": own / games}
                    for away, (games, own) in sorted(others.items())
                }
                for home, others in self._games.items()
            },
        }
        write_text(self._folder / LEAGUE_FILE, json.dumps(content, indent=2) + "\n")
        lines = {
            kind: [
                (self._age(name), ratings[name])
                for name, own in self._players.items()
                if kind in (name, own.parent)
            ]
            for kind in _LEARN
        } | {
            name: [(0, ratings[name]), (self._steps, ratings[name])]
            for name in self.policies
            if not self._players[name].parent
        }
        draw_ratings(lines, self._title, self._folder / RATINGS)

    def ratings(self) -> dict[str, float]:
        """Return everybody's rating on Elo's scale, of the games that still count."""
        names = list(self._players)
        nothing = (0.0, 0.0)
        taken = [
            [self._games.get(home, {}).get(away, nothing)[1] for away in names]
            for home in names
        ]
        strengths = map(float, bradley_terry(np.array(taken)))
        return dict(zip(names, strengths, strict=True))

    def _age(self, name: str) -> int:
        """Return the run's steps when a player was copied, or now if it learns."""
        own = self._players[name]
        return own.steps if own.parent else self._steps

    def _rates(self, home: str, others: Sequence[str]) -> np.ndarray:
        """Return the shares of points that one takes from others; 0.5 if unknown."""
        own = self._games.get(home, {})
        games = [own.get(away, (2.0, 1.0)) for away in others]
        return np.array([taken / played for played, taken in games])

    def _count(self, names: Sequence[str], row: Mapping[str, Any]) -> None:
        decay = self._numbers.league_decay
        seats = dict(zip(self._casting.seats, names, strict=True))
        for side, home in seats.items():
            for other, away in seats.items():
                if home != away:
                    own = self._games.setdefault(home, {})
                    games, taken = own.get(away, (0.0, 0.0))
                    taken = decay * taken + points(row, side, (side, other))
                    own[away] = [decay * games + 1.0, taken]

    def _is_due(self, member: str) -> bool:
        since, numbers = self._players[member].since, self._numbers
        if since < numbers.league_least_steps:
            return False
        others = [MAIN] if member == EXPLOITERS[0] else list(self.policies)
        beats_all = self._rates(member, others).min() > numbers.league_win_rate
        return bool(beats_all) or since >= numbers.league_most_steps

    def _copy(self, member: str, latest: Latest) -> None:
        count = sum(own.parent == member for own in self._players.values())
        name = f"{member}-{count + (member != MAIN)}"
        policy = latest(member)
        policy.save(self._folder / player_file(name))
        self.policies[name] = policy
        self._players[name] = _Player(parent=member, steps=self._steps)
        self._players[member].since = 0.0
        self._inherit(name, member)

    def _inherit(self, name: str, like: str) -> None:
        known = self._games.get(like, {}).items()
        self._games[name] = {a: list(each) for a, each in known if a != name}
        for home, others in self._games.items():
            others.pop(name, None)
            if home != name and like in others:
                others[name] = list(others[like])

    def _odds(self, member: str, others: Sequence[str], kind: str) -> Odds:
        weights = _WEIGHTS[kind](self._rates(member, others))
        total = weights.sum()
        if total < 1e-10:
            weights, total = np.ones(len(others)), len(others)
        return dict(zip(others, (weights / total).tolist(), strict=True))

    def _odds_of_main(self) -> Odds:
        """Return odds of everybody's past, and of players that main does not beat."""
        numbers, everybody = self._numbers, list(self.policies)
        odds = dict(self._odds(MAIN, everybody, "squared"))
        verified = self._to_verify()
        if verified:
            share = numbers.league_verify / (1.0 - numbers.league_self)
            odds = {name: (1.0 - share) * each for name, each in odds.items()}
            for name, each in self._odds(MAIN, verified, "squared").items():
                odds[name] += share * each
        return odds

    def _to_verify(self) -> list[str]:
        """Return exploiters that main does not beat, or else its past, if forgotten."""
        past = {name: own.parent for name, own in self._players.items()}
        exploiters = [name for name, parent in past.items() if parent in EXPLOITERS]
        rates = self._rates(MAIN, exploiters)
        if exploiters and rates.min() < self._numbers.league_exploited:
            return exploiters
        own = [name for name, parent in past.items() if parent == MAIN]
        rates = self._rates(MAIN, own)
        # If the newest are the hardest, main has not forgotten anything.
        while len(own) > 1 and rates[-2] >= rates[-1]:
            own, rates = own[:-1], rates[:-1]
        if len(own) > 1 and rates.min() < self._numbers.league_win_rate:
            return own
        return []

    def _odds_against_main(self) -> Odds:
        """Return odds of main as it is, or of its past if it is too strong."""
        member = EXPLOITERS[0]
        if self._rates(member, [MAIN])[0] > self._numbers.league_hopeless:
            return {MAIN: 1.0}
        past = [name for name, own in self._players.items() if own.parent == MAIN]
        return self._odds(member, past, "variance")
