"""What it costs that physics steps in which arms crash are taken again as short ones.

    python benchmarks/refinement.py [--worlds N ...] [NAME ...]

Names are environment ids; none means all. Worlds with and without refinement play the
same policy in turn, on one thread. The table has control steps per second without, the
speed with refinement as a share of that, and the share of control steps of a world in
which at least one physics step was refined.
"""

import argparse
import time

import numpy as np
from rich.console import Console
from rich.table import Table

import collaborative_gym as cg

POLICIES = ("random", "expert")


def measure(name: str, policy: str, worlds: int, steps: int) -> tuple[float, ...]:
    """Return speed without refinement, its share with it, and the share refined."""
    envs = [cg.make_vec(name, worlds, seed=0, num_threads=1) for _ in range(2)]
    envs[0].sim.refinement = None
    acts = [cg.load_policy(policy, env) for env in envs]
    seen = [env.reset(stagger=True)[0] for env in envs]
    took, refined = np.zeros(2), 0
    for _ in range(steps):
        for i, env in enumerate(envs):
            start = time.perf_counter()
            seen[i] = env.step(acts[i](seen[i]))[0]
            took[i] += time.perf_counter() - start
        parts = [part.env_ids for part in envs[1].sim.refined]
        refined += len(np.unique(np.concatenate(parts))) if parts else 0
    for env in envs:
        env.close()
    played = worlds * steps
    return played / took[0], took[0] / took[1], refined / played


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", default=cg.list_envs())
    parser.add_argument("--worlds", type=int, nargs="+", default=[64])
    parser.add_argument("--steps", type=int, default=150)
    options = parser.parse_args()
    table = Table(title="refinement of physics steps")
    for head in ("environment", "policy", "worlds", "without", "with", "refined"):
        table.add_column(head)
    for name in options.names:
        for worlds in options.worlds:
            for policy in POLICIES:
                speed, share, refined = measure(name, policy, worlds, options.steps)
                cells = f"{speed:.0f}", f"{share:.2f}", f"{100 * refined:.1f} %"
                table.add_row(name, policy, str(worlds), *cells)
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
