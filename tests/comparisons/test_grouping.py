"""What runs differ in, found from their settings."""

import pytest

from collaborative_gym.comparisons.runs import find_runs, group_runs


def group(*folders):
    return group_runs(find_runs(folders))


def test_seeds_make_no_groups_and_modes_do(two_modes):
    grouping = group(two_modes)
    names = [(each.environment, each.method) for each in grouping.groups]
    assert names == [
        ("CarryPandas-v0", "collaborative"),
        ("CarryPandas-v0", "independent"),
    ]
    assert [[run.seed for run in each.runs] for each in grouping.groups] == [
        [0, 1, 2]
    ] * 2
    assert grouping.differences == {"mode": ["collaborative", "independent"]}
    assert not grouping.of_environments


def test_what_differs_between_environments_alone_makes_no_method(write_run, tmp_path):
    """Recipes have other lengths for other environments, and are compared."""
    for env, steps in (("CarryPandas-v0", 400), ("CarryJacos-v0", 200)):
        for entropy in (0.0, 0.5):
            name = f"{env}{entropy}"
            write_run(name, (1,), env=env, entropy=entropy, total_steps=steps)
    grouping = group(tmp_path)
    assert {each.method for each in grouping.groups} == {"entropy 0.0", "entropy 0.5"}
    assert list(grouping.differences) == ["entropy"]
    assert grouping.of_environments == {"total_steps": ["200", "400"]}


def test_of_many_settings_a_name_has_those_that_tell_the_groups_apart(
    write_run, tmp_path
):
    alike = {"entropy": 0.5, "discount": 0.9, "num_envs": 64}
    write_run("usual", (1,))
    write_run("other", (1,), **alike)
    write_run("third", (1,), **alike, mode="independent")
    write_run("longer", (1,), **alike, total_steps=500)
    grouping = group(tmp_path)
    assert {each.method for each in grouping.groups} == {
        "collaborative, total_steps 400, num_envs 256, ...",
        "collaborative, total_steps 400, num_envs 64, ...",
        "independent, total_steps 400, num_envs 64, ...",
        "collaborative, total_steps 500, num_envs 64, ...",
    }
    assert {*grouping.differences} == {"mode", "total_steps", *alike}


def test_environments_of_one_name_are_told_apart_by_what_differs(
    write_run, alter, tmp_path
):
    write_run("one", (1,))
    other = write_run("other", (1,)) / "config.json"

    def change(content):
        content["identity"]["config"]["randomization"]["joint_noise"] = 0.5
        content["identity"]["robots"]["robot_1"] = {"name": "jaco", "digest": "0"}

    alter(other, change)
    titles = [each.title for each in group(tmp_path).groups]
    assert titles == [
        "CarryPandas-v0 (robot_1 panda, joint_noise 0.05)",
        "CarryPandas-v0 (robot_1 jaco, joint_noise 0.5)",
    ]


def test_teams_of_one_task_are_told_apart_by_their_sizes(write_run, alter, tmp_path):
    write_run("two", (1,))

    def change(content):
        robots = content["identity"]["robots"]
        robots["robot_3"] = robots["robot_1"]

    alter(write_run("three", (1,)) / "config.json", change)
    titles = {each.title for each in group(tmp_path).groups}
    assert titles == {
        "CarryPandas-v0 (num_robots 2)",
        "CarryPandas-v0 (num_robots 3)",
    }


def test_a_setting_that_older_runs_lack_is_no_difference(write_run, alter, tmp_path):
    write_run("new", (1,))
    old = write_run("old", (1,), seed=1) / "config.json"

    def change(content):
        del content["hyperparameters"]["lost_grips"], content["start_from"]

    alter(old, change)
    assert len(group(tmp_path).groups) == 1


def test_what_means_nothing_to_an_algorithm_is_no_difference(write_run, tmp_path):
    write_run("ppo", (1,), clip=0.1)
    write_run("wide", (1,), clip=0.3, polyak=0.01)
    write_run("sac", (1,), algorithm="sac", final_noise=0.5)
    grouping = group(tmp_path)
    methods = ["ppo, clip 0.1", "sac", "ppo, clip 0.3"]
    assert [each.method for each in grouping.groups] == methods
    assert set(grouping.differences) == {"algorithm", "clip"}


def test_only_validations_that_all_runs_have_are_compared(write_run, tmp_path):
    write_run("whole", (0.25, 0.5, 0.75, 1.0))
    write_run("cut", (0.5, 0.25), seed=1)
    (own,) = group(tmp_path).groups
    assert own.steps.tolist() == [100, 200]
    assert own.values("completion").tolist() == [[0.25, 0.5], [0.5, 0.25]]
    assert own.scores("return").tolist() == [[5.0], [2.5]]


def test_a_run_counts_once(write_run, tmp_path):
    one = write_run("runs/one", (1,))
    assert len(find_runs([one, tmp_path / "runs", one / ".." / "one"])) == 1
    write_run("runs/copy", (1,))
    with pytest.raises(ValueError, match="the seed 0, and would count twice"):
        group(tmp_path)


def test_runs_without_a_common_validation_are_refused(write_run, alter, tmp_path):
    write_run("one", (1,))
    late = write_run("other", (0, 1), seed=1) / "progress.csv"
    alter(late, lambda rows: [row.update(steps=row["steps"] + "1") for row in rows])
    with pytest.raises(ValueError, match="one validation_interval"):
        group(tmp_path)
