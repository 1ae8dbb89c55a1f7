"""The four ways to train a team, on one environment: who has a policy, who a critic.

    pip install -e ".[train]"
    python examples/train_modes.py
    python examples/train_modes.py --env Balance --total-steps 1000000

The script trains each mode into a folder of its own; a second start continues. It
prints a table of how the policies do in episodes on which none was trained, and draws
the learning curves into `modes.png`. It takes a few minutes.
"""

import csv
from pathlib import Path
from typing import get_args

import tyro
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym.learning.config import Mode


def draw_curves(folders: dict[str, Path], path: Path) -> None:
    """Draw the mean return over training steps of some runs."""
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    for mode, folder in folders.items():
        with (folder / "progress.csv").open() as file:
            # The first iterations end no episode.
            rows = [row for row in csv.DictReader(file) if row.get("return")]
        steps = [float(row["steps"]) for row in rows]
        axes.plot(steps, [float(row["return"]) for row in rows], label=mode)
    axes.set_xlabel("environment steps")
    axes.set_ylabel("return, summed over the robots, as they explore")
    axes.legend()
    figure.savefig(path, dpi=150)


def main(
    env: str = "PokeTaskSawyers-v0",
    total_steps: int = 300_000,
    num_envs: int = 64,
    episodes: int = 100,
    output: Path = Path("runs/modes"),
) -> None:
    """Train in every mode and compare.

    Args:
      env: an environment id or a task's name.
      total_steps: environment steps to learn from, in each mode.
      num_envs: worlds to learn from beside one another.
      episodes: to evaluate each policy.
      output: where the runs go.
    """
    numbers = cg.Hyperparameters(
        total_steps=total_steps, num_envs=num_envs, validation_episodes=episodes
    )
    table = Table("mode", "return", "completion", "time, s", title=env)
    folders = {mode: output / mode for mode in get_args(Mode)}
    with Progress() as progress:
        for mode, folder in folders.items():
            bar = progress.add_task(mode, total=total_steps)
            result = cg.train(
                env,
                mode,
                output=None if folder.exists() else folder,
                resume=folder if folder.exists() else None,
                hyperparameters=numbers,
                on_row=lambda row, _, bar=bar: progress.update(
                    bar, completed=row["steps"]
                ),
            )
            progress.update(bar, completed=result.steps)
            report = cg.evaluate(env, result.policy(), episodes=episodes)
            table.add_row(
                mode,
                f"{report.mean_reward.mean:.1f}",
                f"{report.completion.mean:.0%}",
                f"{result.seconds:.0f}",
            )
    Console().print(table)
    draw_curves(folders, output / "modes.png")
    print(f"wrote {output / 'modes.png'}")


if __name__ == "__main__":
    tyro.cli(main)
