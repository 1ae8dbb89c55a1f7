"""What is told of runs: numbers worked out by hand, and files."""

import csv
import json
import math

import numpy as np
import pytest

import collaborative_gym as cg


def test_scores_are_the_last_validations(two_modes):
    compared = cg.compare(two_modes)
    assert compared.measures == ("completion", "return")
    first, second = compared.entries
    numbers = compared.aggregates(first, "completion")
    assert numbers.mean.value == pytest.approx(0.8)
    assert numbers.median.value == 0.9
    # Of three runs none is in the outer quarters: the mean of all.
    assert numbers.iqm.value == pytest.approx(0.8)
    # With three runs, t is 4.303.
    error = np.std([1.0, 0.9, 0.5], ddof=1) / math.sqrt(3)
    assert numbers.mean.low == pytest.approx(0.8 - 4.303 * error)
    assert numbers.mean.high == 1.0 and math.isnan(numbers.median.low)
    assert compared.aggregates(second, "return").mean.value == pytest.approx(5.0)


def test_probability_of_improvement_counts_pairs_and_halves_ties(write_run, tmp_path):
    for seed, (one, other) in enumerate(((1.0, 0.5), (0.5, 0.25))):
        write_run(f"c{seed}", (one,), seed)
        write_run(f"i{seed}", (other,), seed, mode="independent")
    compared = cg.compare(tmp_path)
    ((pair, chance),) = compared.improvements.items()
    assert pair == ("collaborative", "independent")
    # 1 beats both, 0.5 beats 0.25 and ties with 0.5.
    assert chance.value == 3.5 / 4


def test_a_profile_is_the_share_of_runs_that_score_as_much(two_modes):
    compared = cg.compare(two_modes)
    at = {round(float(level), 2): i for i, level in enumerate(compared.levels)}
    profile = compared.profiles["collaborative"]
    shares = [profile[at[level]].value for level in (0.0, 0.5, 0.9, 1.0)]
    assert shares == pytest.approx([1, 1, 2 / 3, 1 / 3])
    assert compared.profiles["independent"][at[0.72]].value == 0.0


def test_when_runs_learned_is_a_median_in_which_never_counts(two_modes):
    collaborative, independent = cg.compare(two_modes).groups
    compared = cg.compare(two_modes)
    reached = compared.reached(collaborative)
    assert (reached.runs, reached.steps.value, reached.core_seconds.value) == (
        3,
        300.0,
        7.5,
    )
    never = compared.reached(independent)
    assert never.runs == 0 and never.steps.value == math.inf
    assert "| 0 of 3 | never |" in compared.to_markdown()
    assert json.loads(compared.to_json())["groups"][1]["reached"]["steps"] == {
        "value": None,
        "low": None,
        "high": None,
    }


def test_core_seconds_that_were_not_measured_are_not_told(two_modes, alter):
    for file in two_modes.rglob("progress.csv"):
        alter(file, lambda rows: [row.pop("core_seconds") for row in rows])
    compared = cg.compare(two_modes)
    reached = compared.reached(compared.groups[0])
    assert reached.steps.value == 300.0 and math.isnan(reached.core_seconds.value)
    assert "| 300 | - |" in compared.to_markdown()


def test_methods_are_put_together_over_environments_that_have_all(write_run, tmp_path):
    for env, scores in (("A-v0", (1.0, 0.5)), ("B-v0", (0.25, 0.5)), ("C-v0", (0.9,))):
        for mode, score in zip(("collaborative", "independent"), scores, strict=False):
            for seed in (0, 1):
                write_run(f"{env}{mode}{seed}", (score,), seed, env, mode)
    compared = cg.compare(tmp_path)
    assert {name: len(e.groups) for name, e in compared.contestants.items()} == {
        "collaborative": 2,
        "independent": 2,
    }
    together = [e for e in compared.entries if e.environment == "2 environments"]
    means = [compared.aggregates(e, "completion").mean.value for e in together]
    assert means == [0.625, 0.5]
    # Within each environment: always in A, never in B.
    assert next(iter(compared.improvements.values())).value == 0.5
    # Returns of different environments have no sum.
    assert compared.to_markdown().count("2 environments") == 2


def test_what_differs_between_environments_is_no_part_of_an_interval(
    write_run, tmp_path
):
    for env, score in (("A-v0", 0.1), ("B-v0", 0.9)):
        for mode in ("collaborative", "independent"):
            for seed in range(4):
                own = score + 0.01 * seed
                write_run(f"{env}{mode}{seed}", (own,), seed, env, mode)
    compared = cg.compare(tmp_path)
    mean = compared.aggregates(compared.entries[-1], "completion").mean
    assert 0.5 < mean.low < mean.value < mean.high < 0.53


