"""Report cards: what is on the page, in the numbers and in the pictures."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.cards import ReportCard, draw_card, report_card
from collaborative_gym.evaluation.play import DISTURBANCES, measure_robustness
from collaborative_gym.tasks.registry import disturbed
from collaborative_gym.tasks.task import RANDOMIZATIONS

SMALL = {"episodes": 3, "disturbed": 2, "paired": 2, "num_threads": 1}


@pytest.fixture
def card(carry):
    told = []
    card = report_card(carry(), ["expert", "idle"], **SMALL, on_progress=told.append)
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)
    return card


def test_a_card_is_made_of_evaluations_and_a_tournament(card, carry):
    alone = cg.evaluate(carry(), "idle", episodes=3, num_threads=1)
    assert card.reports["idle"].to_csv() == alone.to_csv()
    assert list(card.robustness) == list(card.reports) == ["expert", "idle"]
    assert card.cross_play.players == ("expert", "idle")
    assert card.cross_play.settings["episodes"] == 2
    told = json.loads(card.to_json())
    assert told["policies"]["expert"]["completion"]["mean"] == 1.0
    assert told["robustness"]["expert"].keys() == DISTURBANCES.keys()
    assert told["cross_play"]["players"] == ["expert", "idle"]


def test_the_page_tells_what_was_found(card):
    page = card.to_markdown(["a.png"])
    assert page.startswith(
        "# Carry with 2 panda\n\n![a.png](a.png)\n\n## expert\n\n3 episodes"
    )
    # Wilson's interval, not the bootstrap's.
    assert "| completion | 100 % (43.9 to 100) | 100 % | 100 % |" in page
    for name in ("clearance", "torque limit share", "energy", "action change"):
        assert f"\n| {name} | " in page
    for name in DISTURBANCES:
        assert f"\n| {name} | " in page.partition("## Robustness")[2]
    assert "| robot_1 / robot_2 | expert | idle |" in page
    assert "\n| expert | 100 % (34 to 100) | " in page.partition("**completion**")[2]
    assert page.rstrip().endswith(f"mujoco {mujoco.__version__}.")


def test_each_disturbance_is_measured_alone(carry):
    task = carry()
    reports = measure_robustness(task, "expert", episodes=2, num_threads=1)
    for name, fields in DISTURBANCES.items():
        changes = {field: getattr(RANDOMIZATIONS["hard"], field) for field in fields}
        own = disturbed(task, **changes)
        report = cg.evaluate(own, "expert", episodes=2, num_threads=1)
        assert reports[name].to_csv() == report.to_csv()
    assert own.config.randomization == RANDOMIZATIONS["hard"]
    assert reports["all"].to_csv() != reports["none"].to_csv()
    # Experts are shown no noise.
    assert reports["noise"].to_csv() == reports["none"].to_csv()


def test_what_is_not_asked_for_is_left_out(carry):
    options = {**SMALL, "disturbed": 0, "paired": 0}
    card = report_card(carry(), {"me": "expert"}, **options)
    assert card.cross_play is None and not card.robustness
    page = card.to_markdown()
    assert "## me" in page and "Robustness" not in page and "Cross-play" not in page


def test_one_deterministic_episode_has_no_interval(card):
    report = card.reports["expert"]
    first = report.episodes[0]
    alike = replace(report, episodes=(first, {**first, "episode": 1}))
    page = ReportCard("Carry", {"expert": alike}, {}, None).to_markdown()
    assert "one deterministic episode" in page


def test_opponents_are_told_by_side(duel):
    card = report_card(duel, ["expert", "random"], **SMALL)
    page = card.to_markdown()
    assert "| completion of side_1 |" in page and "**points**" in page


@pytest.mark.parametrize(
    ("policies", "message"),
    [([], "one or more"), (["idle", "idle"], "each once"), ("idle", "a list")],
)
def test_wrong_policies_are_refused(carry, policies, message):
    with pytest.raises((TypeError, ValueError), match=message):
        report_card(carry(), policies, **SMALL)


def test_actions_that_change_more_are_told(carry):
    def alternating(observations):
        steps.append(1 - 2 * (len(steps) % 2))
        moves = np.full((1, 8), 0.5 * steps[-1])
        return dict.fromkeys(observations, moves)

    steps: list[int] = []
    report = cg.evaluate(carry(), alternating, episodes=2, num_threads=1, num_envs=1)
    # 0.5 from rest at first, and then from one side to the other, 12 steps in all.
    expected = (0.5 + 11 * 1.0) / 12
    assert report.strain["action_change"].mean == pytest.approx(expected)
    still = cg.evaluate(carry(), "idle", episodes=2, num_threads=1)
    assert still.strain["action_change"].worst == 0.0


def test_the_picture_is_drawn(card, duel, tmp_path):
    pytest.importorskip("matplotlib")
    chart = tmp_path / "a.svg"
    draw_card(card, chart)
    drawn = chart.read_text()
    assert drawn.startswith("<?xml") and math.isfinite(len(drawn))
    draw_card(report_card(duel, ["expert"], **{**SMALL, "disturbed": 0}), chart)
