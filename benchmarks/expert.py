"""How well each task's expert does, in every environment and with every pair of arms.

    python benchmarks/expert.py [--json FILE] [NAME ...]

Names are environment ids or tasks of two arms; none means all. Environments play 100
episodes of seed 0 on the `default` randomisation, and as many with either arm idle;
pairs play 50. `benchmarks/teams.py` measures larger teams.
"""

import argparse
import json
from itertools import product
from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym.tasks.registry import get_env

COLUMNS = ("mean_reward", "completion", "performance", "time_to_success")


def measure(name: str, pair: tuple[str, str] | None) -> dict[str, object]:
    """Return a row of the table."""
    episodes = 100 if pair is None else 50
    row: dict[str, object] = {"name": name, "episodes": episodes}
    report = cg.evaluate(cg.task(name, pair), "expert", episodes=episodes)
    row["robots"] = pair or get_env(name).robots
    row |= {column: getattr(report, column).mean for column in COLUMNS}
    row["worst_reward"] = min(episode["return"] for episode in report.episodes)
    for agent in ("robot_1", "robot_2"):
        # An arm alone is tried in fewer episodes of a pair than of an environment.
        tries = episodes if pair is None else 20
        policy = {"robot_1": "expert", "robot_2": "expert", agent: "idle"}
        idle = cg.evaluate(cg.task(name, pair), policy, episodes=tries)
        row[f"completion with {agent} idle"] = idle.completion.mean
    return row


def show(rows: list[dict[str, object]], console: Console) -> None:
    """Print the rows as a table."""
    table = Table(title="Experts, default randomisation, seed 0")
    heads = ("", "robots", "n", "return", "worst", "completion", "performance")
    for head in (*heads, "time, s", "1 idle", "2 idle"):
        table.add_column(head, justify="left" if head in ("", "robots") else "right")
    for row in rows:
        table.add_row(
            str(row["name"]),
            ", ".join(row["robots"]),  # type: ignore[arg-type]
            str(row["episodes"]),
            f"{row['mean_reward']:.1f}",
            f"{row['worst_reward']:.1f}",
            f"{100 * row['completion']:.0f} %",
            f"{100 * row['performance']:.1f} %",
            f"{row['time_to_success']:.2f}",
            f"{100 * row['completion with robot_1 idle']:.0f} %",
            f"{100 * row['completion with robot_2 idle']:.0f} %",
        )
    console.print(table)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    paired = [name for name in cg.list_tasks() if 2 in cg.task(name).robot_counts]
    envs = [name for name in cg.list_envs() if len(get_env(name).robots) == 2]
    parser.add_argument("names", nargs="*", default=[*envs, *paired])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    jobs = []
    for name in options.names:
        is_task = name in cg.list_tasks()
        pairs = product(cg.list_robots(), repeat=2) if is_task else (None,)
        jobs += [(name, pair) for pair in pairs]
    console, rows = Console(width=140), []
    for name, pair in track(jobs, console=console):
        try:
            rows.append(measure(name, pair))
        except ValueError as error:  # Not every pair of arms fits every task.
            if pair is None:
                raise
            console.print(f"{name} with {', '.join(pair)}: {error}")
    show(rows, console)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
