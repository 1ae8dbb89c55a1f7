"""What each grasp does: completion, creep, depth, force at which it slips, and speed.

    python benchmarks/grasps.py --output docs/tables/grasps.md
    python benchmarks/grasps.py --others --output docs/tables/grasps.md
    python benchmarks/grasps.py --felt

The page's legends, `LEGEND` and `OTHERS_LEGEND`, say what the columns have.

With `--others` it measures completion and time in other action modes, in Sort and in
teams of Pass, and writes the page's second section. With `--felt` it prints the speed
of 256 worlds whose robots observe what they feel, as a share of that without.
"""

import argparse
from pathlib import Path

import numpy as np

import collaborative_gym as cg
from actions import speeds
from collaborative_gym import math
from collaborative_gym.cli.terminal import show
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.scene.grasps import GRASPS

ENVS = (
    "PassTaskSawyers-v0",
    "PassTaskJacoSawyer-v0",
    "LiftTaskSawyers-v0",
    "LiftTaskJacos-v0",
)
HEADS = (
    "environment",
    "grasp",
    "completed",
    "time",
    "creep in 20 s",
    "depth",
    "slips at",
    "formula",
    "speed",
)
OTHERS = (
    *(("PassTaskSawyers-v0", mode) for mode in ("tcp", "impedance", "torques")),
    *((f"SortPandas{count}-v0", "joints") for count in (2, 4)),
    *((f"PassPandas{count}-v0", "joints") for count in (3, 4)),
)
"""Environments and action modes of the second table."""
FELT = (
    ("PassPinchSawyers-v0", "pad_force", (False, True)),
    ("PassFrictionSawyers-v0", "pad_force", (False, True)),
    ("PassTaskSawyers-v0", "wrench", ("off", "compensated")),
    ("PokeTaskSawyers-v0", "wrench", ("off", "compensated")),
)
"""Environments, and settings by which robots observe what they feel."""

LEGEND = """\
# Grasps

What each [grasp](../concepts.md#grasps) does (`python benchmarks/grasps.py`). A dash
marks what does not apply to a grasp, and an empty cell marks what was measured only in
Pass.

- **completed**, **time**: share of the expert's episodes that reach the goal, and the
  mean time to the first success, over {episodes} episodes of seed 0 on `default`.
- **creep in 20 s**: how far a cube moves in the hand of an arm that stands still for
  20 s; the most of 4 worlds.
- **depth**: how deep a finger is in the cube meanwhile, at most.
- **slips at**: the force at which the hand loses the cube, or at which the cube has
  moved by 5 mm. The first number is for a force along the approach, the second for a
  force across it. The force grows by 4 % in each control step.
- **formula**: the same two forces by the formulas of `scene.grasps`.
- **speed**: how fast control steps are, with the expert's actions in 64 worlds and one
  thread, as a share of the speed with `magnet`; a median over rounds.
"""
"""What is above the first table."""

OTHERS_LEGEND = """\
## Other action modes and teams

The columns **completed** and **time** are the same as above, in other action modes, in
Sort and in teams of Pass (`python benchmarks/grasps.py --others`).
"""
"""What is above the second table."""

NOTE = (
    "Where Sort fails with `friction`, a cube slips from the fingers as the arm lifts"
    " or swings it, and passes the arm before the arm can take it again. Slower swings"
    " do not help: the belt does not wait."
)
WORLDS, ROUNDS = 64, 5
SLIPPED = 0.005  # m


def main() -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, help="file to write the table to")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--envs", nargs="*", default=ENVS)
    parser.add_argument("--others", action="store_true", help="the second table")
    parser.add_argument("--felt", action="store_true", help="the cost of what is felt")
    options = parser.parse_args()
    if options.felt:
        return felt()
    table = (others if options.others else ladder)(options)
    if options.output:
        heading = OTHERS_LEGEND.partition("\n")[0]
        first, _, second = options.output.read_text().partition(heading)
        if options.others:
            second = OTHERS_LEGEND.removeprefix(heading) + f"\n{table}\n"
        else:
            first = LEGEND.format(episodes=options.episodes) + f"\n{table}\n\n"
        options.output.write_text(first + heading + second)


def felt() -> None:
    """Print the speed with what robots feel, as a share of that without."""
    for env_id, setting, values in FELT:
        shares = speeds(env_id, setting, values, 256, 5 * ROUNDS)
        for value, share in zip(values, shares, strict=True):
            show(f"{env_id}, {setting}={value}: {share}")


def others(options: argparse.Namespace) -> str:
    """Return the table of other action modes, Sort and teams."""
    rows = []
    for env_id, mode in OTHERS:
        for grasp in GRASPS[1:]:
            found = completion(env_id, grasp, options.episodes, mode)
            rows.append([env_id, f"`{mode}`", f"`{grasp}`", *found])
            show(" | ".join(rows[-1]))
    heads = "environment", "actions", "grasp", "completed", "time"
    return f"{markdown_table(heads, rows)}\n\n{NOTE}"


