import os
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

import collaborative_gym as cg
from collaborative_gym.cli.main import main
from collaborative_gym.cli.train import read_seeds
from collaborative_gym.learning import baselines, many
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.config import RECIPES
from collaborative_gym.learning.display import Display
from collaborative_gym.learning.folder import LAST
from collaborative_gym.learning.many import Outcome

THREADS = ["--num-threads", "1", "--torch-threads", "1"]
SIZES = """
--num-envs 4 --rollout-steps 8 --epochs 2 --minibatch-size 16 --hidden-sizes 16 16
--validation-interval 128 --validation-episodes 4 --checkpoint-interval 64
"""
TINY = [*SIZES.split(), *THREADS]
"""Updates after 32 steps each, with a checkpoint after every second one."""

IN_A_PROCESS = """
import sys
sys.path.insert(0, sys.argv.pop(1))
import collaborative_gym as cg
from conftest import Carry
from collaborative_gym.cli.main import main
from collaborative_gym.cli.train import read_seeds
from collaborative_gym.learning import monitor

monitor.draw_curve = lambda *_: None
cg.register_task("Carry", Carry)
cg.register_env(cg.EnvSpec("CarryPandas-v0", Carry, ("panda", "panda")))
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    """Leave out the drawing of curves, most of a small run's time."""
    monkeypatch.setattr(
        "collaborative_gym.learning.monitor.draw_curve",
        lambda rows, title, path: path.write_bytes(b"a curve"),
    )


@contextmanager
def ctrl_c_after(steps):
    """Press Ctrl-C when a run shows so many steps."""
    show = Display.show

    def shown(self, row, best=None):
        show(self, row, best)
        if row["steps"] == steps:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Display, "show", shown)
        yield


@pytest.fixture
def curve(read_progress):
    """Return a function that gives a run's rows without what a clock says."""
    times = ("seconds", "core_seconds", "steps_per_second")
    return lambda folder: [
        {name: value for name, value in row.items() if name not in times}
        for row in read_progress(folder)
    ]


def num_updates(folder):
    """Return how many updates a run has shown so far, -1 before its folder is there."""
    file = folder / "progress.csv"
    if not (folder / LAST).exists() or not file.exists():
        return -1
    return max(0, file.read_text().count("\n") - 1)


def test_train_writes_a_run_whose_folder_is_a_policy(carry_id, tmp_path, capsys):
    folder = tmp_path / "run"
    arguments = ["train", carry_id, "--output", str(folder), "--total-steps", "64"]
    assert main([*arguments, "--mode", "independent", "--seed", "3", *TINY]) == 0
    assert capsys.readouterr().out == f"wrote {folder / 'policy.safetensors'}\n"
    settings = Checkpoint.load(folder / LAST).settings
    assert (settings.mode, settings.seed) == ("independent", 3)
    assert settings.hyperparameters.hidden_sizes == (16, 16)
    assert main(["evaluate", carry_id, "--policy", str(folder), "--episodes", "2"]) == 0


