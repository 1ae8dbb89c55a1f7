from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies.match import name_players
from collaborative_gym.tasks.reach import ReachFacts
from collaborative_gym.tasks.sort import SortFacts
from collaborative_gym.viewer import reading


def read(env, infos, before):
    return reading.read(env, infos, name_players("expert", env.sides), before)


@dataclass
class Facts:
    """Facts of every kind."""

    joints: dict
    pose: tuple
    to_cube: dict
    to_target: np.ndarray
    is_held: np.ndarray


@pytest.fixture
def played(make_env):
    """Return a function that plays an episode's first steps and reads the last."""

    def played(steps, **settings):
        env = make_env(auto_reset=False, **settings)
        _, infos = env.reset()
        latest = replace(read(env, infos, None), previous="so")
        for _ in range(steps):
            _, _, _, _, infos = env.step(env.expert())
            latest = read(env, infos, latest)
        return env, infos, latest

    return played


def test_a_start_has_measures_and_has_earned_nothing(played):
    env, _, start = played(0)
    assert (start.episode, start.seed, start.time) == (0, 0, 0.0)
    assert (start.previous, start.trouble) == ("so", "")
    for agent, terms in start.rewards.items():
        assert terms == dict.fromkeys(env.reward_terms[agent], 0.0)
    assert start.players == {"side_1": "expert"}
    assert (start.success, start.returns) == ({"side_1": False}, {"side_1": 0.0})
    names = ["distance robot_1", "distance robot_2", "height", "highest"]
    assert list(start.measures) == names
    assert start.measures["height"] == env.facts.height[0]


def test_a_step_has_every_named_term_of_the_reward(played):
    env, infos, after = played(5, seed=3)
    assert (after.episode, after.seed) == (0, 3)
    assert after.time == pytest.approx(0.5)
    for agent in env.agents:
        assert tuple(after.rewards[agent]) == env.reward_terms[agent]
        for name, term in infos["reward_terms"][agent].items():
            assert after.rewards[agent][name] == term[0]


def test_success_is_said(played):
    _, infos, after = played(11)
    assert infos["success"][0] and after.success == {"side_1": True}
    assert ("success", "yes") in after.rows


def test_rows_show_it_all_with_sums(played):
    _, _, after = played(4)
    rows = dict(after.rows)
    for agent, terms in after.rewards.items():
        assert rows[f"reward of {agent}"] == f"{sum(terms.values()):.3f}"
    assert rows["  height"] == f"{after.measures['height']:.3f}"
    assert (rows["episode of seed 0"], rows["time"]) == ("0", "0.4 s")
    assert list(rows)[-2:] == ["last result", "  so"]


def test_episodes_that_came_to_an_end_are_counted(make_env):
    env, latest = make_env(auto_reset=False, max_episode_steps=60), None
    counted = []
    for policy in (env.expert, env.idle, env.expert, env.expert):
        _, infos = env.reset()
        latest = read(env, infos, latest)
        counted.append(dict(latest.rows)["succeeded before"])
        # The third is given up before it has shown anything.
        for _ in range(3 if len(counted) == 3 else 60):
            if not latest.has_ended:
                *_, infos = env.step(policy())
                latest = read(env, infos, latest)
    assert counted == ["0 of 0", "1 of 1", "1 of 2", "1 of 2"]


def test_nothing_reads_as_minus_zero(played):
    _, _, latest = played(0)
    terms = {"robot_1": {"grip": -1e-9}}
    rows = dict(replace(latest, rewards=terms).rows)
    assert rows["reward of robot_1"] == rows["  grip"] == "0.000"


def test_what_was_earned_is_summed_from_each_start(make_env):
    env, latest = make_env(auto_reset=False), None
    for _ in range(2):
        _, infos = env.reset()
        latest, earned = read(env, infos, latest), 0.0
        while not latest.has_ended:
            _, rewards, _, _, infos = env.step(env.expert())
            latest = read(env, infos, latest)
            earned += sum(reward[0] for reward in rewards.values())
            assert latest.returns == {"side_1": pytest.approx(earned, rel=1e-4)}
            assert dict(latest.rows)["return"] == f"{latest.returns['side_1']:.1f}"
        assert infos["metrics"]["return"][0] == pytest.approx(earned)


@pytest.fixture
def duel(carry):
    """Return a world: one arm wants the cube high, whereupon it is over, one low."""
    parts = {
        "sides": (("robot_2",), ("robot_1",)),
        "reward": lambda self, facts, actions: {
            "robot_1": {"height": -facts.height},
            "robot_2": {"height": facts.height},
        },
        "success": lambda self, facts: (facts.height > 0.6, facts.height < 0.4),
        "over": lambda self, facts: facts.height > 0.6,
    }
    base = carry()
    task = type("Duel", (type(base),), parts)
    return cg.VectorEnv(
        task([cg.get_robot("panda")] * 2, base.config), 1, auto_reset=False
    )


