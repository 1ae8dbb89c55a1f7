"""Numbers in the prose of pages are those of the tables that they sum up."""

import re
from pathlib import Path
from statistics import median

import pytest

import collaborative_gym as cg
from collaborative_gym.certificate.report import TEAM, Certificate
from collaborative_gym.evaluation.table11 import THESIS
from collaborative_gym.files import read_sealed
from collaborative_gym.tasks.registry import get_env, list_tasks

ROOT = Path(__file__).parents[1]

TEN = [*THESIS, "BalancePathSawyers-v0", "BalancePathJacoSawyer-v0"]
"""The cooperative pairs."""


def read(path):
    """Return a page's text, however its lines are broken."""
    return " ".join((ROOT / path).read_text().split())


def table(name):
    return read_sealed(ROOT / "docs" / "tables" / f"{name}.json", "fetch it again")


def percent(share):
    return f"{100 * share:.0f} %"


def test_the_readme_has_the_results_of_table_11():
    readme = (ROOT / "README.md").read_text()
    table11 = (ROOT / "docs" / "tables" / "table11.md").read_text()
    for env_id in THESIS:
        row = re.search(rf"^\| {env_id} \| (.*) \|$", readme, re.M)
        cells = re.findall(
            rf"^\| {env_id} \| [a-z ]+ \| ([^|]+) \| (.+?) (?:PASS|FAIL) \|",
            table11,
            re.M,
        )
        (reward, *shares) = cells
        assert row and row[1].split(" | ") == [*shares[0], *shares[1], *reward]


def test_pages_say_the_speeds_of_the_table():
    page = (ROOT / "docs" / "performance.md").read_text()
    rows = re.findall(r"^\| (\S+-v0) \| (.+) \|$", page, re.M)
    cells = {env_id: row.replace(",", "").split(" | ") for env_id, row in rows}
    pairs = [row for env_id, row in cells.items() if len(get_env(env_id).robots) == 2]
    speeds = [round(int(row[i]), -2) for row in pairs for i in (1, 4)]
    readme = (ROOT / "README.md").read_text()
    assert f"Two cores run {min(speeds):,} to {max(speeds):,} control" in readme
    expert, random = (
        sorted(int(row[i].rstrip("%")) for row in cells.values()) for i in (2, 5)
    )
    text = " ".join(page.split())
    assert f"{median(expert)} % of bare physics in the median, {expert[0]} % a" in text
    assert f"with random ones {median(random)} and {random[0]} %" in text


def test_pages_count_the_tasks_those_for_teams_and_the_arms():
    words = dict(enumerate(("six", "seven", "eight", "nine", "ten", "eleven"), 6))
    tasks = [cg.task(name) for name in list_tasks()]
    count, arms = words[len(tasks)], words[len(cg.list_robots())]
    teams = words[sum(len(task.robot_counts) > 2 for task in tasks)]
    readme, index, compared = (
        " ".join((ROOT / path).read_text().split())
        for path in ("README.md", "docs/index.md", "docs/comparison.md")
    )
    for page in readme, index:
        assert f"or compete: {count} tasks, {arms} commercial arms" in page
        assert f"of {count} tasks, played" in page
    assert f"and {teams} take [teams of two to eight](docs/teams.md)" in readme
    assert f"eight arms do {teams} of the {count} tasks here" in compared


def test_the_page_on_robustness_says_what_its_table_has():
    page, cells = read("docs/robustness.md"), table("robustness")

    def both(row):
        completion, performance = cells[row]["all"]
        return f"{percent(completion)} (performance {percent(performance)}"

    lost = {
        (row.split("-")[0], what): percent(own[what][0])
        for row, own in cells.items()
        for what in own
        if row.endswith("baseline")
        and what not in ("all", "episodes")
        and own["none"][0] - own[what][0] > 0.0401
    }
    assert {what for _, what in lost} == {"starts"}
    assert "only the wider starts cost a baseline more than 4 points" in page
    for (name, _), share in lost.items():
        assert re.search(rf"{name} (falls )?to {share}", page), name
    worst = cells["LiftTaskSawyers-v0 baseline"]["all"][1]
    others = min(
        own["all"][1]
        for row, own in cells.items()
        if row.endswith("baseline") and not row.startswith("LiftTaskSawyers")
    )
    assert f"LiftTaskSawyers' performance is {percent(worst)}" in page
    assert f"the others keep at least {percent(others)}" in page
    assert f"it completes {both('LiftTaskJacos-v0 baseline')})" in page
    assert f"completes {both('LiftTaskJacos-v0 expert')})" in page
    balance = cells["BalancePathJacoSawyer-v0 expert"]["all"][0]
    assert f"for BalancePathJacoSawyer's, {percent(balance)}," in page