def test_a_run_shorter_than_an_update_says_what_it_trained(carry_id, tmp_path, capsys):
    arguments = ["train", carry_id, "--output", str(tmp_path), "--total-steps", "1"]
    assert main([*arguments, *TINY]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(
        "trained 32 steps, not 1: an update takes 32 steps, which are --num"
    )


def test_what_is_given_overrules_the_recipe_even_where_it_is_the_default(
    carry_id, tmp_path, monkeypatch
):
    monkeypatch.setitem(RECIPES, carry_id, {"initial_std": 0.1, "total_steps": 32})
    for name, given, expected in (
        ("recipe", [], 0.1),
        ("default", ["--initial-std", "0.2"], 0.2),
        ("other", ["--initial-std", "0.3"], 0.3),
    ):
        folder = tmp_path / name
        assert main(["train", carry_id, "--output", str(folder), *TINY, *given]) == 0
        numbers = Checkpoint.load(folder / LAST).settings.hyperparameters
        assert (numbers.initial_std, numbers.total_steps) == (expected, 32)


def test_advice_brings_its_hyperparameters(carry_id, tmp_path, capsys, monkeypatch):
    given = ["--advised", "--total-steps", "32", *TINY]
    one = ["train", carry_id, *given, "--output", str(tmp_path / "one")]
    assert main([*one, "--imitation", "7"]) == 0
    numbers = Checkpoint.load(tmp_path / "one" / LAST).settings.hyperparameters
    assert (numbers.imitation, numbers.target_kl) == (7.0, 0.0)
    planned = []
    monkeypatch.setattr(many, "finish", lambda plans, *_: planned.extend(plans) or ())
    several = ["train", carry_id, *given, "--seeds", "1", "2"]
    assert main([*several, "--output", str(tmp_path)]) == 0
    assert len(planned) == 2
    for plan in planned:
        numbers = plan.given["hyperparameters"]
        assert (numbers.imitation, numbers.target_kl) == (1000.0, 0.0)
    assert main(["train", carry_id, "--advised", "--algorithm", "sac"]) != 0
    assert "sac takes no advice; leave it out" in capsys.readouterr().err


def test_ctrl_c_ends_a_run_and_resume_goes_on(curve, carry_id, tmp_path, capsys):
    arguments = ["train", carry_id, "--total-steps", "192", *TINY, "--output"]
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert main([*arguments, str(whole)]) == 0
    with ctrl_c_after(96):
        assert main([*arguments, str(cut)]) == 130
    early = "before the first validation, so there is no policy yet"
    stopped = f"stopped after 96 steps {early}; continue with --resume {cut}\n"
    assert capsys.readouterr().err.endswith(stopped)
    # What it was started with need not be given again, not even the environment.
    assert main(["train", "--resume", str(cut), *THREADS]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"wrote {cut / 'policy.safetensors'}\n"
    assert curve(cut) == curve(whole)
    policies = [(each / "policy.safetensors").read_bytes() for each in (whole, cut)]
    assert policies[0] == policies[1]


def test_a_killed_run_goes_on_as_if_nothing_had_been(curve, carry_id, tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    steps, update, pause = 32 * 24, random.randrange(16), random.uniform(0.0, 0.05)
    arguments = ["train", carry_id, "--total-steps", str(steps), *TINY, "--output"]
    tests = str(Path(__file__).parents[1])
    process = subprocess.Popen(
        [sys.executable, "-c", IN_A_PROCESS, tests, *arguments, str(cut)],
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline and num_updates(cut) <= update:
            assert process.poll() is None
            time.sleep(0.002)
        time.sleep(pause)
    finally:
        process.kill()
    moment = f"{pause} s after update {update}"
    assert process.wait() == -signal.SIGKILL, moment
    assert Checkpoint.load(cut / LAST).backend["steps"] < steps
    assert main(["train", carry_id, "--resume", str(cut), *THREADS]) == 0
    assert main([*arguments, str(whole)]) == 0
    assert curve(cut) == curve(whole), moment
    for name in ("policy.safetensors", "config.json"):
        assert (cut / name).read_bytes() == (whole / name).read_bytes()
    assert not list(cut.glob(".*"))


def test_resume_shows_the_runs_own_length(carry_id, tmp_path, monkeypatch, capsys):
    folder, totals = tmp_path / "run", []
    arguments = ["train", carry_id, "--output", str(folder), "--total-steps", "64"]
    assert main([*arguments, *TINY]) == 0
    init = Display.__init__

    def made(self, title, total_steps, *others):
        totals.append((title, total_steps))
        init(self, title, total_steps, *others)

    monkeypatch.setattr(Display, "__init__", made)
    resume = ["train", "--resume", str(folder), *THREADS]
    assert main(resume) == 0
    complete = "the run was complete; to go on, give more --total-steps"
    assert complete in capsys.readouterr().out
    assert main([*resume, "--total-steps", "96"]) == 0
    assert complete not in capsys.readouterr().out
    assert totals == [(carry_id, 64), (carry_id, 96)]
    assert Checkpoint.load(folder / LAST).backend["steps"] == 96


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "name environments to train, or pass --all"),
        ("--seeds 0 1", "name environments to train, or pass --all"),
        ("Carry --seeds 0-x", "numbers and ranges, such as 0 1 2 or 0-9; got '0-x'"),
        ("Carry --seeds 3-1", "--seeds 3-1 must go up"),
        ("Carry --seeds 0-1 1", "seed1 is asked for twice"),
        ("Carry --seeds 0 --seed 1", "--seed is for one run; give --seeds instead"),
        ("Carry --jobs 2 --resume run", "--resume is for one run; give the same comm"),
        ("Carry --modes shared --mode shared", "--mode or --modes, not both"),
        ("Carry --jobs -1", "jobs must be at least 0"),
        ("Cary", "did you mean 'Carry'?"),
        ("Carry --device gpu", "no device 'gpu'; give cpu or cuda"),
        ("Carry --backend jax", "backends: ray, skrl"),
        ("Carry --algorithm sac --clip 0.1", "sac knows no clip; leave out"),
        ("Carry --polyak 0.1", "ppo knows no polyak; leave out"),
        ("Carry --algorithm sac --partner idle", "choose the algorithm ppo"),
        ("Carry --num-robots 3", "needs 2 robots, got 3"),
        ("Carry --randomization none", "default, hard, lost, paper, wide"),
        ("Carry --seed -1", "seed must be at least 0"),
        ("Carry --total-steps 0", "--total-steps must be at least 1"),
        ("Carry --discount 2", "discount must be 0 to 1, got 2.0"),
        ("Carry --num-threads -1", "--num-threads must be at least 0"),
        ("Carry --output a --resume run", "either output, for a new run, or resume"),
        ("Poke --resume run", "environment is Poke, not Carry; task is"),
        ("--resume run --discount 0.5", "discount is 0.5, not"),
        ("--resume run --mode shared", "mode is shared, not collaborative"),
        ("--all --mode shared", "mode does not go with --all"),
        ("--all --algorithm sac", "algorithm does not go with --all"),
        ("--all --seed 0", "seed does not go with --all"),
        ("--all --jobs -1", "jobs must be at least 0"),
        ("Cary --all", "did you mean 'Carry'?"),
        ("--all --resume run", "resume does not go with --all"),
        ("Carry --seeds", "--seeds takes a value, or several"),
        ("Carry --partner self", "self is for opponents; a partner is a policy"),
        (
            "Carry --population 3",
            "population would mean nothing without --partner population",
        ),
        (
            "Carry --league-decay 0.9",
            "--league-decay would mean nothing without --opponent league",
        ),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    carry_id, capsys, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    if "run" in arguments:
        small = ["--output", "run", "--total-steps", "1", *TINY]
        assert main(["train", "Carry", *small]) == 0
        capsys.readouterr()
    before = sorted(tmp_path.rglob("*"))
    assert main(["train", *arguments.split()]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ") and printed.err.count("\n") == 1
    assert message in printed.err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("Carry --mode alone", "collaborative"),
        ("Carry --activation gelu", "elu"),
    ],
)
def test_a_choice_names_what_there_is(carry_id, capsys, arguments, message):
    assert main(["train", *arguments.split()]) == 2
    assert message in capsys.readouterr().err


def test_a_missing_or_foreign_folder_is_named(carry_id, capsys, tmp_path):
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / LAST).write_text("something else")
    for folder, status in ((tmp_path / "nowhere", 2), (foreign, 2)):
        assert main(["train", carry_id, "--resume", str(folder)]) == status
        printed = capsys.readouterr().err
        assert str(folder / LAST) in printed and printed.count("\n") == 1


def test_a_folder_with_a_run_is_not_overwritten(carry_id, capsys, tmp_path):
    arguments = ["train", carry_id, "--output", str(tmp_path), "--total-steps", "1"]
    assert main([*arguments, *TINY]) == 0
    before = (tmp_path / LAST).read_bytes()
    assert main([*arguments, *TINY]) == 2
    assert "continue it (--resume)" in capsys.readouterr().err
    assert (tmp_path / LAST).read_bytes() == before


def test_all_trains_in_a_process_and_writes_cards(
    simple_pick, capsys, tmp_path, monkeypatch
):
    four = dict.fromkeys(baselines._EPISODES, 4)
    monkeypatch.setattr(baselines, "_EPISODES", four)
    monkeypatch.setattr(baselines, "_CHOICE_EPISODES", 4)
    monkeypatch.setattr(cg, "list_envs", lambda: ["SimplePick-v0"])
    arguments = ["train", "--all", "--seeds", "0", "--output", str(tmp_path)]
    arguments += ["--total-steps", "64", *TINY]
    card = tmp_path / "SimplePick-v0.md"
    for _ in range(2):
        assert main(arguments) == 0
        assert capsys.readouterr().out == f"wrote {card}\n"
    rows = re.findall(r"^\| ([01]) .*\| paper \|", card.read_text(), re.M)
    assert rows == ["0"]


@pytest.mark.parametrize(
    ("words", "seeds"),
    [("", ()), ("3", (3,)), ("0-3", (0, 1, 2, 3)), ("7 0-1 4", (7, 0, 1, 4))],
)
def test_seeds_are_numbers_and_ranges(words, seeds):
    assert read_seeds(words.split()) == seeds


def test_several_runs_in_one_command_and_what_failed(
    carry_id, tmp_path, capsys, monkeypatch
):
    """The runs themselves are those of `train_all`, and tested there."""
    asked = []

    def finish(plans, jobs, resources, on_row):
        asked.extend(plans)
        on_row(plans[0], {"steps": 64}, {})
        done = [Outcome(plan.folder, object()) for plan in plans]
        return (done[0], Outcome(plans[1].folder, None, "no memory"), *done[2:])

    monkeypatch.setattr(many, "finish", finish)
    line = f"train {carry_id} --modes independent shared --seeds 0-1 --discount 0.5"
    arguments = [*line.split(), "--total-steps", "64", "--output", str(tmp_path)]
    assert main(arguments) == 1
    names = [f"{carry_id}-{m}-seed{s}" for m in ("independent", "shared") for s in "01"]
    assert [plan.folder for plan in asked] == [tmp_path / name for name in names]
    assert asked[0].given["hyperparameters"].discount == 0.5
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        f"wrote {tmp_path / name}" for name in names if name != names[1]
    ]
    assert "1 of 4 runs done, 0 begun, 64 of 256 steps" in printed.err
    last = printed.err.splitlines()[-2:]
    assert last == [
        "error: 1 of 4 runs failed:",
        f"{tmp_path / names[1]}: no memory",
    ]
