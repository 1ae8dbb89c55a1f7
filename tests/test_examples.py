"""Every example runs as its user would run it, with small numbers."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@dataclass(frozen=True)
class Run:
    """How an example is run, and what it then prints.

    Attributes:
      prints: regular expressions that its output must match, in any order.
      arguments: what follows the file on the command line.
      program: what stands before it, where Python does not run it by itself.
      writes: files that it must leave in its working directory.
      needs: packages without which it is skipped.
      is_slow: whether it takes more than a few seconds.
    """

    prints: tuple[str, ...]
    arguments: str = ""
    program: str = ""
    writes: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    is_slow: bool = False


RUNS = {
    "evaluate_crossplay.py": Run(
        (r"baseline\W+100%\W+100%", r"expert\W+\d+%\W+100%"),
        "--policies baseline expert --episodes 4",
    ),
    "evaluate_policy.py": Run(
        (r"completion \| 100 %", "wrote episodes.csv"),
        "--episodes 4 --csv episodes.csv",
        writes=("episodes.csv",),
    ),
    "own_arm.py": Run((r"Pass with own and panda: 100% completed",), "--episodes 2"),
    "run_batched.py": Run(
        (
            r"robot_2 observes \(4, 54\)",
            r"step 200: 4 episodes ended .* completion 100%",
            r"step 400: 4 episodes ended",
            r"[\d,]+ environment steps per second",
        ),
        "--num-envs 4",
    ),
    "run_numpy_policy.py": Run(
        (
            r"PokeTaskSawyers-v0 with 2 sawyer, mode collaborative",
            r"robot_2 sees \(1, 21\), does \[",
            "torch was not imported",
        ),
    ),
    "run_pettingzoo.py": Run(
        (r"robot_1: [\d.]+ \(reach .*success", r"reached the goal after \d"),
    ),
    "simple_pick.py": Run(
        (r"SimplePick-v0\W+-?[\d.]+\W+100 %",),
        "--policy expert --episodes 2",
        "-m collaborative_gym evaluate SimplePick-v0 --module",
    ),
    "train_benchmarl.py": Run(
        (r"in the last 6,000 steps a robot's return was -[\d.]+",),
        "--total-steps 6000",
        needs=("benchmarl",),
        is_slow=True,
    ),
    "train_cleanrl.py": Run(
        (r"1,680 steps: return -[\d.]+", r"\| return \| -"),
        "--total-steps 1680 --num-envs 4 --rollout 210 --episodes 2",
        needs=("torch",),
        is_slow=True,
    ),
    "train_minari.py": Run(
        (
            "4 episodes, 800 steps",
            "replayed to the bit",
            r"\| return \| -",
        ),
        "--episodes 4 --updates 20 --tests 2",
        writes=("datasets/PokeTaskSawyers/expert-v0/data/main_data.hdf5",),
        needs=("minari", "h5py", "torch"),
        is_slow=True,
    ),
    "train_modes.py": Run(
        (r"(?s)collaborative\W+-.*independent\W+-.*shared\W+-.*centralized\W+-",),
        "--total-steps 256 --num-envs 1 --episodes 1 --output runs",
        writes=("runs/shared/policy.safetensors", "runs/modes.png"),
        needs=("torch", "skrl"),
        is_slow=True,
    ),
    "train_rllib.py": Run(
        (r"2,000 steps: return -[\d.]+", r"\| return \| -"),
        "--total-steps 2000 --steps-per-iteration 2000 --episodes 2 --output runs",
        writes=("runs/end.png", "runs/checkpoint"),
        needs=("ray",),
        is_slow=True,
    ),
    "train_stable_baselines3.py": Run(
        (
            r"one by one: [\d,]+ environment",
            r"ep_rew_mean\W+-\d+",
            r"\| return \| -",
        ),
        "--total-steps 2000 --num-envs 4 --episodes 2",
        needs=("stable_baselines3",),
        is_slow=True,
    ),
    "train_supersuit.py": Run(
        ("4 rows, 2 of each robot", r"\| return \| -"),
        "--total-steps 400 --num-envs 2 --episodes 2",
        needs=("supersuit", "stable_baselines3"),
        is_slow=True,
    ),
}
"""By file name in `examples/`."""


def cases():
    for path in sorted(EXAMPLES.glob("*.py")):
        is_slow = path.name in RUNS and RUNS[path.name].is_slow
        marks = (pytest.mark.slow,) if is_slow else ()
        yield pytest.param(path, id=path.stem, marks=marks)


@pytest.mark.parametrize("path", list(cases()))
def test_an_example_runs(path, tmp_path):
    assert path.name in RUNS, (
        f"{path.name} is not tested; add to RUNS how to run it and what it then prints"
    )
    run = RUNS[path.name]
    for package in run.needs:
        pytest.importorskip(package)
    finished = subprocess.run(
        [sys.executable, *run.program.split(), path, *run.arguments.split()],
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "100"},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert finished.returncode == 0, finished.stderr
    for pattern in run.prints:
        assert re.search(pattern, finished.stdout), (
            f"no {pattern!r} in what it printed:\n{finished.stdout}"
        )
    for file in run.writes:
        assert (tmp_path / file).stat().st_size > 0


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    for package in ("ipykernel", "skrl"):
        pytest.importorskip(package)
    notebook = nbformat.read(EXAMPLES / "five_minutes.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)
    for cell in notebook.cells:
        for long, short in (
            ("300_000", "2_000"),
            ("episodes=20", "episodes=2"),
            ("seconds=5", "seconds=1"),
        ):
            cell.source = cell.source.replace(long, short)
    client = nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    outputs = {cell.id: cell.get("outputs", []) for cell in notebook.cells}
    shown = {name: str(given) for name, given in outputs.items()}
    assert "robot_2 observes (21,)" in shown["make"]
    assert "image/png" in shown["look"] and "image/png" in shown["train"]
    assert "100 %" in shown["expert"]
    assert "baseline" in shown["evaluate"] and "100%" in shown["evaluate"]
    assert "video/mp4" in shown["film"]


def test_the_table_names_every_example():
    names = re.findall(
        r"^\| \[`(\w+\.(?:py|ipynb))`\]\(", (EXAMPLES / "README.md").read_text(), re.M
    )
    files = (*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*.ipynb"))
    assert sorted(names) == sorted(path.name for path in files)
