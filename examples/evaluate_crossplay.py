"""Cross-play: each robot has a policy that was trained, or written, without the other.

    python examples/evaluate_crossplay.py
    python examples/evaluate_crossplay.py --policies baseline runs/mine runs/theirs

Policies that learned together may use a convention that no stranger knows. The script
prints in how many episodes every pair reaches the goal, with the policies of robot_1 as
lines and those of robot_2 as columns, and what each loses with strangers. It takes a
minute at most.
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
    played = cg.tournament(env, policies, episodes=episodes, seed=seed)
    table = Table("robot_1 / robot_2", *policies, "lost with strangers", title=env)
    for first, cells in played.matrices["completion"].items():
        shares = [cell.mean for cell in cells.values()]
        shares.append(played.standings[first].gap["completion"].mean)
        table.add_row(first, *(f"{share:.0%}" for share in shares))
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main)
