import json
import math

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.cli.tables import reports_table
from collaborative_gym.evaluation.play import worlds_for
from collaborative_gym.tasks.identity import Identity


@pytest.fixture
def report(carry):
    return cg.evaluate(carry(), "expert", episodes=5, num_threads=1)


def test_each_episode_is_played_once_in_order(report):
    assert [row["episode"] for row in report.episodes] == [0, 1, 2, 3, 4]
    assert all(row["seed"] == 0 and row["length"] == 12 for row in report.episodes)
    assert not any(row["diverged"] for row in report.episodes)


def test_numpys_numbers_do_for_pythons(carry, report):
    given = {"episodes": np.int64(5), "seed": np.int64(0), "delay": np.int64(0)}
    again = cg.evaluate(carry(), "expert", **given, num_threads=1)
    assert json.loads(again.to_json())["Carry"]["settings"] == report.settings


def test_no_world_is_built_without_an_episode():
    assert [worlds_for(5, n) for n in (2, 5, 1000)] == [2, 5, 5]


@pytest.mark.parametrize("policy", ["expert", "random"])
@pytest.mark.parametrize(("num_envs", "num_threads"), [(1, 1), (3, 2), (8, 1)])
def test_numbers_do_not_depend_on_worlds_and_threads(
    carry, policy, num_envs, num_threads
):
    report = cg.evaluate(
        carry(), policy, episodes=5, num_envs=num_envs, num_threads=num_threads
    )
    other = cg.evaluate(carry(), policy, episodes=5, num_envs=5, num_threads=1)
    assert report.to_csv() == other.to_csv()
    assert report.mean_reward == other.mean_reward