def ladder(options: argparse.Namespace) -> str:
    """Return the table of all that grasps do."""
    rows = [list(HEADS), ["---"] * 2 + ["--:"] * (len(HEADS) - 2)]
    for env_id in options.envs:
        able = [each for each in GRASPS if holds(env_id, each)]
        shares = speeds(env_id, "grasp", able, WORLDS, ROUNDS)
        for grasp, share in zip(able, shares, strict=True):
            found = *completion(env_id, grasp, options.episodes), *[""] * 4
            if env_id.startswith("Pass"):
                found = *found[:2], *rest(env_id, grasp), *slips(env_id, grasp)
            rows.append([env_id, f"`{grasp}`", *found, share])
            show(" | ".join(rows[-1]))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def holds(env_id: str, grasp: str) -> bool:
    """Return whether objects of an environment can be held so."""
    return not (grasp == "friction" and env_id.startswith("Lift"))


def completion(
    env_id: str, grasp: str, episodes: int, mode: str = "joints"
) -> tuple[str, str]:
    """Return how often the expert completes episodes, and how soon."""
    how = {"grasp": grasp, "action": mode, "num_threads": 1}
    env = cg.make_vec(env_id, episodes, seed=0, **how)
    env.reset()
    soon = np.full(episodes, np.nan)
    for step in range(1, env.task.config.max_episode_steps + 1):
        success = env.step(env.expert())[-1]["success"]
        soon = np.where(np.isnan(soon) & success, 0.1 * step, soon)
        if not np.isnan(soon).any():
            break
    return f"{100 * np.mean(~np.isnan(soon)):.0f} %", f"{np.nanmean(soon):.1f} s"


def picked(env_id: str, grasp: str, worlds: int) -> cg.VectorEnv:
    """Return worlds whose first arm has picked up the cube, and stands still."""
    env = cg.make_vec(env_id, worlds, num_threads=1, grasp=grasp, max_episode_steps=999)
    env.reset(seed=0)
    lifted = np.zeros(worlds, bool)
    for _ in range(100):
        height = env.sim.pose("cube/centre")[0][:, 2] - env.task.cube_start[2]
        lifted |= env.facts.holds["robot_1"] & (height > 0.02)
        actions = env.expert()
        still = env.idle({"robot_1": True})
        for agent, own in actions.items():
            actions[agent] = np.where(lifted[:, None], still[agent], own)
        env.step(actions)
        if lifted.all():
            break
    for _ in range(10):
        env.step(env.idle({"robot_1": True}))
    return env


def in_hand(env: cg.VectorEnv) -> np.ndarray:
    """Return where the cubes are in the frames of the first hands, (worlds, 3)."""
    place, quat = env.sim.pose("robot_1/tcp")
    way = env.sim.pose("cube/centre")[0] - place
    return math.rotate(math.conjugate(quat), way)


def rest(env_id: str, grasp: str) -> tuple[str, str]:
    """Return how far cubes creep in hands at rest, and how deep fingers are in them."""
    env = picked(env_id, grasp, 4)
    start, deepest = in_hand(env), 0.0
    for _ in range(200):
        env.step(env.idle({"robot_1": True}))
        if grasp == "friction":
            deepest = max(deepest, -min(env.sim.data(0).contact.dist, default=0.0))
    creep = np.linalg.norm(in_hand(env) - start, axis=1).max()
    depth = f"{1e3 * deepest:.2f} mm" if grasp == "friction" else "-"
    return f"{1e3 * creep:.3f} mm", depth


def slips(env_id: str, grasp: str) -> tuple[str, str]:
    """Return the forces at which a hand loses its cube, and those by formula, in N."""
    env = picked(env_id, grasp, 2)
    if env.scene.grasp.draws:
        return "-", "-"
    body, robot = env.model.body("cube/cube").id, env.task.robots["robot_1"]
    ways = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    start, found = in_hand(env), np.full(2, np.nan)
    for newtons in 1.04 ** np.arange(180):
        quat = env.sim.pose("robot_1/tcp")[1]
        force = newtons * math.rotate(quat, ways)
        force[:, 2] += 9.81 * env.model.body_mass[body]
        env.sim.xfrc_applied[:, body, :3] = force
        env.step(env.idle({"robot_1": True}))
        gone = ~env.facts.holds["robot_1"]
        gone |= np.linalg.norm(in_hand(env) - start, axis=1) > SLIPPED
        found = np.where(np.isnan(found) & gone, newtons, found)
        if not np.isnan(found).any():
            break
    strength = env.scene.grasp.strength(robot)
    # A cup bears more along its axis than across it; see `strength` of the cup.
    expected = 2 * [strength]
    if grasp == "suction":
        expected = [strength * 5**0.5, strength * 5**0.5 / 2]
    told = (" and ".join(f"{x:.0f} N" for x in pair) for pair in (found, expected))
    return tuple(told)


if __name__ == "__main__":
    main()
