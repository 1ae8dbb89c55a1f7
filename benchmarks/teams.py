"""How the experts of teams do, and what a team does with one arm that does not help.

    python benchmarks/teams.py [TEAM ...] [--tasks Lift Pass] [--random N] [--seed N]
        [--episodes N] [--faults]

A team is an environment's id, or names of arms with commas; the default are all ids of
teams of three and more, and random teams of three to eight arms, which the seed names.
`--faults` also plays with one arm, each in turn, that is idle, idle and gripping, limp,
or still from when it holds, where tasks have grips. A team that the task refuses has
its reason in the row.
"""

import argparse
import time
from argparse import Namespace
from collections.abc import Sequence
from contextlib import closing

import numpy as np

import collaborative_gym as cg
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.policies.scripted import gripping_policy
from collaborative_gym.tasks.registry import get_env, make_task

FAULTS = "idle", "gripping", "limp", "frozen"
"""What the one arm does; `play` says what each means."""

COLUMNS = "task", "team", "make", "kg", "all / fewer", "expert", "seconds"


def main() -> None:
    """Print a line for each team as soon as it is measured, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("teams", nargs="*", metavar="TEAM")
    parser.add_argument("--tasks", nargs="*", default=["Lift"])
    parser.add_argument("--random", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--arms", type=int, default=8, help="try so many arms in turn")
    parser.add_argument("--steps", type=int, help="of an episode; the task's own")
    parser.add_argument("--faults", nargs="*", default=None, choices=FAULTS)
    options = parser.parse_args()
    faults = FAULTS if options.faults == [] else options.faults or ()
    table = []
    for task in options.tasks:
        teams = options.teams or [
            *[each for each in cg.list_envs() if is_team(each, task)],
            *[",".join(t) for t in random_teams(options.random, options.seed, task)],
        ]
        for team in teams:
            table.append(row(task, team, faults, options))
            print(*table[-1], sep="; ", flush=True)
    print(markdown_table((*COLUMNS, *faults), table))


def is_team(env_id: str, task: str) -> bool:
    """Return whether an environment is a task with three arms or more."""
    spec = get_env(env_id)
    return spec.task.__name__ == task and len(spec.robots) > 2


def random_teams(count: int, seed: int, task: str) -> list[tuple[str, ...]]:
    """Return teams of Jacos, Pandas and Sawyers: three to eight, or as many as fit."""
    rng, kinds = np.random.default_rng(seed), ("jaco", "panda", "sawyer")
    most = max(type(make_task(task)).robot_counts)
    sizes = np.minimum(rng.integers(3, 9, count), most)
    return [tuple(rng.choice(kinds, size).tolist()) for size in sizes]


def row(
    name: str, team: str, faults: Sequence[str], options: Namespace
) -> tuple[str, ...]:
    """Return what a team does, as cells of a table."""
    names = get_env(team).robots if team in cg.list_envs() else tuple(team.split(","))
    short = team if team in cg.list_envs() else "".join(each[0] for each in names)

    def worlds(**changes):
        own = {"max_episode_steps": options.steps} if options.steps else {}
        task = make_task(name, names, **own, **changes)
        return cg.VectorEnv(task, options.episodes, num_threads=0, auto_reset=False)

    begun = time.perf_counter()
    try:
        env = worlds()
    except ValueError as error:
        return (name, short, "", "", "", f"refused: {error}", "", *("" for _ in faults))
    made = time.perf_counter() - begun
    weighing = getattr(env.task, "weighing", None)
    mass = ratio = ""
    if weighing:
        mass = f"{env.task.pot_mass:.1f}"
        ratio = f"{min(9.99, weighing.together / max(*weighing.fewer, 1e-9)):.2f}"
    with closing(env):
        completed, seconds = play(env)
        cells = [f"{100 * completed:.0f} %", f"{seconds:.1f}"]
        for fault in faults:
            if fault in ("gripping", "frozen") and not env.task.gripping:
                cells.append("-")
                continue
            worst = max(
                fails(env, worlds, fault, agent) for agent in env.agents[: options.arms]
            )
            cells.append(f"{100 * worst:.0f} %")
    return name, short, f"{made:.1f} s", mass, ratio, *cells


def fails(env: cg.VectorEnv, worlds, fault: str, agent: str) -> float:
    """Return the completion while an arm has a fault."""
    if fault != "limp":
        return play(env, agent, fault)[0]
    limp = cg.Randomization(**vars(env.task.config.randomization) | {"limp": (agent,)})
    with closing(worlds(randomization=limp)) as other:
        return play(other)[0]


def play(env: cg.VectorEnv, agent: str = "", fault: str = "") -> tuple[float, float]:
    """Return completion and mean time to success of the expert, in s.

    An agent with a fault is `idle`; or `gripping` what comes near while it holds still;
    or `frozen`, still as soon as it holds something.
    """
    env.reset(seed=0)
    gripping, is_over = gripping_policy(env), False
    while not is_over:
        actions = env.expert()
        if fault == "idle":
            actions[agent] = env.idle()[agent]
        elif fault == "gripping":
            actions[agent] = gripping({})[agent]
        elif fault == "frozen":
            held = env.scene.holds(env.sim, agent)
            still = env.idle({agent: held})[agent]
            actions[agent] = np.where(held[:, None], still, actions[agent])
        *_, infos = env.step(actions)
        metrics = infos["metrics"]
        is_over = (infos["ended"] | (metrics["completion"] > 0.0)).all()
    times = metrics["time_to_success"][metrics["completion"] > 0.0]
    return float(metrics["completion"].mean()), float(times.mean()) if len(
        times
    ) else 0.0


if __name__ == "__main__":
    main()
