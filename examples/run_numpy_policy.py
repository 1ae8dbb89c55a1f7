"""A trained policy on its own: a file of small networks that NumPy runs, without torch.

    python examples/run_numpy_policy.py
    python examples/run_numpy_policy.py --policy runs/poke

A robot's controller needs no more: observations by robot go in, one row each, and
actions in [-1, 1] come out. The script prints what the file says of the policy, its
action for a first observation, and the time that this takes. It ends at once.
"""

import sys
import time

import tyro

import collaborative_gym as cg


def main(policy: str = "PokeTaskSawyers-v0") -> None:
    """Ask a policy what to do.

    Args:
      policy: an environment id, for the baseline that is shipped, or a path.
    """
    act = cg.load_policy(policy)
    identity, metadata = act.identity, act.metadata
    print(
        f"{identity.title}, mode {metadata['mode']}, {metadata['steps']:,} steps of"
        " training"
    )
    env = cg.make_vec(identity.name, num_envs=1, robots=identity.robot_names)
    observations, _ = env.reset(seed=0)
    for agent, rows in act(observations).items():
        print(f"{agent} sees {observations[agent].shape}, does {rows[0].round(2)}")
    started = time.perf_counter()
    for _ in range(1000):
        act(observations)
    print(f"{time.perf_counter() - started:.2f} ms for all robots")
    print(f"torch was {'' if 'torch' in sys.modules else 'not '}imported")


if __name__ == "__main__":
    tyro.cli(main)
