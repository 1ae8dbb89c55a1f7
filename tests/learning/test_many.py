"""Many runs at a time: what a crew of processes does; and, slow, real ones."""

import json
import os
import pickle
import signal
import subprocess
import sys
from io import BytesIO

import pytest

import collaborative_gym as cg
from collaborative_gym.learning import many
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.folder import LAST
from collaborative_gym.learning.many import Plan, finish

CHILD = """
import pickle, signal, sys, time
from pathlib import Path
modules, folder = pickle.load(sys.stdin.buffer)
given = pickle.load(sys.stdin.buffer)

def send(message):
    pickle.dump(message, sys.stdout.buffer)
    sys.stdout.buffer.flush()

if folder.name == "killed":
    print("no memory", file=sys.stderr)
    sys.exit(3)
folder.mkdir(exist_ok=True)
(folder / "began").write_text(f"{time.monotonic()} {given['resources'].num_threads}")
for steps in range(0, 128, 32):
    send(({"steps": steps + 32}, {}))
    time.sleep(0.02)
# Until it is told to stop, if it is to be stopped.
if given["mode"] == "stopped" and "output" in given:
    sys.stdin.buffer.read()
    (folder / "last.pt").write_text("")
    send(None)
else:
    (folder / "ended").write_text(str(time.monotonic()))
    send({"folder": str(folder)})
"""
"""What does as `train_one` does, but trains nothing."""


@pytest.fixture
def crew(monkeypatch, tmp_path):
    """Return a function that lets stand-ins do runs, and gives what became of them."""
    command = [sys.executable, "-c", CHILD]
    monkeypatch.setattr(many, "_COMMAND", command)

    def crew(*names, jobs=1, mode=None, on_row=lambda *_: None):
        plans = [Plan(tmp_path / name, 128, {"mode": mode}) for name in names]
        return finish(plans, jobs, None, on_row)

    return crew


def times(folder):
    began, threads = (folder / "began").read_text().split()
    return float(began), float((folder / "ended").read_text()), int(threads)


def test_so_many_runs_at_a_time_each_with_one_thread(crew, tmp_path):
    crew("a", "b", "c", jobs=2)
    spans = [times(tmp_path / name) for name in "abc"]
    assert [threads for *_, threads in spans] == [1, 1, 1]
    # The third waits for one of the first two.
    assert spans[2][0] > min(spans[0][1], spans[1][1])
    crew("d")
    assert times(tmp_path / "d")[2] == 0


def test_rows_of_all_are_shown(crew):
    rows = []
    crew("a", "b", jobs=2, on_row=lambda plan, row, best: rows.append((plan, row)))
    for name in "ab":
        own = [row["steps"] for plan, row in rows if plan.folder.name == name]
        assert own == [32, 64, 96, 128]


def test_a_run_that_fails_does_not_end_the_others(crew, tmp_path):
    failed, done = crew("killed", "b")
    assert failed.reason == "its process ended with status 3: no memory"
    assert failed.folder == tmp_path / "killed" and failed.result is None
    assert done == {"folder": str(tmp_path / "b")}