def test_results_say_what_seeds_and_strain_are():
    page, seeds, strain = read("docs/results.md"), table("seeds"), table("strain")
    short = [
        own
        for runs in seeds.values()
        for name, own in runs.items()
        if name != "baseline"
    ]
    few = [own for own in short if own["completion"] < 0.98]
    assert len(few) == 1 and len(short) == 2 * len(TEN)
    assert f"All seeds but one ({100 * few[0]['completion']:g} %)" in page
    passes, rest = (
        min(
            own["late"]
            for env_id, runs in seeds.items()
            for own in runs.values()
            if env_id.startswith("Pass") is is_pass
        )
        for is_pass in (True, False)
    )
    late = f"with late actions {percent(rest)} or more (Pass: {100 * passes:.0f})."
    assert late in page
    more = max(
        own["energy_commanded"][0] / own["energy"][0]
        for runs in strain.values()
        for own in runs.values()
    )
    assert f"`energy_commanded`, up to {more:.1f} times `energy`" in page


@pytest.mark.parametrize("task", ["Poke", "Lift", "Pass"])
def test_the_egos_table_sums_up_their_pairings(task):
    found = table("egos")[f"{task}TaskSawyers-v0"]
    names, rows = found["players"], found["means"]["completion"]
    listed = re.search(
        r"`ego` learned with ([^:]+(?::[^:]+)*?): completion ([\d.]+ %)"
        r"(?:; with strangers, .+?: ([\d.]+ %))?",
        read("docs/tables/egos.md").split(f"{task}TaskSawyers-v0")[1],
    )
    standings = found["standings"]
    own = standings["ego"]["self-play"]["completion"]
    other = standings["baseline"]["cross-play"]["completion"][0]
    worst = min(*rows[0][1:], *(row[0] for row in rows[1:]))
    numbers = listed[2], listed[3], *map(percent, (worst, own, other))
    assert names[0] == "ego"
    assert f"| {task} | {' | '.join(numbers)} |" in read("docs/strangers.md")


def test_pages_say_how_fast_teams_are():
    table = read("docs/tables/teams_speed.md")
    rows = re.findall(r"\| (\d+) % \| ([\d.]+) \|", table)
    assert len(rows) > 20
    kept, growth = min(int(row[0]) for row in rows), max(float(r[1]) for r in rows)
    assert f"(tables/teams_speed.md): {kept} %)" in read("docs/performance.md")
    assert f"grows by at most {100 * growth - 100:.0f} %" in read("docs/teams.md")
    own = re.search(r"\| Pass \| 2 \| ([\d,]+)", table)
    speed = round(int(own[1].replace(",", "")), -3)
    assert f"One core runs [{speed:,}](docs/tables/teams_speed.md)" in read("README.md")


def test_pages_say_what_certificates_found():
    certify = read("docs/certify.md")
    found = [Certificate.load(ROOT / f"docs/certificates/{i}.json") for i in TEN]
    blind = max(t.completed for c in found for t in c.rows[TEAM])
    assert f"reaches the goal on at most {blind} of 500 starts" in certify
    assert f"up to {blind} ([below]" in read("docs/teamwork.md")
    idle, limp = (
        [
            trial.completion
            for certificate in found
            if "BalanceTask" in certificate.environment
            for trial in certificate.trials
            if trial.partner == how and trial.player == "expert"
        ]
        for how in ("idle", "limp")
    )
    assert f"on {100 * min(idle):.0f} to {percent(max(idle))} of starts" in certify
    assert f"beside a limp one on up to {percent(max(limp))}." in certify
    searches = [t.converged for c in found for t in c.trials if t.converged is not None]
    told = f"Of their {len(searches)} searches, {sum(searches)} converged."
    assert told in certify
    for certificate in found:
        if "BalanceTask" not in certificate.environment:
            early = [t for t in certificate.trials if t.row != TEAM and not t.fraction]
            assert not any(trial.completed for trial in early)
