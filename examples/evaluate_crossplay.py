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


def completion(envs: cg.VectorEnv, seed: int, first: str, second: str) -> float:
    """Return the share of episodes 0, 1, 2 ... that a pair completes."""
    leaders = {
        agent: cg.load_policy(name, envs)
        for agent, name in zip(envs.agents, (first, second), strict=True)
    }
    observations, infos = envs.reset(seed=seed)
    for _ in range(envs.task.config.max_episode_steps):
        actions = {agent: act(observations)[agent] for agent, act in leaders.items()}
        observations, *_, infos = envs.step(actions)
    return infos["metrics"]["completion"].mean()


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
    envs = cg.make_vec(env, num_envs=episodes)
    table = Table("robot_1 / robot_2", *policies, title=env)
    for first in policies:
        shares = [completion(envs, seed, first, second) for second in policies]
        table.add_row(first, *(f"{share:.0%}" for share in shares))
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main)