def test_sides_are_told_apart(duel):
    env = duel
    _, infos = env.reset()
    latest = read(env, infos, None)
    assert latest.success == {"side_1": False, "side_2": False}
    while not latest.has_ended:
        before = latest
        _, _, _, _, infos = env.step(env.expert())
        latest = read(env, infos, before)
    assert latest.success == {"side_1": True, "side_2": False}
    assert before.returns["side_1"] > 0.5
    assert before.returns["side_2"] == pytest.approx(-before.returns["side_1"])
    assert before.rows[3:11] == [
        ("side_1", "robot_2 expert"),
        ("  score", "0"),
        ("  success", "no"),
        ("  return", f"{before.returns['side_1']:.1f}"),
        ("side_2", "robot_1 expert"),
        ("  score", "0"),
        ("  success", "no"),
        ("  return", f"{before.returns['side_2']:.1f}"),
    ]
    seconds, earned = infos["step"][0] / 10, infos["metrics"]["return"]
    assert latest.previous == (
        f"episode 0: robot_2 expert wins; over after {seconds:.1f} s;"
        f" side_1 success after {seconds:.1f} s,"
        f" return {earned['side_1'][0]:.1f}; side_2 no success,"
        f" return {earned['side_2'][0]:.1f}"
    )


def test_measures_are_the_facts_that_are_one_number_each(make_env):
    env = make_env()
    _, infos = env.reset()
    env._facts = Facts(
        joints={"robot_1": np.zeros((1, 7))},
        pose=(np.zeros((1, 3)), np.zeros((1, 4))),
        to_cube={"robot_1": np.array([0.5]), "robot_2": np.array([0.25])},
        to_target=np.array([2.0]),
        is_held=np.array([True]),
    )
    measures = read(env, infos, None).measures
    assert measures == {
        "to cube robot_1": 0.5,
        "to cube robot_2": 0.25,
        "to target": 2.0,
        "is held": True,
    }
    assert measures["is held"] is True
    env._facts = {"of": "another kind"}
    assert read(env, infos, None).measures == {}


def test_counts_and_shares_have_no_needless_decimals(make_env):
    env = make_env()
    env.task.units = {"far": "m"}
    _, infos = env.reset()
    env._facts = {
        "own": np.array([4]),
        "stage": np.array([2.0]),
        "idle": np.array([1 / 3]),
        "far": np.array([2.0]),
    }
    rows = dict(read(env, infos, None).rows)
    assert [rows[f"  {name}"] for name in env._facts] == ["4", "2", "0.333", "2.000 m"]


def test_terms_and_measures_are_explained_by_their_task():
    sort, reach = cg.task("Sort"), cg.task("Reach")
    said = reading.meanings(type(sort), SortFacts)
    assert said["reward waiting"].startswith("-3 for each of its cubes that it has not")
    assert said["own"] == "the index of the agent's cube"
    said = reading.meanings(type(reach), ReachFacts)
    assert said["distance"] == "from tcp to goal, in m"
    assert said["reward distance"].startswith("10 times the distance, in m, by which")
    assert reading.meanings(type("Mine", (cg.Task,), {}), SimpleNamespace) == {}


def test_an_episode_is_summed_up_from_its_success_on(played):
    assert played(3)[2].previous == "so"
    assert played(11)[2].previous.startswith("episode 0: success after 0.6 s, return")
    env, infos, last = played(12)
    seconds, earned = infos["metrics"]["time_to_success"], infos["metrics"]["return"]
    expected = f"episode 0: success after {seconds[0]:.1f} s, return {earned[0]:.1f}"
    assert last.has_ended and last.previous == expected
    infos["metrics"]["time_to_success"][0] = np.nan
    assert "no success" in read(env, infos, last).previous
    infos["diverged"][0] = True
    assert "the physics diverged" in read(env, infos, last).previous


@pytest.mark.parametrize("kind", [dict, SimpleNamespace])
def test_facts_need_not_be_a_dataclass(make_env, monkeypatch, kind):
    env = make_env()
    _, infos = env.reset(seed=0)
    monkeypatch.setattr(env, "_facts", kind(to_cube={"robot_1": np.array([0.5])}))
    assert read(env, infos, None).measures == {"to cube robot_1": 0.5}


def test_rows_stay_where_they_are(make_env):
    env = make_env()
    _, infos = env.reset()
    latest = read(env, infos, None)
    names = [name for name, _ in latest.rows]
    for _ in range(14):
        _, _, _, _, infos = env.step(env.expert())
        latest = read(env, infos, latest)
        assert [name for name, _ in latest.rows][:-1] == names[:-1]
        assert len(latest.rows) == len(names)


def test_measures_have_the_units_that_the_task_names(make_env):
    env = make_env()
    env.task.units = {"distance": "m", "height": "km"}
    _, infos = env.reset()
    latest = read(env, infos, None)
    assert latest.units == {
        "distance robot_1": "m",
        "distance robot_2": "m",
        "height": "km",
    }
    rows = dict(reversed(latest.rows))  # Measures come before rewards of the same name.
    assert rows["  height"] == f"{latest.measures['height']:.3f} km"
    assert rows["  highest"].replace(".", "").isdigit()


@pytest.mark.parametrize("env_id", ["LiftTaskSawyers-v0", "TugPandas-v0"])
def test_units_are_those_of_facts(env_id):
    env = cg.make_vec(env_id, 1, num_threads=1)
    env.reset()
    assert set(env.task.units) <= set(vars(env.facts))
