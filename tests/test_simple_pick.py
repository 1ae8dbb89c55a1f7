"""The tutorial's task, in one file outside of the package, is as good as our own."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

import collaborative_gym as cg
from collaborative_gym.testing import check_task

FILE = Path(__file__).parents[1] / "examples" / "simple_pick.py"
ID = "SimplePick-v0"


def test_it_is_short():
    assert len(FILE.read_text().splitlines()) <= 80


def test_it_keeps_every_promise(simple_pick):
    check_task(ID)


def test_arms_that_it_forgets_to_start_are_found(simple_pick, monkeypatch):
    kind = type(cg.task(ID))
    monkeypatch.setattr(kind, "start_arms", lambda *given, **named: None)
    said = r"robot_1 starts with every joint at 0; call self.start_arms\(\) in reset"
    with pytest.raises(AssertionError, match=said):
        check_task(ID, episodes=2)


@pytest.mark.parametrize("robots", [("panda", "jaco"), ("sawyer", "panda")])
def test_its_expert_succeeds_with_other_arms(simple_pick, robots):
    report = cg.evaluate(cg.task(ID, robots), "expert", episodes=10, num_threads=1)
    assert report.completion.mean == 1.0


def test_it_observes_what_the_thesis_says(simple_pick):
    env = cg.make_vec(ID, 2)
    assert env.single_observation_spaces["robot_1"].shape == (25,)
    assert env.single_action_spaces["robot_2"].shape == (8,)
    env.close()


def test_other_libraries_find_it_by_its_id(simple_pick):
    env = gymnasium.make(ID)
    assert env.reset(seed=0)[0] in env.observation_space
    env.close()


@pytest.fixture
def command(tmp_path):
    """Return a function that runs a command with the file as a module."""

    def command(*arguments, module=FILE):
        return subprocess.run(
            [sys.executable, "-m", "collaborative_gym", *arguments, "--module", module],
            cwd=tmp_path,
            env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "100"},
            capture_output=True,
            text=True,
            timeout=300,
        )

    return command


def test_commands_take_it(command, tmp_path):
    listed = command("list")
    assert ID in listed.stdout, listed.stderr
    given = "--episodes", "2", "--csv", "episodes.csv"
    played = command("evaluate", ID, "--policy", "expert", *given)
    assert "100 %" in played.stdout, played.stderr
    assert len((tmp_path / "episodes.csv").read_text().splitlines()) == 3
    measured = command("benchmark", ID, "--num-envs", "2")
    assert ID in measured.stdout, measured.stderr


@pytest.mark.slow
def test_it_is_trained_by_collectors_elsewhere(command):
    pytest.importorskip("ray")
    small = "--total-steps 64 --num-envs 4 --rollout-steps 8 --minibatch-size 32"
    rest = "--validation-episodes 2 --hidden-sizes 16 16 --output run"
    runners = "--backend", "ray", "--num-collectors", "1"
    options = *small.split(), *rest.split(), *runners
    trained = command("train", ID, *options)
    assert trained.returncode == 0, trained.stderr
    played = command("evaluate", ID, "--policy", "run", "--episodes", "2")
    assert "SimplePick-v0" in played.stdout, played.stderr


def test_a_module_that_is_missing_is_bad_input(command):
    missing = command("list", module="nowhere.py")
    assert missing.returncode != 0
    assert missing.stderr.strip() == "error: there is no file nowhere.py"
