"""How much of Reach is teamwork: what arms do that look at nobody, or share no room.

    python benchmarks/reach.py [ENV_ID ...] [--episodes N]

`gives way` is the completion of the expert. `looks at nobody` is that of the same
expert if it takes every way as clear. `shared` is the share of the goals that another
arm reaches, too, from its shoulder. `own room` is the share of episodes in which no arm
has such a goal, so that arms that keep to rooms of their own could complete them.
`nearest` is the least distance between the goals of two arms at one time, in m.
"""

import argparse
from contextlib import closing
from itertools import combinations
from unittest.mock import patch

import numpy as np

import collaborative_gym as cg
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.scene import SHOULDER
from collaborative_gym.tasks.experts import reach as expert

COLUMNS = "environment", "gives way", "looks at nobody", "shared", "own room", "nearest"


def main() -> None:
    """Print a line for each environment as soon as it is measured, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    own = [each for each in cg.list_envs() if each.startswith("Reach")]
    parser.add_argument("envs", nargs="*", default=own, metavar="ENV_ID")
    parser.add_argument("--episodes", type=int, default=100)
    options = parser.parse_args()
    table = []
    for env_id in options.envs:
        task = cg.task(env_id)
        with closing(cg.VectorEnv(task, options.episodes, auto_reset=False)) as env:
            completed, nearest = play(env)
            with patch.multiple(expert, _ROOM=-1.0, _ROOM_AT_REST=-1.0):
                careless, _ = play(env)
            shared = is_shared(env)
        shares = completed, careless, shared.mean(), (~shared).all(axis=1).mean()
        cells = [f"{100 * share:.0f} %" for share in shares]
        table.append((env_id, *cells, f"{nearest:.2f}"))
        print(*table[-1], sep="; ", flush=True)
    print(markdown_table(COLUMNS, table))


def play(env: cg.VectorEnv) -> tuple[float, float]:
    """Return the expert's completion, and how near goals have been, in m."""
    env.reset(seed=0)
    ended, nearest = np.zeros(env.num_envs, bool), np.inf
    while not ended.all():
        for one, other in combinations(env.facts.goals.values(), 2):
            gaps = np.linalg.norm(one - other, axis=1)
            nearest = gaps[~ended].min(initial=nearest)
        *_, infos = env.step(env.expert())
        ended = infos["ended"]
    return float(infos["metrics"]["completion"].mean()), float(nearest)


def is_shared(env: cg.VectorEnv) -> np.ndarray:
    """Return which goals another arm reaches, too, (num_envs, all goals)."""
    drawn = env.sim.memory["places"][:, :, :, 0]
    shared = np.zeros(drawn.shape[:3], bool)
    for i, (agent, place) in enumerate(env.task.placements.items()):
        far = np.linalg.norm(drawn - (place.position + SHOULDER), axis=-1)
        far[:, i] = np.inf
        shared |= far < env.task.robots[agent].reach
    return shared.reshape(len(shared), -1)


if __name__ == "__main__":
    main()