def test_environments_are_compared_where_nothing_else_differs(write_run, tmp_path):
    for env in ("A-v0", "B-v0"):
        write_run(env, (1.0,), env=env)
    compared = cg.compare(tmp_path)
    assert list(compared.contestants) == ["A-v0", "B-v0"]
    assert "They differ in environment (A-v0, B-v0)." in compared.statement


def test_one_run_has_no_interval(write_run):
    compared = cg.compare(write_run("one", (0.5, 1.0)))
    assert "100 % | 100 % |" in compared.to_markdown()
    assert compared.statement.splitlines()[0] == "1 run, seed 0."
    assert "differ" not in compared.statement
    assert not compared.improvements


def test_what_is_not_finished_is_said(write_run, tmp_path):
    write_run("whole", (0.0, 0.5, 1.0, 1.0))
    cut, begun = write_run("cut", (0.0, 0.5), 1), write_run("begun", (), 2)
    compared = cg.compare(tmp_path)
    assert compared.notes == (
        f"{begun} is left out: it has no validation yet.",
        f"{cut} is not finished: its last validation is after 200 of 400 steps.",
    )
    assert compared.statement.endswith("\n".join(compared.notes))


def test_csv_has_the_learning_curves(two_modes):
    rows = list(csv.DictReader(cg.compare(two_modes).to_csv().splitlines()))
    assert len(rows) == 2 * 2 * 4
    row = rows[2]
    told = (row["method"], row["measure"], row["steps"], float(row["median"]))
    assert told == ("collaborative", "completion", "300", 0.9)
    assert float(row["iqm"]) == pytest.approx(0.9)


def test_marl_evals_json_has_its_documented_form(two_modes):
    """As the README of id-marl-eval describes it; its own code reads it, too."""
    content = json.loads(cg.compare(two_modes).to_marl_eval())
    algorithms = content["collaborative_gym"]["CarryPandas-v0"]
    assert list(algorithms) == ["collaborative", "independent"]
    assert list(algorithms["independent"]) == ["seed_0", "seed_1", "seed_2"]
    run = algorithms["collaborative"]["seed_2"]
    assert list(run) == [*(f"step_{i}" for i in range(1, 5)), "absolute_metrics"]
    assert run["step_3"] == {"step_count": 300, "completion": [0.9], "return": [9.0]}
    assert run["absolute_metrics"] == {"completion": [0.5], "return": [5.0]}


def test_marl_eval_takes_no_commas_in_names(write_run, tmp_path):
    write_run("one", (1,))
    write_run("other", (1,), mode="shared", entropy=0.5)
    (tasks,) = json.loads(cg.compare(tmp_path).to_marl_eval()).values()
    assert list(tasks["CarryPandas-v0"]) == [
        "collaborative; entropy 0.0",
        "shared; entropy 0.5",
    ]


def test_another_measure_can_be_compared(two_modes):
    compared = cg.compare(two_modes, measure="return")
    assert (compared.levels[0], compared.levels[-1]) == (2.0, 10.0)
    assert np.isclose(compared.curve(compared.groups[0], "return")[-1].value, 8.0)


@pytest.mark.parametrize(
    ("runs", "error", "message"),
    [
        ((), ValueError, "nothing to compare"),
        ("nowhere", FileNotFoundError, "no training run in 'nowhere'"),
        ("", FileNotFoundError, "no training run in ''"),
        (3, TypeError, "runs must be a folder's name, or several, got 3"),
        ([3], TypeError, "each run must be a folder's name, got 3"),
    ],
)
def test_bad_folders_meet_a_sentence(runs, error, message):
    with pytest.raises(error, match=message):
        cg.compare(runs)


def test_damaged_runs_and_unknown_measures_are_named(write_run, tmp_path):
    folder = write_run("run", (1,))
    with pytest.raises(KeyError, match=r"no measure 'complete' .did you mean 'comp"):
        cg.compare(folder, measure="complete")
    spoilt = {
        "config.json": ("{", '{"seed": ' + "[" * 10**5, "{}", "\0", "[1]"),
        "progress.csv": ("", "a,b\n1,2,3\n", '"', "\0", "digest\n1e999\n", "x" * 10**6),
    }
    for name, texts in spoilt.items():
        whole = (folder / name).read_text()
        for text in (*texts, whole.replace("1", "2"), whole.replace("1", "nan")):
            (folder / name).write_text(text)
            with pytest.raises(ValueError, match=rf"{name} is damaged.*--resume"):
                cg.compare(folder)
        (folder / name).write_text(whole)
    write_run("begun/run", ())
    with pytest.raises(ValueError, match="no validation yet in 1 of 1 runs; let"):
        cg.compare(tmp_path / "begun")