def test_a_trained_policy_is_played_by_name_path_and_value(carry_id, random_network):
    path = random_network(carry_id)
    reports = [
        cg.evaluate(
            carry_id, policy, episodes=5, num_envs=num_envs, num_threads=num_threads
        )
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


def test_an_idle_robot_holds_still_with_an_open_grip(carry, report):
    policy = {"robot_1": "expert", "robot_2": "idle"}
    idle = cg.evaluate(carry(), policy, episodes=2, num_threads=1)
    assert idle.settings["policy"] == "robot_1=expert robot_2=idle"
    for row, other in zip(idle.episodes, report.episodes, strict=False):
        assert row["robot_2/effort"] == 0.0
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


def done(report):
    """Return all that is known of episodes but what was chosen and not done."""
    return [
        {name: repr(value) for name, value in row.items() if name != "action_change"}
        for row in report.episodes
    ]


def test_delayed_actions_are_done_late_and_nothing_before_them(carry):
    def counting(first):
        steps = iter(range(first, 99))

        def count(observations):
            step = next(steps)
            moves = np.full(8, 0.0 if step < 0 else 0.02 * (step % 12))
            moves[-1] = -1.0 if step < 0 else 1.0
            return dict.fromkeys(observations, np.tile(moves, (2, 1)))

        return count

    options = {"episodes": 2, "num_envs": 2, "num_threads": 1}
    for delay in (1, 3):
        late = cg.evaluate(carry(), counting(0), delay=delay, **options)
        assert late.settings["delay"] == delay
        assert done(late) == done(cg.evaluate(carry(), counting(-delay), **options))
    on_time = cg.evaluate(carry(), counting(0), **options)
    assert on_time.settings["delay"] == 0 and on_time.to_csv() != late.to_csv()


def test_every_episode_begins_without_delayed_actions(carry):
    options = {"delay": 12, "num_envs": 1, "num_threads": 1}
    wild = cg.evaluate(carry(), "random", episodes=3, **options)
    idle = cg.evaluate(carry(), "idle", episodes=3, **options)
    assert done(wild) == done(idle)


def test_diverged_episodes_count_as_failed(carry):
    def wild(observations):
        return {agent: np.ones((len(rows), 8)) for agent, rows in observations.items()}

    task = carry()

    class Broken(type(task)):
        def disturb(self, sim, steps):
            super().disturb(sim, steps)
            if sim.qpos[0, 0] > 0.5:
                sim.qpos[0, 0] = np.nan

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
    with pytest.raises(ValueError, match="episodes must be at least 1"):
        cg.evaluate(carry(), episodes=0)
    for count, words in ((1.5, r"1\.5"), (True, "True")):
        with pytest.raises(
            TypeError, match=f"episodes must be an integer, got {words}"
        ):
            cg.evaluate(carry(), episodes=count)
    with pytest.raises(TypeError, match=r"'expert', .* a function .* got 3"):
        cg.evaluate(carry(), 3)
    with pytest.raises(ValueError, match=r"a dictionary with an array .* got 0"):
        cg.evaluate(carry(), lambda observations: 0, num_threads=1)
    with pytest.raises(FileNotFoundError, match="no baseline is shipped for Carry"):
        cg.evaluate(carry(), "baseline")
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        cg.evaluate(carry(), num_envs=0)
    with pytest.raises(ValueError, match=r"give them to cg\.task"):
        cg.make(carry(), ("panda", "jaco"))
    for robots in ({"sawyer", "panda"}, b"panda", iter(["panda", "panda"])):
        with pytest.raises(TypeError, match="robots must be a name, or a sequence of"):
            cg.evaluate(cg.task("Poke", robots))


def test_a_baseline_is_not_played_in_another_environment():
    task, alone = cg.task("Lift", ("sawyer", "sawyer")), {"num_threads": 1}
    message = (
        "for LiftTaskSawyers-v0 with 2 sawyer; here placements is None, not .*;"
        r" target is None, not \[0.0, 0.0, 1.5\]; picking_threshold is 0.03, not 0.02"
    )
    with pytest.raises(ValueError, match=message):
        cg.evaluate(task, "baseline", **alone)
    report = cg.evaluate(task, "baseline", episodes=1, any_env=True, **alone)
    assert report.completion.mean == 0.0


def test_settings_tell_the_whole_environment(carry, report):
    identity = Identity.from_dict(report.settings["identity"])
    assert not identity.differences(Identity.of(carry()))


def test_a_report_of_several_sides_adds_nothing_up_over_them(carry):
    class Rivals(type(carry())):
        """The second robot's goal is that the cube stays down."""

        @property
        def sides(self):
            return (("robot_1",), ("robot_2",))

        def success(self, facts):
            is_up = super().success(facts)
            return is_up, ~is_up

        def reward(self, facts, actions):
            return {agent: {"lower": -facts.height} for agent in self.agents}

    task = carry()
    rivals = Rivals(list(task.robots.values()), task.config)
    report = cg.evaluate(rivals, episodes=2, num_threads=1)
    first, second = report.sides["side_1"], report.sides["side_2"]
    assert first.mean_reward == report.returns["robot_1"]
    assert first.performance != second.performance
    for side in first, second:
        assert side.score.mean == side.completion.mean
    for row in report.episodes:
        assert row["side_1/return"] == row["robot_1/return"] and "return" not in row
    with pytest.raises(ValueError, match="has the sides side_1, side_2, each with"):
        report.mean_reward  # noqa: B018
    assert "| completion of side_2 |" in report.to_markdown()
    assert "| score of side_1 | 1.0 |" in report.to_markdown()
    summary = json.loads(report.to_json())["Rivals"]
    assert set(summary["sides"]) == {"side_1", "side_2"} and "completion" not in summary
    assert "score" in summary["sides"]["side_2"]
    heads = [column.header for column in reports_table([report]).columns]
    assert heads[1] == "score"


def test_episodes_that_end_early_are_evaluated(carry):
    class Short(type(carry())):
        """An episode is over when the cube is up."""

        def over(self, facts):
            return super().success(facts)

    task = carry()
    shares = []
    report = cg.evaluate(
        Short(list(task.robots.values()), task.config),
        episodes=5,
        num_envs=2,
        num_threads=1,
        on_progress=shares.append,
    )
    assert [row["episode"] for row in report.episodes] == [0, 1, 2, 3, 4]
    assert all(row["length"] < 12 for row in report.episodes)
    assert report.completion.mean == 1.0 and shares[-1] == 1.0
