"""The picture of a tournament."""

import pytest

pytest.importorskip("matplotlib", reason="needs the extra train")

import collaborative_gym as cg
from collaborative_gym.tournaments.picture import draw_tournament, tournament_figure


def test_partners_are_compared_by_three_measures(carry, tmp_path):
    played = cg.tournament(carry(), ["expert", "idle"], episodes=2, num_threads=1)
    titles = [axes.get_title() for axes in tournament_figure(played).axes]
    assert titles == ["completion (%)", "performance (%)", "return"]
    first = tournament_figure(played).axes[0]
    assert (first.get_ylabel(), first.get_xlabel()) == ("robot_1", "robot_2")
    assert [text.get_text() for text in first.texts] == ["100", "100", "100", "0"]
    for suffix in ("png", "svg"):
        draw_tournament(played, tmp_path / f"played.{suffix}")
        assert (tmp_path / f"played.{suffix}").stat().st_size > 5000


def test_opponents_are_sorted_by_rating(duel):
    played = cg.tournament(duel, ["idle", "random"], episodes=8, num_threads=1)
    matrix, ratings = tournament_figure(played).axes
    best = max(played.players, key=lambda name: played.ratings[name].mean)
    assert matrix.get_yticklabels()[0].get_text() == best
    assert ratings.get_title() == "rating, with 95 % intervals"
