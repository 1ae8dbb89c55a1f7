import csv
import io
import json
import math

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.evaluation.report import Statistic, reports_to_csv, show


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


def test_statistic_of_known_values():
    statistic = Statistic.of([0, 0, 1, 2, 3, 4, 100, math.nan])
    assert statistic.mean == pytest.approx(110 / 7)
    assert statistic.iqm == pytest.approx(np.mean([0, 1, 2, 3, 4]))
    assert statistic.low < statistic.mean < statistic.high
    assert Statistic.of([2.0, 2.0]) == Statistic(2.0, 2.0, 2.0, 2.0)
    assert math.isnan(Statistic.of([math.nan]).mean)


def test_bootstrap_interval_is_that_of_the_mean():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    statistic = Statistic.of(values)
    error = 1.96 * values.std() / 20
    assert statistic.low == pytest.approx(values.mean() - error, abs=0.03)
    assert statistic.high == pytest.approx(values.mean() + error, abs=0.03)


def test_json_holds_everything_and_null_for_nan(carry):
    report = cg.evaluate(carry(), "random", episodes=2, num_threads=1)
    content = json.loads(report.to_json(), parse_constant=pytest.fail)["Carry"]
    assert content["settings"]["robots"] == ["panda", "panda"]
    assert content["time_to_success"]["mean"] is None
    assert len(content["episodes"]) == 2


def test_csv_has_a_row_per_episode_and_empty_cells_for_nan(carry, report):
    failed = cg.evaluate(carry(), "random", episodes=2, num_threads=1)
    rows = list(csv.DictReader(io.StringIO(reports_to_csv([report, failed]))))
    assert [row["episode"] for row in rows] == ["0", "1", "2", "3", "4", "0", "1"]
    assert rows[-1]["time_to_success"] == ""
    assert float(rows[0]["return"]) == report.episodes[0]["return"]


def test_markdown_is_a_table(report):
    head, rule, row = report.to_markdown().splitlines()
    assert head.count("|") == rule.count("|") == row.count("|") == 6
    assert row.startswith("| Carry |") and "100 % (100 to 100)" in row


@pytest.mark.parametrize(
    ("statistic", "percent", "text"),
    [
        (Statistic(0.985, 0.965, 1.0, 1.0), True, "98.5 % (96.5 to 100)"),
        (Statistic(-356.88, -360.0, -350.04, 0), False, "-356.9 (-360.0 to -350.0)"),
        (Statistic(math.nan, math.nan, math.nan, math.nan), True, "-"),
    ],
)
def test_numbers_as_people_read_them(statistic, percent, text):
    assert show(statistic, percent) == text


def test_bad_input_says_what_is_allowed(carry):
    with pytest.raises(KeyError, match="robot_1, robot_2"):
        cg.evaluate(carry(), idle=["robot_3"])
    with pytest.raises(ValueError, match="episodes must be at least 1"):
        cg.evaluate(carry(), episodes=0)
    with pytest.raises(TypeError, match=r"episodes must be an integer, got 1\.5"):
        cg.evaluate(carry(), episodes=1.5)
    with pytest.raises(TypeError, match=r"list of agents, such as \['robot_1'\]"):
        cg.evaluate(carry(), idle="robot_1")
    with pytest.raises(
        TypeError, match=r"'expert' or 'random', or a function .* got 3"
    ):
        cg.evaluate(carry(), 3)
    for idle in ((), ("robot_1",)):
        with pytest.raises(ValueError, match="actions are a int; give a dictionary"):
            cg.evaluate(carry(), lambda observations: 0, idle=idle, num_threads=1)
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        cg.evaluate(carry(), num_envs=0)
    with pytest.raises(ValueError, match="pass them to make_task"):
        cg.evaluate(carry(), robots=("panda", "jaco"))
