"""Tables in Markdown."""

import json

import pytest

import collaborative_gym as cg
from collaborative_gym.cards import report_card
from collaborative_gym.evaluation.table import markdown_table

NAMES = ["a|b", "two\nlines", "<script>alert(1)</script>", "[here](javascript:x)"]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_stays_in_its_cell_and_does_nothing(name):
    lines = markdown_table([name, "n"], [[name, "1"], ["other", name]]).splitlines()
    assert len(lines) == 4
    assert {line.replace("\\|", "").count("|") for line in lines} == {3}
    told = "\n".join(lines)
    assert "<" not in told and "[" not in told.replace("\\[", "")
    assert "other" in told


def test_numbers_are_at_the_right():
    table = markdown_table(["name", "one", "two"], [["a", "1", "2"]], words=1)
    assert table == "| name | one | two |\n| --- | ---: | ---: |\n| a | 1 | 2 |"


def test_players_of_any_name_make_a_card(carry):
    few = {"episodes": 2, "disturbed": 1, "paired": 2, "num_threads": 1}
    card = report_card(carry(), dict.fromkeys(NAMES, "idle"), **few)
    page = card.to_markdown()
    assert "<script" not in page and "\nlines" not in page
    for block in page.split("\n\n"):
        if block.startswith("|"):
            lines = block.replace("\\|", "").splitlines()
            assert len({line.count("|") for line in lines}) == 1, block
    assert json.loads(card.to_json())["policies"].keys() == set(NAMES)


def test_a_report_names_any_environment(carry):
    task = carry()
    task.name = "<b>|x\ny"
    assert "<b>" not in cg.evaluate(task, "idle", episodes=2).to_markdown()
