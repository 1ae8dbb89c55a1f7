"""Whether robots take a grip again that they lost before the goal was reached.

    python benchmarks/lost_grips.py [--policies POLICY ...] [ENV_ID ...]

Every episode of seed 0 is played twice. The second time one arm is made to let go for
one control step (`--steps`), at a moment drawn from all in which it held something
before the goal was met. Completion is of the episodes in which that happened.
"""

import argparse

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym.blocks import columns_of


def play(env: cg.VectorEnv, name: str, lost: np.ndarray | None = None) -> dict:
    """Play one episode in each world; return its metrics, and when arms held what.

    Args:
      env: the worlds.
      name: of the policy.
      lost: (steps, agents, worlds) bool, when whose grip is made to open; None never.
    """
    policy = cg.load_policy(name, env)
    observations, _ = env.reset(seed=0)
    holds, infos = [], {}
    for step in range(env.task.config.max_episode_steps):
        actions = {a: np.array(each) for a, each in policy(observations).items()}
        for i, agent in enumerate(env.agents):
            if lost is not None:
                grip = columns_of(env.action_parts[agent], "grip")
                actions[agent][np.ix_(lost[step, i], grip)] = -1.0
        holds.append([env.scene.holds(env.sim, agent) for agent in env.agents])
        observations, _, _, _, infos = env.step(actions)
    return infos["metrics"] | {"holds": np.array(holds)}


def measure(env_id: str, name: str, options: argparse.Namespace) -> dict[str, float]:
    """Return how many episodes lost a grip, and how many are completed all the same."""
    env = cg.make_vec(env_id, options.episodes, num_threads=1)
    whole = play(env, name)
    last = np.round(whole["time_to_success"] / env.control_dt)
    held, rng = whole["holds"], np.random.default_rng(0)
    held &= np.arange(len(held))[:, None, None] < np.nan_to_num(last)
    lost = np.zeros_like(held)
    for world in range(env.num_envs):
        moments = np.argwhere(held[:, :, world])
        if len(moments):
            step, agent = moments[rng.integers(len(moments))]
            lost[step : step + options.steps, agent, world] = True
    again = play(env, name, lost)
    env.close()
    has_lost = lost.any(axis=(0, 1))
    return {
        "whole": whole["completion"].mean(),
        "lost": has_lost.sum(),
        "completed": again["completion"][has_lost].mean(),
    }


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    gripping = [name for name in cg.list_envs() if name.startswith(("Lift", "Pass"))]
    parser.add_argument("names", nargs="*", default=gripping)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--steps", type=int, default=1, help="control steps without it")
    parser.add_argument("--policies", nargs="*", default=["expert", "baseline"])
    options = parser.parse_args()
    table = Table("", "policy", "completion", "lost a grip", "completed after it")
    jobs = [(name, policy) for name in options.names for policy in options.policies]
    for name, policy in track(jobs):
        row = measure(name, policy, options)
        cells = (
            f"{100 * row['whole']:.1f} %",
            f"{row['lost']}",
            f"{100 * row['completed']:.1f} %",
        )
        table.add_row(name, policy, *cells)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
