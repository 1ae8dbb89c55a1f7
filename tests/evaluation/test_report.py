import csv
import io
import json
import math

import numpy as np
import pytest
from rich.console import Console

import collaborative_gym as cg
from collaborative_gym.cli.tables import reports_table, strain_table
from collaborative_gym.evaluation.report import (
    Statistic,
    format_episodes,
    format_statistic,
    reports_to_csv,
)


@pytest.fixture
def report(carry):
    return cg.evaluate(carry(), "expert", episodes=5, num_threads=1)


def test_statistic_of_known_values():
    statistic = Statistic.of([0, 0, 1, 2, 3, 4, 100, math.nan])
    assert statistic.mean == pytest.approx(110 / 7)
    assert statistic.iqm == pytest.approx(np.mean([0, 1, 2, 3, 4]))
    assert statistic.low < statistic.mean < statistic.high
    assert statistic.median == 2.0
    assert math.isnan(Statistic.of([math.nan]).mean)


def test_the_interval_is_that_of_the_mean():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    statistic = Statistic.of(values)
    error = 1.96 * values.std() / 20
    assert statistic.low == pytest.approx(values.mean() - error, abs=0.03)
    assert statistic.high == pytest.approx(values.mean() + error, abs=0.03)


def test_json_holds_everything_and_null_for_nan(carry):
    report = cg.evaluate(carry(), "random", episodes=2, num_threads=1)
    content = json.loads(report.to_json(), parse_constant=pytest.fail)["Carry"]
    assert content["settings"]["identity"]["name"] == "Carry"
    assert content["time_to_success"]["mean"] is None
    assert len(content["episodes"]) == 2


def test_csv_has_a_row_per_episode_and_empty_cells_for_nan(carry, report):
    failed = cg.evaluate(carry(), "random", episodes=2, num_threads=1)
    rows = list(csv.DictReader(io.StringIO(reports_to_csv([report, failed]))))
    assert [row["episode"] for row in rows] == ["0", "1", "2", "3", "4", "0", "1"]
    assert rows[-1]["time_to_success"] == ""
    assert float(rows[0]["return"]) == report.episodes[0]["return"]


def test_markdown_is_a_table_of_all_statistics(report):
    title, table, strain = report.to_markdown().split("\n\n")
    assert title == "Carry with 2 panda, 5 episodes of seed 0:"
    assert format_episodes(1) == "1 episode"
    head, rule, *rows = table.splitlines()
    lines = [head, rule, *rows, *strain.splitlines()]
    assert {line.count("|") for line in lines} == {5}
    cells = [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows]
    assert [cell[0] for cell in cells] == [
        "return",
        "return of robot_1",
        "return of robot_2",
        "completion",
        "performance",
        "at goal",
        "time to success",
    ]
    assert cells[3] == ["completion", "100 % (56.6 to 100)", "100 %", "100 %"]
    own = report.returns["robot_2"]
    assert cells[2][1:] == [
        format_statistic(own),
        f"{own.median:.1f}",
        f"{own.iqm:.1f}",
    ]
    assert cells[6][3] == f"{report.time_to_success.iqm:.1f} s"


def test_a_notebook_shows_the_table(report):
    assert report._repr_markdown_() == report.to_markdown()


def test_markdown_has_dashes_where_nothing_succeeded(carry):
    failed = cg.evaluate(carry(height=5.0), episodes=1, num_threads=1)
    assert "| time to success | - | - | - |\n" in failed.to_markdown()


@pytest.mark.parametrize(
    ("statistic", "percent", "text"),
    [
        (Statistic(0.985, 0.965, 1.0, 1.0, 1.0), True, "98.5 % (96.5 to 100)"),
        (Statistic(0.9997, 0.9996, 1.0, 1.0, 1.0), True, "100.0 % (100.0 to 100)"),
        (Statistic(-356.88, -360.0, -350.04, 0, 0), False, "-356.9 (-360.0 to -350.0)"),
        (Statistic(-990.5, -1001.2, -980.5, 0, 0), False, "-990 (-1001 to -980)"),
        (Statistic(*[math.nan] * 5), True, "-"),
        (Statistic.of([0.5]), True, "50.0 %"),
    ],
)
def test_numbers_as_people_read_them(statistic, percent, text):
    assert format_statistic(statistic, percent=percent) == text


def test_the_strain_is_told_as_mean_and_worst(report):
    rows = report.episodes
    for name, worst in report.strain.items():
        values = [row[name] for row in rows]
        assert worst.mean == pytest.approx(np.mean(values))
        best = min if name == "clearance" else max
        assert worst.worst == best(values) == rows[worst.episode][name]
    assert report.strain["energy"].worst > report.strain["energy"].mean > 0.0
    energy = report.strain["energy"]
    line = f"| energy | {energy.mean:.1f} J | {energy.worst:.1f} J |"
    assert line in report.to_markdown()
    gap = report.strain["clearance"]
    assert f"| clearance | {1e3 * gap.mean:.1f} mm |" in report.to_markdown()
    told = json.loads(report.to_json())["Carry"]["strain"]["clearance"]
    assert told == {"mean": gap.mean, "worst": gap.worst, "episode": gap.episode}


def test_episodes_that_start_alike_are_one_without_an_interval(report):
    again = cg.evaluate(
        cg.task("LiftTaskSawyers-v0", randomization="paper"),
        "idle",
        episodes=3,
        num_threads=1,
    )
    assert again.is_one_episode and not report.is_one_episode
    assert len(again.episodes) == 3
    assert math.isnan(again.mean_reward.low) and math.isnan(again.completion.high)
    assert "one deterministic episode" in again.to_markdown()
    assert "one deterministic episode" not in report.to_markdown()
    assert json.loads(again.to_json())["LiftTaskSawyers-v0"]["is_one_episode"] is True


def test_what_people_read_names_the_arms(carry):
    """Other arms than an environment's own do not go under its name alone."""
    own = carry(robots=("panda", "jaco"))
    report = cg.evaluate(own, episodes=2, num_threads=1)
    console = Console(width=100, file=io.StringIO())
    console.print(reports_table([report]), strain_table([report]))
    for told in (report.to_markdown(), console.file.getvalue(), report.to_csv()):
        assert "panda" in told and "jaco" in told
