import json
from dataclasses import replace

import pytest

import collaborative_gym as cg
from collaborative_gym.evaluation import table11
from collaborative_gym.evaluation.report import Report, Score, Statistic
from collaborative_gym.evaluation.table11 import (
    COLUMNS,
    THESIS,
    Line,
    Table11,
    Thesis,
    reproduce_table11,
)
from collaborative_gym.policies.policy import SHIPPED

ENV_ID = "PokeTaskPandaSawyer-v0"


@pytest.fixture
def small(carry_id, monkeypatch):
    """Put the small task into the table, alone, with numbers that all exceed."""
    lines = {carry_id: Thesis(-1e6, -0.1, -0.1)}
    monkeypatch.setattr(table11, "THESIS", lines)
    return carry_id


def report(mean_reward=0.0, completion=1.0, performance=1.0):
    """Return a report of which only the means are of interest."""
    means = (mean_reward, completion, performance, performance, float("nan"))
    statistics = [Statistic(*[mean] * 5) for mean in means]
    return Report("", {}, {"side_1": Score(*statistics)}, {}, (), steps_per_second=1.0)


def comparison(ours, on_default=None, thesis=THESIS[ENV_ID]):
    """Return one where all but what is given is perfect."""
    reports = {column: report() for column in COLUMNS} | {"ours": ours}
    if on_default is not None:
        reports["ours_on_default"] = on_default
    return Line(ENV_ID, thesis, reports)


def test_every_environment_of_the_thesis_has_its_line():
    assert list(THESIS) == [each for each in cg.list_envs() if each in THESIS]
    assert THESIS["LiftTaskSawyers-v0"] == Thesis(-356.88, 0.98, 0.2901)


@pytest.mark.parametrize(
    ("measure", "thesis", "ours", "passes"),
    [
        ("mean_reward", 215.94, 215.95, True),
        ("mean_reward", 215.94, 215.94, False),
        ("completion", 0.985, 0.99, True),
        ("completion", 0.985, 0.985, False),
        ("completion", 1.0, 1.0, True),
        ("completion", 1.0, 0.995, False),
        ("performance", 0.9998, 0.9998, True),
        ("performance", 0.9998, 0.9997, False),
        ("performance", 0.9993, 0.9993, False),
        ("performance", 0.9993, float("nan"), False),
    ],
)
def test_ours_must_exceed_the_thesis_or_be_as_good_as_all(
    measure, thesis, ours, passes
):
    line = replace(Thesis(-1.0, 0.0, 0.0), **{measure: thesis})
    verdicts = comparison(report(**{measure: ours}), thesis=line).verdicts()
    assert verdicts["ours", measure] is passes
    assert all(
        is_passed for cell, is_passed in verdicts.items() if cell != ("ours", measure)
    )


@pytest.mark.parametrize(
    ("completion", "performance", "passes"),
    [(0.98, 0.95, True), (0.975, 1.0, False), (1.0, 0.949, False)],
)
def test_on_default_the_rewards_do_not_count(completion, performance, passes):
    on_default = report(-1e6, completion, performance)
    verdicts = comparison(report(1e6), on_default).verdicts()
    assert all(verdicts.values()) is passes
    assert ("ours_on_default", "mean_reward") not in verdicts


def test_verdict_counts_the_cells():
    good = comparison(report(216.0))
    assert Table11(1, 0, (good,)).verdict == "PASS: every cell"
    both = Table11(1, 0, (good, comparison(report(0.0, 0.9))))
    assert both.verdict == "FAIL: 2 of 10 cells"
    assert not both.is_passed and Table11(1, 0, (good,)).is_passed


def test_markdown_shows_numbers_and_verdicts_side_by_side():
    text = Table11(200, 3, (comparison(report(216.004, 0.9)),)).to_markdown()
    head, rule, *lines = text.splitlines()
    heads = ["thesis", "ours", "ours on default", "expert", "random", "idle"]
    assert head == f"| environment | measure | {' | '.join(heads)} |"
    assert head.count("|") == rule.count("|")
    assert lines[0].startswith(
        f"| {ENV_ID} | mean reward | 215.94 | 216.00 PASS | 0.00 | 0.00 |"
    )
    assert lines[1].startswith(
        f"| {ENV_ID} | completion | 100 % | 90.00 % FAIL | 100 % PASS | 100 % |"
    )
    assert lines[-1] == "FAIL: 1 of 5 cells"
    assert "200 episodes of seed 3" in text and "success rules are stricter" in text


def test_policies_are_those_that_evaluate_plays(small, random_network):
    random_network(small)
    shares = []
    made = reproduce_table11(3, seed=5, num_threads=1, on_progress=shares.append)
    (line,) = made.comparisons
    assert line.environment == small and made.is_passed is False
    for column, (name, randomization) in COLUMNS.items():
        alone = cg.evaluate(
            cg.task(small, randomization=randomization),
            name,
            episodes=3,
            seed=5,
            num_envs=1,
        )
        assert line.reports[column].to_csv() == alone.to_csv()
        assert line.reports[column].settings == alone.settings
    assert shares == sorted(shares) and shares[0] > 0.0 and shares[-1] == 1.0
    assert reproduce_table11(3, seed=5, num_threads=2).to_json() == made.to_json()


def test_json_holds_statistics_and_verdicts_but_no_episodes(small, random_network):
    random_network(small)
    made = reproduce_table11(2, num_threads=1)
    content = json.loads(made.to_json(), parse_constant=pytest.fail)
    assert (content["episodes"], content["seed"]) == (2, 0)
    line = content["environments"][small]
    assert line["thesis"]["mean_reward"] == -1e6
    assert line["passed"]["ours"] == dict.fromkeys(line["thesis"], True)
    ours = line["ours"]
    assert ours["settings"]["policy"] == "baseline"
    assert set(ours["mean_reward"]) == {"mean", "low", "high", "iqm", "median"}
    assert set(ours["returns"]) == {"robot_1", "robot_2"}
    assert ours["time_to_success"]["mean"] is None
    assert "episodes" not in ours


def test_without_a_baseline_its_cells_are_dashes_and_fail(small, tmp_path, monkeypatch):
    monkeypatch.setitem(SHIPPED, "baseline", tmp_path)
    made = reproduce_table11(1, num_threads=1)
    assert made.verdict == "FAIL: 5 of 5 cells"
    rewards, completion, _ = made.lines()
    assert rewards[3:5] == ["- FAIL", "-"]
    assert completion[3:6] == ["- FAIL", "- FAIL", "100 %"]
    line = json.loads(made.to_json())["environments"][small]
    assert line["ours"] is None and line["expert"]["completion"]["mean"] == 1.0


def test_bad_input_shows_before_the_work(tmp_path, monkeypatch):
    def never(share):
        raise AssertionError("the work began")

    for env_ids, error, message in (
        (
            ["PokeTaskSawyers-v0", "Poke"],
            KeyError,
            "no environment 'Poke' .*; environments: Balance",
        ),
        ([], ValueError, "env_ids is empty"),
    ):
        with pytest.raises(error, match=message):
            reproduce_table11(1, env_ids=env_ids, on_progress=never)
    with pytest.raises(ValueError, match="episodes must be at least 1"):
        reproduce_table11(0, on_progress=never)
    monkeypatch.setitem(SHIPPED, "baseline", tmp_path)
    (tmp_path / "PassTaskJacoSawyer-v0.safetensors").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="is damaged"):
        reproduce_table11(1, on_progress=never)