def test_ctrl_c_stops_all_and_the_same_call_goes_on(crew, tmp_path):
    rows = []

    def press(plan, row, best):
        rows.append(row)
        if len(rows) == 8:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt, match="0 of 3 runs finished; the same comm"):
        crew("a", "b", "c", jobs=2, mode="stopped", on_row=press)
    assert not (tmp_path / "c").exists()
    assert not (tmp_path / "a" / "ended").exists()
    assert len(crew("a", "b", "c", jobs=2)) == 3
    assert (tmp_path / "a" / "ended").exists()


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"envs": ()}, ValueError, "give at least one environment"),
        ({"envs": ["Pok"]}, KeyError, "did you mean 'Poke'"),
        ({"envs": [3]}, TypeError, "each environment must be a string, got 3"),
        ({"modes": ()}, ValueError, "give at least one mode"),
        ({"modes": ["alone"]}, (KeyError, ValueError), "alone"),
        ({"seeds": ()}, ValueError, "give at least one seed"),
        ({"seeds": 3}, TypeError, "one seed or several, got 3"),
        ({"seeds": (1, 1)}, ValueError, "seed1 is asked for twice"),
        ({"seeds": (-1,)}, ValueError, "seed must be at least 0"),
        ({"jobs": -1}, ValueError, "jobs must be at least 0"),
        ({"changes": {"epoch": 3}}, KeyError, "did you mean 'epochs'"),
        ({"changes": {"epochs": 0}}, ValueError, "epochs must be at least 1"),
        ({"resources": 3}, TypeError, "resources must be Resources"),
        ({"on_row": 3}, TypeError, "on_row must be a function or None"),
        ({"partnr": "idle"}, TypeError, "'partnr'.*did you mean 'partner'"),
    ],
)
def test_bad_input_shows_before_any_work(given, error, message, tmp_path, monkeypatch):
    monkeypatch.setattr(many, "_COMMAND", ["false"])
    with pytest.raises(error, match=message):
        cg.train_all(**({"envs": "Poke", "output": tmp_path / "runs"} | given))
    assert not (tmp_path / "runs").exists()


def test_a_run_that_goes_on_writes_how_long_it_is_to_be(train_tiny, tiny):
    """So that a comparison knows whether it is finished."""
    first = train_tiny(hyperparameters=tiny(total_steps=32))
    train_tiny(resume=first.folder, hyperparameters=tiny(total_steps=64))
    config = json.loads((first.folder / "config.json").read_text())
    assert config["hyperparameters"]["total_steps"] == 64


@pytest.mark.slow
@pytest.mark.parametrize(("total_steps", "is_done"), [(32, True), (64, False)])
def test_a_run_at_its_end_is_not_stopped(total_steps, is_done, tiny, tmp_path):
    """Ctrl-C during its last update finds it finished."""
    code = (
        "from collaborative_gym.learning import many\n"
        "many.train = lambda on_row, **_: on_row({'steps': 32}, {})\n"
        "many.train_one()"
    )
    given = {"output": tmp_path, "hyperparameters": tiny(total_steps=total_steps)}
    child = subprocess.run(
        [sys.executable, "-c", code],
        input=pickle.dumps(((), tmp_path)) + pickle.dumps(given),
        stdout=subprocess.PIPE,
        check=True,
    )
    said = BytesIO(child.stdout)
    assert pickle.load(said) == ({"steps": 32}, {})
    assert (pickle.load(said) is not None) == is_done


@pytest.mark.slow
def test_real_runs_end_as_those_that_train_alone(tiny, alone, tmp_path, simple_pick):
    """Also with a task of the user's own, and after one that cannot go on."""
    numbers = vars(tiny(total_steps=64))
    (tmp_path / "SimplePick-v0-shared-seed1").mkdir()
    (tmp_path / "SimplePick-v0-shared-seed1" / LAST).write_text("damaged")
    done, failed = cg.train_all(
        "SimplePick-v0",
        "shared",
        seeds=(0, 1),
        jobs=2,
        output=tmp_path,
        changes=numbers,
    )
    assert done.result.steps == 64 and "damaged" in failed.reason
    own = cg.train(
        "SimplePick-v0",
        "shared",
        output=tmp_path / "own",
        hyperparameters=tiny(total_steps=64),
        resources=alone,
    )
    files = [f / "policy.safetensors" for f in (done.folder, own.folder)]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert Checkpoint.load(done.folder / LAST).backend["steps"] == 64


def test_runs_in_another_action_mode_have_folders_of_their_own(monkeypatch):
    name, planned = "PokeTaskSawyers-v0", []
    monkeypatch.setattr(many, "finish", lambda plans, *_: planned.extend(plans))
    cg.train_all([name, cg.task(name, action="tcp")], "collaborative")
    assert [plan.folder.name for plan in planned] == [
        f"{name}-collaborative-seed0",
        f"{name}-tcp-collaborative-seed0",
    ]
