"""The pages of --help."""

import re
from pathlib import Path

import pytest

from collaborative_gym.cli.help import EXAMPLES
from collaborative_gym.cli.main import _VERBS, main

ROOT = Path(__file__).parents[2]


def page(capsys, *words):
    with pytest.raises(SystemExit, match="0"):
        main([*words])
    return capsys.readouterr().out


@pytest.mark.parametrize("verb", _VERBS)
def test_a_page_is_tidy_and_ends_with_examples(verb, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = page(capsys, verb, "--help")
    assert text == page(capsys, "help", verb)
    usage = text.partition("\n\n")[0].splitlines()
    assert all(line.startswith("    ") for line in usage[1:])
    assert not re.search(r"`|default:\s+False|\[(\w+) \[", text)
    assert not re.search(r"^.{1,60}\n--", text, re.M)  # a sentence that breaks early
    examples = text.partition("\nexamples:\n")[2].splitlines()
    assert examples and all(f"collaborative-gym {verb} " in each for each in examples)


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_are_right(example, monkeypatch):
    for kind in _VERBS.values():
        monkeypatch.setattr(kind, "run", lambda self: None)
    files = []  # Not loaded, since they would stay.
    monkeypatch.setattr("collaborative_gym.cli.main.load_modules", files.extend)
    assert main(example.split()) == 0
    assert all((ROOT / file).is_file() for file in files)


@pytest.mark.parametrize(
    ("verb", "own"),
    [("evaluate", "episodes"), ("tournament", "policies"), ("certify", "quick")],
)
def test_own_options_come_before_those_of_the_environment(verb, own, capsys):
    lines = page(capsys, verb, "--help").splitlines()
    words = [line[2:].split(" ")[0] for line in lines]
    places = list(map(words.index, (f"--{own}", "environment:", "--robots")))
    assert places == sorted(places)


def test_the_help_of_train_explains_its_length_and_names_the_rest_last(capsys):
    text = page(capsys, "train", "--help")
    options, _, names = text.partition("More options")
    assert "--total-steps INT" in options and "--num-envs INT" in options
    assert "--clip" in names and "--clip" not in options
    assert "--clip FLOAT" in page(capsys, "train", "--help-all")
