"""The thesis's eight environments stand, aim and measure as they do there."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.scene import Scene
from collaborative_gym.tasks.registry import get_env, make_task

# Position of the base and its yaw in degrees, of robot_1 and robot_2.
BASES = {
    "PokeTaskSawyers-v0": (((0, -1, 1), 60), ((0, 1, 1), -60)),
    "PokeTaskPandaSawyer-v0": (((0, -1, 0.65), 60), ((0, 0.8, 1), -60)),
    "LiftTaskSawyers-v0": (((0.22, -1.2, 1), 90), ((-0.22, 1.2, 1), -90)),
    "LiftTaskJacos-v0": (((0, -0.9, 0.65), 90), ((0, 0.9, 0.6), -90)),
    "BalanceTaskSawyers-v0": (((0, -1.8, 1), 90), ((0, 1.8, 1), -90)),
    "BalanceTaskJacoSawyer-v0": (((0, -1.4, 0.65), 90), ((0, 1.8, 1), -90)),
    "PassTaskSawyers-v0": (((0, -0.7, 1), 0), ((0, 0.7, 1), 0)),
    "PassTaskJacoSawyer-v0": (((0, -0.7, 1), 0), ((0.55, 0.7, 0.62), 0)),
}
ROBOTS = {
    "PokeTaskSawyers-v0": ("sawyer", "sawyer"),
    "PokeTaskPandaSawyer-v0": ("panda", "sawyer"),
    "LiftTaskSawyers-v0": ("sawyer", "sawyer"),
    "LiftTaskJacos-v0": ("jaco", "jaco"),
    "BalanceTaskSawyers-v0": ("sawyer", "sawyer"),
    "BalanceTaskJacoSawyer-v0": ("jaco", "sawyer"),
    "PassTaskSawyers-v0": ("sawyer", "sawyer"),
    "PassTaskJacoSawyer-v0": ("sawyer", "jaco"),
}
SETTINGS = {
    "PokeTaskSawyers-v0": {},
    "PokeTaskPandaSawyer-v0": {},
    "LiftTaskSawyers-v0": {"success_radius": 0.15, "picking_threshold": 0.02},
    "LiftTaskJacos-v0": {"success_radius": 0.15, "picking_threshold": 0.04},
    "BalanceTaskSawyers-v0": {"success_distance": 0.09, "push": 10.0},
    "BalanceTaskJacoSawyer-v0": {"success_distance": 0.09, "push": 0.0},
    "PassTaskSawyers-v0": {
        "success_radius": 0.12,
        "picking_threshold": 0.03,
        "handover_threshold": 0.05,
    },
    "PassTaskJacoSawyer-v0": {
        "success_radius": 0.12,
        "picking_threshold": 0.03,
        "handover_threshold": 0.045,
    },
}


def test_the_environments_are_the_thesis_eight_and_our_own():
    own = {"BalancePathSawyers-v0", "BalancePathJacoSawyer-v0"}
    own |= {f"Hockey{arms}-v0" for arms in ("Pandas", "Sawyers", "PandaSawyer")}
    own |= {"HockeyDoubles-v0"}
    own |= {f"Tug{arms}-v0" for arms in ("Pandas", "Sawyers", "PandaSawyer")}
    own |= {f"Lift{team}-v0" for team in ("Mixed3", "Mixed4")}
    own |= {f"LiftPandas{count}-v0" for count in (2, 3, 4, 6, 8)}
    own |= {f"BalancePath{team}-v0" for team in ("Mixed3", "Pandas3", "Pandas4")}
    own |= {"BalancePathPandas6-v0"}
    own |= {"SortMixed3-v0", *(f"SortPandas{count}-v0" for count in (2, 4, 8))}
    own |= {f"Pass{grasp}Sawyers-v0" for grasp in ("Pinch", "Friction")}
    own |= {"AssembleMixed3-v0", "AssemblePandas3-v0"}
    own |= {"PassMixed3-v0", *(f"PassPandas{count}-v0" for count in (3, 4, 6))}
    own |= {"ReachMixed3-v0", *(f"ReachPandas{count}-v0" for count in (2, 4, 8))}
    assert set(cg.list_envs()) == {*BASES, *own}


@pytest.mark.parametrize("env_id", BASES)
def test_robots_placements_and_settings(env_id):
    task = make_task(env_id)
    assert get_env(env_id).robots == ROBOTS[env_id]
    placed = task.placements.values()
    for placement, (position, yaw) in zip(placed, BASES[env_id], strict=True):
        np.testing.assert_allclose(placement.position, position, atol=1e-3)
        assert placement.yaw == pytest.approx(np.radians(yaw))
    assert task.config.max_episode_steps == 200
    for name, value in SETTINGS[env_id].items():
        assert getattr(task.config, name) == value


@pytest.mark.parametrize(("env_id", "height"), [("Sawyers", 1.5), ("Jacos", 1.2)])
def test_pots_start_and_targets(env_id, height):
    env = cg.make_vec(f"LiftTask{env_id}-v0", 1, randomization="paper", num_threads=1)
    env.reset(seed=0)
    np.testing.assert_allclose(env.facts.pot[0][0], (0, 0, 0.7), atol=1e-3)
    np.testing.assert_allclose(env.facts.target[0], (0, 0, height))
    for agent, side in (("robot_1", -1), ("robot_2", 1)):
        handle = env.facts.handles[agent][0][0] - env.facts.pot[0][0]
        np.testing.assert_allclose(handle, (0, side * 0.14, 0.05), atol=1e-6)


def test_completion_and_performance_are_counted_as_in_the_thesis():
    for env_id in BASES:
        task = make_task(env_id)
        is_balance = env_id.startswith("Balance")
        assert task.success_after == (5 if is_balance else 0)
        assert task.performance_from_start == is_balance


def test_robots_and_placements_must_match():
    task = make_task("Poke", placements=(cg.Placement((0, 0, 1)),))
    with pytest.raises(ValueError, match="got 1 placements for 2 robots"):
        task.build(Scene())
