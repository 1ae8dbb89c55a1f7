"""How well limits are kept: contacts' depths and forces, speeds, and joint ranges.

    python benchmarks/limits.py [--episodes N] [--policies POLICY ...] [NAME ...]

Names are environment ids; none means all. Policies are random actions, full commands at
random ("bang-bang"), full commands that are mostly kept ("held"), the same while the
last arm holds still ("dragged"), the expert and the baseline. Numbers are the greatest
of all episodes of seed 0, from every physics step. The share that is deep is that of
the time in which there is a contact of that kind.
"""

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym.envs.vector_env import VectorEnv

KEPT = {"bang-bang": 0.5, "held": 0.9, "dragged": 0.9}
"""How often a component of full commands stays as it is from step to step."""

DEEP = 3e-3
"""Depth beyond which a contact counts as deep, in m."""


def full_commands(env: VectorEnv, policy: str):
    """Return a policy of components of -1 and 1, each kept with a probability."""
    rng = np.random.default_rng(0)
    spaces = env.single_action_spaces.items()
    signs = {a: np.ones((env.num_envs, *space.shape)) for a, space in spaces}

    def act(observations: object) -> dict[str, np.ndarray]:
        for own in signs.values():
            own *= np.where(rng.random(own.shape) < KEPT[policy], 1.0, -1.0)
        idle = env.action_mode.idle(env.num_envs, grips=True)
        last = env.agents[-1]
        return signs | ({last: idle[last]} if policy == "dragged" else {})

    return act


def deep(depths: np.ndarray) -> float:
    """Return the share of the time with contact in which it is deep."""
    return np.count_nonzero(depths > DEEP) / max(1, np.count_nonzero(depths > 0.0))


def measure(name: str, policy: str, episodes: int) -> dict[str, float]:
    """Return the greatest of each limit's excess, by column."""
    env = cg.make_vec(name, episodes, seed=0, strain=True)
    act = full_commands(env, policy) if policy in KEPT else None
    act = act or cg.load_policy(policy, env)
    speeds, beyond, depths = [], [], []

    def look() -> None:
        depths.append(list(env.strain.depths.values()))
        for arm in env.scene.arms.values():
            angle, limit = env.sim.qpos[:, arm.qpos], arm.robot.velocity_limits
            speeds.append(np.max(np.abs(env.sim.qvel[:, arm.dof]) / limit, axis=1))
            low, high = arm.joint_range
            beyond.append(np.maximum(low - angle, angle - high).max())

    env.watch(look, env.substeps)
    observations, infos = env.reset()
    while True:
        observations, _, _, _, infos = env.step(act(observations))
        if infos["ended"].any():
            break
    strain, kinds = infos["metrics"]["strain"], list(env.strain.depths)
    env.close()
    row = {key: float(np.nanmax(strain[key])) for key in strain if "contact" in key}
    deepest = dict(zip(kinds, np.moveaxis(depths, 1, 0), strict=True))
    deepest["any"] = np.max(depths, axis=1)
    row |= {f"share deep, {kind}": deep(each) for kind, each in deepest.items()}
    row |= {
        "torque over limit": float(np.max(strain["torque_over_limit"])),
        "speed over limit": float(np.max(speeds)),
        "share above 1.1": float(np.mean(np.array(speeds) > 1.1)),
        "share above 1.5": float(np.mean(np.array(speeds) > 1.5)),
        "beyond range": float(max(beyond)),
    }
    return row


def main() -> None:
    """Print a table for each environment."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", default=cg.list_envs())
    parser.add_argument("--episodes", type=int, default=32)
    every = ["random", *KEPT, "expert", "baseline"]
    parser.add_argument("--policies", nargs="+", default=every, choices=every)
    options = parser.parse_args()
    for name in options.names:
        rows = {}
        for policy in options.policies:
            try:
                rows[policy] = measure(name, policy, options.episodes)
            except FileNotFoundError:
                continue
        table = Table(title=name)
        for head in ("", *rows):
            table.add_column(head, justify="right" if head else "left")
        for key in next(iter(rows.values()), ()):
            table.add_row(key, *(f"{row[key]:.4g}" for row in rows.values()))
        Console(width=100).print(table)


if __name__ == "__main__":
    main()
