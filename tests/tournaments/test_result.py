"""Matrices, standings and intervals of results that are made up."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from collaborative_gym.evaluation.intervals import wilson
from collaborative_gym.tournaments.result import (
    Pairing,
    Tournament,
    format_estimate,
    format_measure,
    short_names,
)


def team_of(players, completion, episodes=8, groups=None, seats=("robot_1", "robot_2")):
    """Return a tournament of two robots, from the completion of pairs.

    Args:
      players: their names.
      completion: by the pair, a share, or what each episode had.
      episodes: of each pairing.
      groups: of the players.
      seats: their names.
    """
    pairings = []
    for (one, other), share in completion.items():
        met = np.arange(episodes) < share * episodes if np.isscalar(share) else share
        column = tuple(map(float, met))
        columns = dict.fromkeys(("completion", "performance", "return"), column)
        columns |= {"episode": tuple(range(episodes)), "diverged": (0.0,) * episodes}
        pairings.append(Pairing(dict(zip(seats, (one, other), strict=True)), columns))
    return Tournament(
        "Toy",
        {"episodes": episodes, "seed": 0},
        {seat: (seat,) for seat in seats},
        seats,
        tuple(players),
        tuple(pairings),
        groups or {},
    )


def games_of(players, scores):
    """Return a tournament of two sides, from both scores of each episode of pairs."""
    pairings = []
    for (one, other), rows in scores.items():
        first, second = (tuple(map(float, each)) for each in zip(*rows, strict=True))
        columns = {"side_1/score": first, "side_2/score": second}
        columns |= {"episode": tuple(range(len(rows))), "diverged": (0.0,) * len(rows)}
        pairings.append(Pairing({"side_1": one, "side_2": other}, columns))
    seats = {"side_1": ("robot_1",), "side_2": ("robot_2",)}
    settings = {"episodes": len(pairings[0].columns["episode"]), "seed": 0}
    return Tournament(
        "Game", settings, seats, tuple(seats), tuple(players), tuple(pairings)
    )


@pytest.fixture
def strangers():
    """Return three players, of whom b gets on with a as the second robot alone."""
    pairs = dict.fromkeys([(x, y) for x in "abc" for y in "abc"], 0.0)
    return team_of("abc", pairs | {(x, x): 1.0 for x in "abc"} | {("a", "b"): 0.5})


def test_the_matrix_has_the_first_robots_players_as_rows(strangers):
    completion = strangers.matrices["completion"]
    assert completion["a"]["b"].mean == 0.5 and completion["b"]["a"].mean == 0.0
    assert (completion["a"]["a"].low, completion["a"]["a"].high) == wilson(1.0, 8)
    assert completion["a"]["a"].low < 0.7


def test_standings_tell_self_play_cross_play_and_the_worst_partner(strangers):
    a, b = strangers.standings["a"], strangers.standings["b"]
    assert a.self_play["completion"].mean == 1.0
    # Of four pairings with others, in one half of the episodes.
    assert a.cross_play["completion"].mean == 0.125
    assert a.gap["completion"].mean == 0.875
    assert a.by_seat["robot_1"]["completion"].mean == 0.25
    assert a.by_seat["robot_2"]["completion"].mean == 0.0
    assert b.by_seat["robot_2"]["completion"].mean == 0.25
    assert (a.worst, b.worst) == ("c", "c") and a.rating is None


def test_the_worst_partner_is_found_where_completion_hides_it():
    pairs = {(x, y): 1.0 for x in "abc" for y in "abc"}
    played = team_of("abc", pairs)
    columns = dict(played.pairings[1].columns) | {"performance": (0.01,) * 8}
    worse = replace(played.pairings[1], columns=columns)
    pairings = played.pairings[0], worse, *played.pairings[2:]
    assert replace(played, pairings=pairings).standings["a"].worst == "b"


def test_partners_are_kept_apart_by_the_answer_that_they_need(strangers):
    # b as the second robot is served by a in one half of the episodes, too few.
    apart = [["a"], ["b"], ["c"]]
    assert strangers.conventions == {"robot_1": apart, "robot_2": apart}
    pairs = dict.fromkeys([(x, y) for x in "abcd" for y in "abcd"], 0.0)
    # a as robot_1 serves c; b does, too, but comes later. d fails with everybody.
    pairs |= {(x, x): 1.0 for x in "abc"} | {("a", "c"): 1.0, ("b", "c"): 1.0}
    played = team_of("abcd", pairs)
    assert played.conventions["robot_1"] == [["a", "c"], ["b"], ["d"]]
    # As robot_2 only c serves a and b.
    assert played.conventions["robot_2"] == [["a"], ["b"], ["c"], ["d"]]
    pairings = [each for each in played.pairings if each.title != "a + c"]
    alone = replace(played, pairings=tuple(pairings))
    assert alone.conventions["robot_1"] == [["a"], ["b", "c"], ["d"]]
    assert not games_of("ab", {("a", "b"): [(1, 0)]}).conventions


def test_what_cannot_be_played_counts_nowhere(strangers):
    pairings = [p for p in strangers.pairings if p.players["robot_2"] != "c"]
    alone = replace(strangers, pairings=tuple(pairings))
    assert np.isnan(alone.matrices["completion"]["a"]["c"].mean)
    standing = alone.standings["c"]
    assert np.isnan(standing.self_play["completion"].mean)
    assert standing.cross_play["completion"].mean == 0.0
    assert np.isnan(standing.by_seat["robot_2"]["completion"].mean)
    assert alone.standings["a"].by_seat["robot_1"]["completion"].mean == 0.5
    assert json.loads(alone.to_json())["matrices"]["return"]["a"]["c"]["mean"] is None


def test_means_over_partners_have_intervals_over_partners():
    # Each pairing is the same in all episodes, so a bootstrap of these sees nothing.
    pairs = {(x, y): float(x == y) for x in "abcde" for y in "abcde"}
    pairs |= {("a", "b"): 1.0, ("b", "a"): 1.0}
    played = team_of("abcde", pairs, 16)
    cross = played.standings["a"].cross_play["completion"]
    assert format_estimate("completion", cross) == "25 % (5 to 70)"
    gap = played.standings["a"].gap["completion"]
    # Over four partners, t is 3.182.
    assert gap.high - gap.mean == pytest.approx(3.182 * 0.5 / 2.0)
    seen = played.standings["c"].cross_play
    assert (seen["completion"].low, seen["completion"].high) == wilson(0.0, 4)
    assert np.isnan(seen["return"].low)
    # With one partner alone, they are over episodes.
    only = team_of("ab", {(x, y): 0.5 for x in "ab" for y in "ab"}, 16)
    ends = only.standings["a"].cross_play["completion"]
    assert (ends.low, ends.high) == wilson(0.5, 16)


def test_who_has_won_everything_is_rated_with_an_interval():
    scores = {("a", "b"): [(1, 0)] * 16, ("b", "a"): [(0, 1)] * 16}
    scores |= {(x, x): [(0, 0)] * 16 for x in "ab"}
    rating = games_of("ab", scores).ratings["a"]
    assert rating.low < rating.mean - 50.0 and rating.mean + 50.0 < rating.high


def test_a_group_is_as_sure_as_its_runs_are_alike():
    alike = {(x, y): 0.5 for x in "abcd" for y in "abcd"}
    told = team_of("abcd", alike, 200, {"runs": tuple("abcd")}).group_means["runs"]
    assert told["completion of cross-play"].mean == 0.5
    assert told["completion lost"].mean == 0.0
    assert np.isnan(told["completion lost"].high)
    cross = told["completion of cross-play"]
    assert (cross.low, cross.high) == wilson(0.5, 4)
    differing = alike | {(x, y): float("a" in (x, y)) for x, y in alike if x != y}
    told = team_of("abcd", differing, 200, {"runs": tuple("abcd")}).group_means["runs"]
    wide = told["completion of cross-play"]
    assert wide.mean == 0.5 and wide.low < 0.1 and wide.high > 0.9


def test_wins_draws_and_losses_are_counted_from_both_sides():
    win, draw, loss = (2, 1), (1, 1), (0, 3)
    played = games_of(
        "ab",
        {
            ("a", "a"): [draw] * 4,
            ("a", "b"): [win, win, win, draw],
            ("b", "a"): [loss, loss, draw, win],
            ("b", "b"): [win] * 4,
        },
    )
    a, b = played.standings["a"], played.standings["b"]
    assert (a.wins, a.draws, a.losses) == (5, 2, 1) == (b.losses, b.draws, b.wins)
    assert a.cross_play["points"].mean == 0.75
    assert a.cross_play["score"].mean == (3 + 5) / 8
    assert a.by_seat["side_1"]["points"].mean == 3.5 / 4
    matrix = played.matrices["points"]
    assert matrix["a"]["b"].mean == 3.5 / 4 and matrix["b"]["a"].mean == 1.5 / 4
    # The side that plays first has won all episodes of b against itself.
    assert matrix["b"]["b"].mean == 1.0
    difference = played.ratings["a"].mean - played.ratings["b"].mean
    assert 100 < difference < 400 * np.log10(3)
    assert played.ratings["a"].low < played.ratings["a"].mean < played.ratings["a"].high


def test_a_cycle_is_told_only_where_it_is_sure():
    def played(episodes):
        beats = dict.fromkeys([("a", "b"), ("b", "c"), ("c", "a")], [(1, 0)] * episodes)
        beats |= {(y, x): [(0, 1)] * episodes for x, y in beats}
        beats |= {(x, x): [(0, 0)] * episodes for x in "abc"}
        return games_of("abc", beats)

    assert played(10).cycles == [("a", "b", "c")]
    assert not played(1).cycles
    ratings = [rating.mean for rating in played(10).ratings.values()]
    np.testing.assert_allclose(ratings, 1500.0)


def test_one_episode_has_no_interval():
    rows = dict.fromkeys([(x, y) for x in "ab" for y in "ab"], 1.0)
    played = team_of("ab", rows)
    alike = [
        replace(p, columns={k: v for k, v in p.columns.items() if k != "episode"})
        for p in played.pairings
    ]
    played = replace(played, pairings=tuple(alike))
    assert played.is_one_episode
    assert np.isnan(played.matrices["completion"]["a"]["b"].low)
    assert np.isnan(played.standings["a"].cross_play["return"].high)


def test_files_hold_everything(strangers):
    told = json.loads(strangers.to_json())
    assert told["matrices"]["completion"]["a"]["b"]["mean"] == 0.5
    assert told["standings"]["a"]["worst"] == "c"
    assert told["conventions"]["robot_2"] == [["a"], ["b"], ["c"]]
    assert len(told["pairings"][0]["columns"]["return"]) == 8
    rows = list(csv.DictReader(io.StringIO(strangers.to_csv())))
    assert len(rows) == 9
    assert (rows[1]["player"], rows[1]["others"], rows[1]["completion"]) == (
        "a",
        "b",
        "0.5",
    )


def test_names_are_short_where_they_stay_apart():
    names = ["runs/a/policy.safetensors", "runs/b.safetensors", "expert", "expert:late"]
    assert list(short_names(names).values()) == ["a", "b", "expert", "late"]
    twice = ["one/a", "two/a.safetensors"]
    assert list(short_names(twice).values()) == ["one/a", "two/a"]
    assert format_measure("return", -1234.5) == "-1234"
    assert format_measure("completion", float("nan")) == "-"
