"""Cross-play: each robot led by a policy that was trained, or written, apart.

    python examples/evaluate_crossplay.py
    python examples/evaluate_crossplay.py --policies baseline runs/mine runs/theirs

Policies that do well together may have agreed on what no stranger knows. Prints in how
many episodes every pair reaches the goal, with the policies of robot_1 as lines and
those of robot_2 as columns. A minute at most.
"""

import tyro
from rich.console import Console
from rich.table import Table

import collaborative_gym as cg


def main(
    env: str = "PokeTaskSawyers-v0",
    policies: tuple[str, ...] = ("baseline", "expert", "random"),
    episodes: int = 64,
    seed: int = 0,
) -> None:
    """Let every policy play with every other.

    Args:
      env: an environment id or a task's name, for two robots.
      policies: baseline, expert, random, or paths to policies that you trained.
      episodes: how many for each pair.
      seed: which episodes.
    """
    table = Table("robot_1 / robot_2", *policies, title=env)
    for first in policies:
        pairs = [{"robot_1": first, "robot_2": second} for second in policies]
        reports = [
            cg.evaluate(env, pair, episodes=episodes, seed=seed) for pair in pairs
        ]
        table.add_row(first, *(f"{report.completion.mean:.0%}" for report in reports))
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main)
