"""Who plays, how it stands, and who has won."""

import numpy as np

from collaborative_gym.policies.match import name_players, result, standing

ONE = {"side_1": ("robot_1", "robot_2")}
TWO = {"side_1": ("robot_1",), "side_2": ("robot_2",)}
FOUR = {"side_1": ("robot_1", "robot_2"), "side_2": ("robot_3", "robot_4")}


def infos(*points, ended=False, success=False):
    score = {f"side_{i + 1}": np.array([own]) for i, own in enumerate(points)}
    return {
        "success": np.array([success]),
        "ended": np.array([ended]),
        "metrics": {"score": score},
    }


def test_players_are_named_by_side():
    assert name_players("runs/league/main", ONE) == {"side_1": "main"}
    mixed = {"robot_1": "idle", "robot_2": "runs/main"}
    assert name_players(mixed, ONE) == {"side_1": "robot_1 idle, robot_2 main"}
    named = {"side_1": "robot_1 idle", "side_2": "robot_2 main"}
    assert name_players(mixed, TWO) == named
    coloured = {"side_1": "robot_1 (red) main", "side_2": "robot_2 (blue) main"}
    assert name_players("runs/main", TWO, ("red", "blue")) == coloured
    teams = {"side_1": "robot_1+robot_2 expert", "side_2": "robot_3+robot_4 expert"}
    assert name_players("expert", FOUR) == teams


def test_a_match_is_told_with_its_score_and_winner():
    players = name_players({"robot_1": "expert", "robot_2": "runs/main"}, TWO)
    assert standing(players, infos(2.0, 1.0)) == "robot_1 expert 2 : 1 robot_2 main"
    told = standing(players, infos(0.0, 1.0, ended=True))
    assert told == "robot_1 expert 0 : 1 robot_2 main\nrobot_2 main wins"
    assert result(players, infos(1.0, 1.0)) == "draw"


def test_one_side_is_told_with_its_success():
    players = name_players("expert", ONE)
    assert standing(players, infos()) == "expert"
    assert standing(players, infos(success=True)) == "expert\nsuccess"
