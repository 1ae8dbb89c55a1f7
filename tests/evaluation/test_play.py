import math

import numpy as np
import pytest

import collaborative_gym as cg


@pytest.fixture
def report(carry):
    return cg.evaluate(carry(), "expert", episodes=5, num_threads=1)


def test_each_episode_is_played_once_in_order(report):
    assert [row["episode"] for row in report.episodes] == [0, 1, 2, 3, 4]
    assert all(row["seed"] == 0 and row["length"] == 12 for row in report.episodes)
    assert not any(row["diverged"] for row in report.episodes)


@pytest.mark.parametrize("policy", ["expert", "random"])
@pytest.mark.parametrize(("num_envs", "num_threads"), [(1, 1), (3, 2), (8, 1)])
def test_numbers_do_not_depend_on_worlds_and_threads(
    carry, policy, num_envs, num_threads
):
    report = cg.evaluate(carry(), policy, 5, num_envs=num_envs, num_threads=num_threads)
    other = cg.evaluate(carry(), policy, 5, num_envs=5, num_threads=1)
    assert report.to_csv() == other.to_csv()
    assert report.mean_reward == other.mean_reward


def test_a_trained_policy_is_played_by_name_path_and_value(carry_id, random_network):
    path = random_network(carry_id)
    reports = [
        cg.evaluate(carry_id, policy, 5, num_envs=num_envs, num_threads=num_threads)
        for policy, num_envs, num_threads in (
            ("baseline", 5, 1),
            (carry_id, 1, 2),
            (path, 3, 1),
            (str(path), 8, 2),
            (cg.load_policy(str(path)), 5, 1),
        )
    ]
    assert len({report.to_csv() for report in reports}) == 1
    assert len({report.mean_reward for report in reports}) == 1
    assert [report.settings["policy"] for report in reports] == [
        "baseline",
        carry_id,
        str(path),
        str(path),
        "NetworkPolicy",
    ]


def test_rows_add_up(report):
    for row in report.episodes:
        returns = [row[f"{agent}/return"] for agent in ("robot_1", "robot_2")]
        terms = [row[f"robot_1/{name}"] for name in ("distance", "height", "effort")]
        assert row["return"] == pytest.approx(sum(returns))
        assert row["robot_1/return"] == pytest.approx(sum(terms))
    assert report.mean_reward.mean == pytest.approx(
        np.mean([row["return"] for row in report.episodes])
    )
    assert report.mean_reward.mean == pytest.approx(
        sum(statistic.mean for statistic in report.returns.values())
    )


def test_idle_agents_hold_still_with_an_open_grip(carry, report):
    idle = cg.evaluate(carry(), episodes=2, num_threads=1, idle=["robot_2"])
    assert idle.settings["idle"] == ["robot_2"]
    for row, other in zip(idle.episodes, report.episodes, strict=False):
        # The effort is that of twelve steps of zeros and a grip of -1.
        assert row["robot_2/effort"] == pytest.approx(-12 / 100)
        assert row["robot_1/effort"] != row["robot_2/effort"]
        assert row["return"] < other["return"]


def test_time_to_success_is_over_the_episodes_that_had_one(carry, report):
    assert report.completion.mean == 1.0
    assert 0.1 <= report.time_to_success.low <= report.time_to_success.high <= 1.2
    failed = cg.evaluate(carry(height=5.0), episodes=2, num_threads=1)
    assert failed.completion.mean == failed.performance.mean == 0.0
    assert math.isnan(failed.time_to_success.mean)


def test_a_function_is_a_policy(carry):
    shapes = set()

    def still(observations):
        shapes.add(observations["robot_1"].shape)
        return {agent: np.zeros((len(rows), 8)) for agent, rows in observations.items()}

    report = cg.evaluate(carry(), still, episodes=4, num_envs=2, num_threads=1)
    assert report.settings["policy"] == "still"
    assert [shape[0] for shape in shapes] == [2]
    assert report.completion.mean == 0.0


def test_diverged_episodes_count_as_failed(carry):
    def wild(observations):
        return {agent: np.ones((len(rows), 8)) for agent, rows in observations.items()}

    task = carry()
    measure = type(task).measure

    class Broken(type(task)):
        def measure(self, sim):
            if not np.isnan(sim.qpos).any() and sim.qpos[0, 0] > 0.5:
                sim.qpos[0, 0] = np.nan
            return measure(self, sim)

    broken = Broken(list(task.robots.values()), task.config)
    report = cg.evaluate(broken, wild, episodes=2, num_envs=1, num_threads=1)
    assert [row["diverged"] for row in report.episodes] == [True, True]
    assert report.performance.mean == 0.0


def test_progress_reaches_one_in_even_steps(carry):
    shares = []
    cg.evaluate(
        carry(), episodes=3, num_envs=2, num_threads=1, on_progress=shares.append
    )
    assert shares == pytest.approx(np.arange(1, 25) / 24)


def test_bad_input_says_what_is_allowed(carry):
    with pytest.raises(KeyError, match="robot_1, robot_2"):
        cg.evaluate(carry(), idle=["robot_3"])
    with pytest.raises(ValueError, match="episodes must be at least 1"):
        cg.evaluate(carry(), episodes=0)
    with pytest.raises(TypeError, match=r"episodes must be an integer, got 1\.5"):
        cg.evaluate(carry(), episodes=1.5)
    with pytest.raises(TypeError, match=r"list of agents, such as \['robot_1'\]"):
        cg.evaluate(carry(), idle="robot_1")
    with pytest.raises(TypeError, match=r"'expert', .* or a function .* got 3"):
        cg.evaluate(carry(), 3)
    for idle in ((), ("robot_1",)):
        with pytest.raises(ValueError, match="actions are a int; give a dictionary"):
            cg.evaluate(carry(), lambda observations: 0, idle=idle, num_threads=1)
    with pytest.raises(FileNotFoundError, match="no baseline is shipped for Carry"):
        cg.evaluate(carry(), "baseline")
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        cg.evaluate(carry(), num_envs=0)
    with pytest.raises(ValueError, match="pass them to make_task"):
        cg.evaluate(carry(), robots=("panda", "jaco"))
