"""What the experts do in each action mode, which limits it keeps, and how fast it is.

    python benchmarks/actions.py --output docs/tables/actions.md

The page's legend, `LEGEND`, says what the columns have.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np

import collaborative_gym as cg
from collaborative_gym.cli.terminal import show
from collaborative_gym.control import list_modes
from collaborative_gym.control.joints import ServoMode
from collaborative_gym.motion.kinematics import Kinematics

ENVS = (
    "PokeTaskSawyers-v0",
    "PokeTaskPandaSawyer-v0",
    "LiftTaskSawyers-v0",
    "LiftTaskJacos-v0",
    "BalanceTaskSawyers-v0",
    "PassTaskSawyers-v0",
    "ReachPandas2-v0",
)
HEADS = (
    "environment",
    "mode",
    "completed",
    "time",
    "force",
    "miss",
    "stiffness",
    "too fast, random",
    "too fast, bang-bang",
    "torque",
    "speed",
)
LEGEND = """\
# Action modes

What the experts do in each [action mode](../concepts.md#action-modes), which limits the
mode keeps, and how fast it is (`python benchmarks/actions.py`). A dash marks what a
mode or a task does not have.

- **completed**, **time**: share of the expert's episodes that reach the goal, and the
  mean time to the first success, over {episodes} episodes of seed 0 on `default`.
- **force**: the mean force with which the arms work against each other on the object
  that they hold (`internal_force_mean`).
- **miss**: the mean distance of the tools from where the action should have brought
  them, at the ends of the first 20 control steps of 64 worlds. With `torques`, it is
  the distance from where the expert's motion should have brought them.
- **stiffness**: how stiffly the tools are held against a push then, in the softest and
  in the stiffest direction; the median over worlds and arms.
- **too fast, random**: the share of the time in which a joint turns faster than 1.1
  times its speed limit, under uniformly random actions, over 40 control steps of 64
  worlds.
- **too fast, bang-bang**: the same under actions that are all fully on, in random
  directions.
- **torque**: the greatest torque that a motor exerts in these random episodes, divided
  by its limit.
- **speed**: how fast control steps are, with the expert's actions in 256 worlds and one
  thread, as a share of the speed with `joints`; a median over rounds.

No expert uses the stiffness that `impedance_stiffness` adds to `impedance`.
"""
"""What is above the table."""

MODES = tuple(mode for mode in list_modes() if mode != "impedance_stiffness")
WORLDS, ROUNDS, STEPS = 256, 7, 4


def main() -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, help="file to write the table to")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--envs", nargs="*", default=ENVS)
    parser.add_argument("--modes", nargs="*", default=MODES)
    options = parser.parse_args()
    rows = [list(HEADS), ["---"] * 2 + ["--:"] * (len(HEADS) - 2)]
    for env_id in options.envs:
        shares = speeds(env_id, "action", options.modes, WORLDS, ROUNDS)
        for mode, share in zip(options.modes, shares, strict=True):
            task = cg.task(env_id, action=mode)
            found = *completion(task, options.episodes), *tool(task), *limits(task)
            rows.append([env_id, f"`{mode}`", *found, share])
            show(" | ".join(rows[-1]))
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    show(table)
    if options.output:
        legend = LEGEND.format(episodes=options.episodes)
        options.output.write_text(f"{legend}\n{table}\n")


def completion(task: cg.Task, episodes: int) -> tuple[str, str, str]:
    """Return how often the expert completes episodes, how soon, and with what force."""
    report = cg.evaluate(task, "expert", episodes=episodes, num_threads=1)
    soon = report.time_to_success.mean
    force = report.strain["internal_force_mean"].mean
    return (
        f"{100 * report.completion.mean:.0f} %",
        "-" if soon != soon else f"{soon:.1f} s",
        f"{force:.1f} N" if force else "-",
    )


def tool(task: cg.Task) -> tuple[str, str]:
    """Return how far the tools miss their way, and how stiffly they are held."""
    env = cg.VectorEnv(task, 64, num_threads=1)
    env.reset(seed=0)
    scene, missed = env.scene, []
    arms, yaws = scene.arms, [place.yaw for place in scene.placements.values()]
    kinematics = Kinematics(env.model, list(arms.values()), yaws, np)
    most = max(arm.num_joints for arm in arms.values())

    def places(changes: dict[str, np.ndarray]) -> np.ndarray:
        angles = np.zeros((most, len(arms), env.num_envs))
        for i, (agent, arm) in enumerate(arms.items()):
            angles[: arm.num_joints, i] = env.sim.qpos[:, arm.qpos].T
            angles[: arm.num_joints, i] += changes[agent].T
        return kinematics(angles)[0][0]

    for _ in range(20):
        actions, changes = env.expert(), {}
        motions = env.task.expert(env.sim, env.facts)
        commands = env.action_mode.commands(actions)
        for agent, arm in arms.items():
            change = motions[agent].change
            excess = np.abs(change / arm.stride).max(axis=1, keepdims=True)
            changes[agent] = change / np.maximum(excess, 1.0)
            if isinstance(env.action_mode, ServoMode):
                changes[agent] = commands[agent].moves * arm.stride
        meant = places(changes)
        env.step(actions)
        still = {agent: np.zeros((1, arm.num_joints)) for agent, arm in arms.items()}
        missed.append(np.linalg.norm(places(still) - meant, axis=0))
    return f"{1e3 * np.mean(missed):.1f} mm", stiffness(env)


def stiffness(env: cg.VectorEnv) -> str:
    """Return the median stiffness of tools in their softest and stiffest direction."""
    if not isinstance(env.action_mode, ServoMode):
        return "-"
    found, gains = [], env.sim.expand("actuator_gainprm")
    for agent, arm in env.scene.arms.items():
        place = env.sim.pose(f"{agent}/tcp")[0]
        rows = env.sim.jacobian(arm.hand, place)[0][:, :, arm.dof]
        softer = rows / gains[:, None, arm.servos, 0]
        found.append(1.0 / np.linalg.eigvalsh(softer @ rows.swapaxes(1, 2)))
    least, most = np.median(np.concatenate(found), axis=0)[[2, 0]] / 1e3
    return f"{least:.1f} to {most:.1f} N/mm"


def limits(task: cg.Task) -> tuple[str, str, str]:
    """Return how often joints are too fast, and the greatest share of a torque."""
    env = cg.VectorEnv(task, 64, num_threads=1, strain=True)
    rng, found, torques = np.random.default_rng(0), [], []
    for kind in ("random", "bang-bang"):
        fast: list[float] = []

        def watch(fast: list[float] = fast) -> None:
            force = env.strain.records(1)["actuator_force"]
            for arm in env.scene.arms.values():
                share = np.abs(force[:, 0, arm.servos]) / arm.robot.torque_limits
                torques.append(share.max())
                speed = np.abs(env.sim.qvel[:, arm.dof])
                fast.append(np.mean(speed > 1.1 * np.array(arm.robot.velocity_limits)))

        env.watch(watch, env.substeps)
        env.reset(seed=0)
        for _ in range(40):
            actions = {}
            for agent, space in env.single_action_spaces.items():
                drawn = rng.uniform(-1.0, 1.0, (env.num_envs, *space.shape))
                actions[agent] = drawn if kind == "random" else np.sign(drawn)
            env.step(actions)
        found.append(f"{100 * np.mean(fast):.1f} %")
    return *found, f"{max(torques):.2f}"


def speeds(
    env_id: str, setting: str, values: Sequence[str | bool], worlds: int, rounds: int
) -> list[str]:
    """Return the speed with each value of a setting, as a share of the first's."""
    envs = [
        cg.make_vec(env_id, worlds, seed=0, num_threads=1, **{setting: value})
        for value in values
    ]
    for env in envs:
        env.reset()
    times: list[list[float]] = []
    for _ in range(rounds):
        times.append([_time(env) for env in envs])
    ratios = zip(*([row[0] / each for each in row] for row in times), strict=True)
    return [f"{100 * median(each):.0f} %" for each in ratios]


def _time(env: cg.VectorEnv) -> float:
    """Return the time of some control steps, without that of the expert."""
    spent = 0.0
    for _ in range(STEPS):
        actions = env.expert()
        started = time.process_time()
        env.step(actions)
        spent += time.process_time() - started
    return spent


if __name__ == "__main__":
    main()
