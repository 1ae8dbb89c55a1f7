"""The results of a tournament: matrices, standings, ratings; JSON and CSV."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from collaborative_gym.evaluation.intervals import jackknifed
from collaborative_gym.evaluation.report import Statistic, format_number, is_share
from collaborative_gym.evaluation.table import to_csv, to_json
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tournaments.ratings import cyclic_triples, rated

_Z = 1.96  # standard errors on either side of a rating's 95 % interval

SERVED = 0.9
"""Least performance of a response to one partner that suits another; our choice."""


@dataclass(frozen=True)
class Pairing:
    """Episodes of one player in one seat with another, or itself, in all other seats.

    Attributes:
      players: names by seat.
      columns: of the episodes, in order, by the names of a `Report`'s rows.
    """

    players: Mapping[str, str]
    columns: Mapping[str, Sequence[float]]

    @property
    def title(self) -> str:
        """Names of the players, such as "expert + idle"."""
        return " + ".join(self.players.values())

    @property
    def is_one_episode(self) -> bool:
        """Whether all episodes are the same one, because they start alike."""
        return all(len({*map(repr, column)}) == 1 for column in self.columns.values())


@dataclass(frozen=True)
class Standing:
    """Results of one player.

    Attributes:
      self_play: with itself in all seats, by measure.
      cross_play: with each other player, in each seat in turn; the mean, by measure.
      gap: self-play minus cross-play; empty if players are opponents.
      by_seat: its cross-play in each seat, by seat and measure.
      worst: the other player with whom, or against whom, it does worst; None if it
        played with nobody else.
      wins: episodes won against others; None for partners.
      draws: likewise.
      losses: likewise.
      rating: on Elo's scale (Bradley and Terry); only if players are opponents.
    """

    self_play: dict[str, Statistic]
    cross_play: dict[str, Statistic]
    gap: dict[str, Statistic]
    by_seat: dict[str, dict[str, Statistic]]
    worst: str | None
    wins: int | None = None
    draws: int | None = None
    losses: int | None = None
    rating: Statistic | None = None


@dataclass(frozen=True)
class Tournament:
    """Results of every policy in every seat with every other.

    If the task has several sides, seats are sides. Pairings are then compared by
    `points` (1 for an episode that was won, 0.5 for a draw, 0 for one that was lost)
    and by `score`, the difference to the best other side. Otherwise seats are robots,
    and pairings are compared by their common `completion`, `performance` and `return`.

    Intervals are of 95 %, as `Statistic` has them: of a single pairing over its
    episodes, of a mean over other players over these, of a group's means over its runs,
    and of a rating over games.

    Attributes:
      environment: the environment's id or the task's name.
      settings: the environment's whole `identity`, `episodes` and `seed`.
      seats: the agents of each seat, by its name.
      turns: the seats that each player took in turn, with others in the rest.
      players: their names, in the order in which they were given.
      pairings: all that were played.
      groups: training runs of one kind, by the kind's name.
      left_out: why pairings could not be played, by their titles.
    """

    environment: str
    settings: dict[str, Any]
    seats: dict[str, tuple[str, ...]]
    turns: tuple[str, ...]
    players: tuple[str, ...]
    pairings: tuple[Pairing, ...]
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """The environment and its arms."""
        return Identity.from_dict(self.settings["identity"]).title

    @property
    def is_divided(self) -> bool:
        """Whether the seats are sides that play against one another."""
        return "completion" not in self.pairings[0].columns

    @property
    def measures(self) -> tuple[str, ...]:
        """Measures of a pairing; the first counts most."""
        if self.is_divided:
            return "points", "score"
        return "completion", "performance", "return"

    @cached_property
    def is_one_episode(self) -> bool:
        """Whether each pairing's episodes are all the same one."""
        is_alone = self.settings["episodes"] == 1
        return not is_alone and all(each.is_one_episode for each in self.pairings)

    @cached_property
    def values(self) -> dict[str, np.ndarray]:
        """Values of the episodes by measure, (turns, players, players, episodes).

        The first player has the seat whose turn it is, the second all others. NaN where
        they cannot play together.
        """
        found = {tuple(each.players.values()): each for each in self.pairings}
        count, episodes = len(self.players), self.settings["episodes"]
        shape = len(self.turns), count, count, episodes
        values = {measure: np.full(shape, math.nan) for measure in self.measures}
        for place in np.ndindex(shape[:3]):
            turn, (row, column) = self.turns[place[0]], place[1:]
            sitting = [row if seat == turn else column for seat in self.seats]
            pairing = found.get(tuple(self.players[i] for i in sitting))
            if pairing is not None:
                for measure, column in self._compared(pairing, turn).items():
                    values[measure][place] = column
        return values

    def _compared(self, pairing: Pairing, turn: str) -> dict[str, np.ndarray]:
        if not self.is_divided:
            return {name: np.array(pairing.columns[name]) for name in self.measures}
        scores = {s: np.array(pairing.columns[f"{s}/score"]) for s in self.seats}
        more = scores.pop(turn) - np.max(list(scores.values()), axis=0)
        return {"points": (np.sign(more) + 1.0) / 2.0, "score": more}

    @cached_property
    def matrices(self) -> dict[str, dict[str, dict[str, Statistic]]]:
        """By measure, row and column, how the row's player did with the column's.

        With two seats the row's player is in the first. With more, it is the mean over
        the seats that it took in turn.
        """
        return {
            measure: {
                row: {
                    column: self._statistic(measure, self._shown(measure)[:, i, j])
                    for j, column in enumerate(self.players)
                }
                for i, row in enumerate(self.players)
            }
            for measure in self.measures
        }

    @cached_property
    def standings(self) -> dict[str, Standing]:
        """Results of each player, by its name."""
        return {name: self._standing(i) for i, name in enumerate(self.players)}

    @cached_property
    def ratings(self) -> dict[str, Statistic]:
        """Ratings by player on Elo's scale (Bradley and Terry); only of opponents."""
        means, errors = rated(self._points)
        ends = [_Z * (math.nan if self.is_one_episode else each) for each in errors]
        return {
            name: Statistic(*map(float, (mean, mean - end, mean + end, mean, mean)))
            for name, mean, end in zip(self.players, means, ends, strict=True)
        }

    @cached_property
    def cycles(self) -> list[tuple[str, str, str]]:
        """Triples of players in which each beats the next, and the last the first.

        A player beats another if the interval of its points against it is above a half.
        """
        if not self.is_divided:
            return []
        count = len(self.players)
        beats = np.zeros((count, count), bool)
        for i, j in np.ndindex(count, count):
            taken = self._statistic("points", self.values["points"][:, i, j])
            least = taken.mean if self.is_one_episode else taken.low
            beats[i, j] = i != j and least > 0.5
        return cyclic_triples(self.players, beats)

    @cached_property
    def conventions(self) -> dict[str, list[list[str]]]:
        """Partners that need the same response, by the seat that responds.

        The response to a partner is its own policy in that seat. Each list begins with
        a player whose response reaches a performance of `SERVED` with all that follow.
        So the first players of the lists need different responses. A player whose
        response fails even with itself is alone. Empty if the players are opponents.
        """
        if self.is_divided:
            return {}
        found = {}
        served = self.values["performance"].mean(-1) >= SERVED
        for turn, by_answer in zip(self.turns, served, strict=True):
            lists: dict[int, list[str]] = {}
            for j, name in enumerate(self.players):
                first = next((i for i in lists if by_answer[i, j]), j)
                lists.setdefault(first, []).append(name)
            found[turn] = list(lists.values())
        return found

    @cached_property
    def group_means(self) -> dict[str, dict[str, Statistic]]:
        """Means of training runs of one kind, by the kind and the name of the mean.

        For opponents it is their `rating`. Else, for each measure, such as
        `completion`: `completion of self-play`, `completion of cross-play` with one
        another, and their difference, `completion lost`. The intervals are over runs.
        """
        return {
            name: self._group([self.players.index(run) for run in runs])
            for name, runs in self.groups.items()
        }

    def _shown(self, measure: str) -> np.ndarray:
        """Return the values in a matrix: of two seats, the first player's turns."""
        values = self.values[measure]
        return values[:1] if len(self.seats) == 2 else values

    def _statistic(self, measure: str, values: np.ndarray) -> Statistic:
        means = _mean(values)[: 1 if self.is_one_episode else None]
        return Statistic.of(list(means), is_share=is_share(measure))

    def _over_others(
        self, measure: str, values: np.ndarray, own: np.ndarray | None = None
    ) -> Statistic:
        """Return the statistic of a player's mean over (seats, others, episodes).

        With `own`, its values with itself, (1, episodes), that of the difference.
        """
        means = _mean(values)
        if len(means) == 1:  # Nothing is known of others, so it is over episodes.
            less = means if own is None else own - means
            return self._statistic(measure if own is None else "", less)
        of_each = _mean(_mean(np.moveaxis(values, -1, 0)))
        if own is not None:
            return Statistic.of(list(float(_mean(own[0])) - of_each))
        return Statistic.of(list(of_each), is_share=is_share(measure))

    def _standing(self, i: int) -> Standing:
        others = np.arange(len(self.players)) != i
        cross = {name: all_[:, i, others] for name, all_ in self.values.items()}
        own = {name: all_[:1, i, i] for name, all_ in self.values.items()}
        means = {
            j: [float(np.nanmean(v[:, i, j])) for v in self.values.values()]
            for j in np.flatnonzero(others)
            if not np.isnan(self.values[self.measures[0]][:, i, j]).all()
        }
        worst = min(means, key=means.__getitem__, default=None)
        places = {turn: slice(s, s + 1) for s, turn in enumerate(self.turns)}
        standing = Standing(
            self_play={name: self._statistic(name, rows) for name, rows in own.items()},
            cross_play={n: self._over_others(n, rows) for n, rows in cross.items()},
            gap={},
            by_seat={
                turn: {n: self._over_others(n, rows[s]) for n, rows in cross.items()}
                for turn, s in places.items()
            },
            worst=None if worst is None else self.players[worst],
        )
        if not self.is_divided:
            less = {n: self._over_others(n, r, own[n]) for n, r in cross.items()}
            return replace(standing, gap=less)
        points = cross["points"]
        wins, draws, losses = (int((points == each).sum()) for each in (1.0, 0.5, 0.0))
        rating = self.ratings[self.players[i]]
        return replace(standing, wins=wins, draws=draws, losses=losses, rating=rating)

    @property
    def _points(self) -> np.ndarray:
        own = self._shown("points")
        lost = np.swapaxes(1.0 - own, 1, 2)
        return (np.nan_to_num(own).sum(0) + np.nan_to_num(lost).sum(0)).sum(-1)

    def _group(self, runs: list[int]) -> dict[str, Statistic]:
        if self.is_divided:
            ratings = [self.ratings[self.players[i]].mean for i in runs]
            return {"rating": Statistic.of(ratings)}
        means = {}
        for measure, values in self.values.items():
            cells = _mean(_mean(np.moveaxis(values[:, runs][:, :, runs], -1, 0)))
            whole = _selves_and_others(cells)
            left = [
                _selves_and_others(np.delete(np.delete(cells, i, 0), i, 1))
                for i in range(len(runs))
            ]
            for i, name in enumerate(("of self-play", "of cross-play", "lost")):
                is_mean = is_share(measure) and name != "lost"
                own = [each[i] for each in left]
                found = jackknifed(own, whole[i], is_share=is_mean)
                ends = found.low, found.high
                mean = Statistic(whole[i], *ends, whole[i], whole[i])
                means[f"{measure} {name}"] = mean
        return means

    def to_json(self) -> str:
        """Return everything as JSON, with null for NaN."""
        names = [each.name for each in fields(self)]
        names += ["measures", "matrices", "standings", "group_means"]
        names.append("cycles" if self.is_divided else "conventions")
        return to_json({name: getattr(self, name) for name in names}, indent=1)

    def to_csv(self) -> str:
        """Return the matrices as rows: seat, its player, the others', and measures."""
        ends = ("", "_low", "_high")
        names = [f"{measure}{end}" for measure in self.measures for end in ends]
        rows = []
        for s, i, j in np.ndindex(self._shown(self.measures[0]).shape[:3]):
            start = self.turns[s], self.players[i], self.players[j]
            row: list[Any] = [*start, self.settings["episodes"]]
            for measure in self.measures:
                one = self._statistic(measure, self.values[measure][[s], i, j])
                row += [one.mean, one.low, one.high]
            rows.append(row)
        return to_csv(["seat", "player", "others", "episodes", *names], rows)


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Return short names of players for tables, by their names.

    They are the last parts of paths, and the styles of experts, where these differ.
    """
    bare = {
        name: name.removesuffix("/policy.safetensors").removesuffix(".safetensors")
        for name in names
    }
    ends = {
        name: path if "=" in path else path.rpartition("/")[2].removeprefix("expert:")
        for name, path in bare.items()
    }
    return ends if len({*ends.values()}) == len(ends) else bare


def format_measure(measure: str, value: float) -> str:
    """Return a number for people, such as "97 %"; a dash for NaN."""
    if is_share(measure):
        return "-" if math.isnan(value) else f"{100 * value:.0f} %"
    return format_number(value, digits=1 if abs(value) < 100 else 0)


def format_estimate(measure: str, statistic: Statistic) -> str:
    """Return a mean and its interval for people, such as "97 % (84 to 100)"."""
    mean = format_measure(measure, statistic.mean)
    if math.isnan(statistic.low):
        return mean
    ends = (format_measure(measure, end) for end in (statistic.low, statistic.high))
    low, high = (end.removesuffix(" %") for end in ends)
    return f"{mean} ({low} to {high})"


def _mean(values: np.ndarray) -> np.ndarray:
    known = ~np.isnan(values)
    total = np.where(known, values, 0.0).sum(0)
    return np.where(known.any(0), total / np.maximum(known.sum(0), 1), math.nan)


def _selves_and_others(cells: np.ndarray) -> tuple[float, float, float]:
    """Return the means of self-play and of cross-play in (runs, runs), and the gap."""
    is_self = np.eye(len(cells), dtype=bool)
    own, others = (float(_mean(cells[which])) for which in (is_self, ~is_self))
    return own, others, own - others
