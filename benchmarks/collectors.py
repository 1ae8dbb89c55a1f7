"""How fast worlds are collected from, in this process and in processes of Ray.

    python benchmarks/collectors.py [--env ID] [--seconds S] [--json FILE]

Every number is environment steps per second of wall time, the median of five turns;
a step is one control step of one world. All run in turn on the same machine with one
torch thread per process and networks of 2 x 256, in mode `independent`. The physics of
a process runs on one thread, or on all CPUs where it says so. "Physics" is the
simulation alone, which no collector can exceed. "Training" has the updates too.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym.learning.config import Hyperparameters, Resources
from collaborative_gym.learning.run import Run
from collaborative_gym.learning.settings import make_settings
from collaborative_gym.tasks.registry import make_task

TURNS = 5


def rate(turn: Callable[[], int], seconds: float) -> float:
    """Return steps per second, from a function that returns how many steps it did."""
    turn()
    rates = []
    for _ in range(TURNS):
        steps, started = 0, time.perf_counter()
        while time.perf_counter() - started < seconds / TURNS:
            steps += turn()
        rates.append(steps / (time.perf_counter() - started))
    return statistics.median(rates)


def physics(env_id: str, num_threads: int, seconds: float) -> float:
    """Return the rate of the simulation alone, in the worlds' first episodes."""
    env = cg.make_vec(env_id, num_envs=256, seed=0, num_threads=num_threads)
    env.reset()
    controls = np.repeat(env.sim.ctrl[:, None], env.substeps, axis=1)

    def turn() -> int:
        env.sim.step(controls)
        return 256

    return rate(turn, seconds)


def our_collectors(
    env_id: str, count: int, num_threads: int, seconds: float
) -> tuple[float, float]:
    """Return the rates of collecting alone, and of training; 0 for this process."""
    task = make_task(env_id)
    settings = make_settings(
        task,
        None,
        mode="independent",
        seed=0,
        backend="ray" if count else None,
        hyperparameters=Hyperparameters(),
    )
    resources = Resources(num_threads=num_threads, num_collectors=count)

    def collect() -> int:
        return sum(each.steps for each in run.collect())

    def advance() -> int:
        before = run.steps
        run.advance()
        return run.steps - before

    with (
        TemporaryDirectory() as folder,
        closing(Run(Path(folder), task, settings=settings, resources=resources)) as run,
    ):
        return rate(collect, seconds), rate(advance, seconds)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--env", default="LiftTaskSawyers-v0")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows: dict[str, tuple[float, float | None]] = {}
    for threads, cpus in ((1, "one thread"), (0, "all CPUs")):
        name = f"physics, 256 worlds, {cpus}"
        rows[name] = physics(options.env, threads, options.seconds), None
        name = f"this process, 256 worlds, {cpus}"
        rows[name] = our_collectors(options.env, 0, threads, options.seconds)
    for count in (1, 2):
        name = f"Ray, 256 worlds, processes: {count}"
        rows[name] = our_collectors(options.env, count, 1, options.seconds)
    show(options.env, rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def show(env_id: str, rows: dict[str, tuple[float, float | None]]) -> None:
    """Print the rates, and what a second process brings."""
    table = Table(title=f"{env_id}, environment steps per second")
    table.add_column("")
    for head in ("collecting", "training"):
        table.add_column(head, justify="right")
    for name, (collecting, training) in rows.items():
        last = "" if training is None else f"{training:,.0f}"
        table.add_row(name, f"{collecting:,.0f}", last)
    *_, one, two = rows.values()
    table.caption = (
        f"From 1 to 2 processes: collecting {two[0] / one[0]:.2f} x, training"
        f" {(two[1] or 0) / (one[1] or 1):.2f} x"
    )
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
