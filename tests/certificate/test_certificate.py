"""Bounds, tables and statements."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from collaborative_gym.certificate.budget import Budget
from collaborative_gym.certificate.report import TEAM, Certificate, Trial, upper_bound
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.registry import make_task


@pytest.mark.parametrize(
    ("completed", "episodes", "expected"),
    # At these shares a binomial sum in exact fractions is 0.05.
    [
        (0, 500, 1 - 0.05 ** (1 / 500)),
        (0, 1, 0.95),
        (1, 500, 0.009453),
        (5, 10, 0.777559),
        (250, 500, 0.537708),
        (7, 7, 1.0),
    ],
)
def test_the_bound_is_exact(completed, episodes, expected):
    assert upper_bound(completed, episodes) == pytest.approx(expected, abs=1e-5)


def test_a_row_tells_the_best_and_the_surest():
    idle = "robot_1", "idle", 0.0
    frozen = "robot_2", "frozen", 0.5
    trials = (
        Trial(*idle, "expert", 500, 0, 0.5),
        Trial(*frozen, "expert", 400, 10, 0.2),
        Trial(*idle, "search", 32, 0, 0.4, converged=True),
        Trial(*frozen, "search", 32, 8, 0.1, converged=False),
        Trial(*TEAM, "replay", 500, 5, 0.3),
    )
    identity = Identity.of(make_task("Pass", ("panda", "jaco"))).to_dict()
    certificate = Certificate("Some-v0", {"identity": identity}, trials)
    assert certificate.best == {idle: trials[0], frozen: trials[3], TEAM: trials[4]}
    table = certificate.to_markdown()
    assert "| robot_1 idle | 0 of 500 | - | 0 of 32 | - | - | 0.6 % | 0.40 |" in table
    assert "| robot_2 frozen at 50 % | 10 of 400 | - | 8 of 32† | - | - | 4" in table
    still = "while one arm is still from"
    first = (
        f"\n\nPass with panda, jaco: {still} the start on, the others complete 0 of 500"
    )
    assert f"{first} starts (up to 0.6 %); {still} 50 % of the way on" in table
    frozen = "10 of 400 starts (robot_2 frozen at 50 %, up to 4.2 %)"
    assert f"{frozen}, and 8 of 32 by a motion searched for each; a team that" in table
    assert "; a team that observes nothing completes 5 of 500 (up to 2.1 %)" in table
    assert (
        "| none: the team is blind | - | - | - | 5 of 500 | - | 2.1 % | 0.30 |" in table
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("episodes", 0),
        ("episodes", 1.5),
        ("candidates", 3),
        ("knots", 1),
        ("rounds", 0),
        ("searched_starts", -1),
        ("ppo_steps", -1),
        ("fractions", (0.0,)),
        ("fractions", (1.0,)),
        ("fractions", 0.5),
    ],
)
def test_a_budget_has_bounds(name, value):
    with pytest.raises((TypeError, ValueError), match=name):
        Budget(**{name: value})


def test_a_budget_of_numpys_numbers_can_be_written():
    budget = Budget(episodes=np.int64(4), fractions=np.array([0.5, 0.25]))
    assert json.loads(json.dumps(asdict(budget)))["fractions"] == [0.25, 0.5]
    assert budget == Budget(episodes=4, fractions=(0.25, 0.5))
