"""Styles of experts: each does the task with itself, and some with nobody else."""

import pytest

import collaborative_gym as cg
from collaborative_gym.tasks.pass_ import Pass

PASS = "PassTaskSawyers-v0", "PassTaskJacoSawyer-v0"
STYLES = [
    ("PokeTaskSawyers-v0", "expert:ring-moves"),
    ("LiftTaskSawyers-v0", "expert:first-leads"),
    ("LiftTaskSawyers-v0", "expert:second-leads"),
    ("LiftTaskSawyers-v0", "expert:slow"),
    *((each, f"expert:{style}") for each in PASS for style in Pass.styles),
    ("PassTaskSawyers-v0", "expert:late"),
]

STRANGERS = [
    ("PokeTaskSawyers-v0", "expert:ring-moves", "expert"),
    ("LiftTaskSawyers-v0", "expert:second-leads", "expert:first-leads"),
    ("PassTaskSawyers-v0", "expert:nearer", "expert"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "style"), STYLES)
def test_each_style_does_the_task_with_itself(env_id, style):
    assert cg.evaluate(env_id, style, episodes=16).completion.mean >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "first", "second"), STRANGERS)
def test_styles_need_different_answers(env_id, first, second):
    team = {"robot_1": first, "robot_2": second}
    assert cg.evaluate(env_id, team, episodes=8).completion.mean <= 0.25
