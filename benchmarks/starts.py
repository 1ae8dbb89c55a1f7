"""How many starts are drawn anew because something is deep in something else.

    python benchmarks/starts.py [panda sawyer jaco] [--sizes 0.8 1] [--tasks NAME ...]
    python benchmarks/starts.py --module examples/own_arm.py own panda
    python benchmarks/starts.py --randomization hard

Each pair of the arms plays each task, in every order. Of other sizes than 1 they are
copies of the arms, thicker or thinner by `--fat`. A row says how many draws of the
first `--starts` starts were thrown away, and how long a start takes, or why the
task has none. Pairs that a task refuses for another reason are counted below.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

import collaborative_gym as cg
from collaborative_gym import rng
from collaborative_gym.envs.starts import OVERLAP

COMPUTED = {"torque_limits": (), "armature": (), "damping": (), "stiffness": ()}


def scaled(robot: cg.Robot, size: float, fat: float, folder: Path) -> cg.Robot:
    """Return a copy of an arm of another size, its shapes thicker by a factor."""
    if size == fat == 1.0:
        return robot
    spec = mujoco.MjSpec.from_file(str(robot.model_file))
    for body in spec.bodies:
        body.pos, body.ipos = size * body.pos, size * body.ipos
        body.mass, body.inertia = size**3 * body.mass, size**5 * body.inertia
        body.fullinertia = size**5 * body.fullinertia
    for geom in spec.geoms:
        radius = geom.size[0] * (fat if geom.contype else 1.0)
        geom.size = size * np.array([radius, *geom.size[1:]])
        geom.pos, geom.fromto = size * geom.pos, size * geom.fromto
        geom.mass *= size**3
    for site in spec.sites:
        site.pos = size * site.pos
    for joint in spec.joints:
        joint.pos = size * joint.pos
        if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
            joint.range = size * joint.range
    own, slide = robot.gripper, mujoco.mjtJoint.mjJNT_SLIDE
    slides = own.joints and spec.joint(own.joints[0]).type == slide
    travel = size if slides else 1.0
    gripper = replace(
        own,
        open_position=travel * own.open_position,
        closed_position=travel * own.closed_position,
        open_gap=size * own.open_gap,
        closed_gap=size * own.closed_gap,
        force=size**2 * own.force,
        holding_force=0.0,
    )
    name = f"{robot.name}_{size * 100:.0f}_{fat * 100:.0f}"
    file = folder / f"{name}.xml"
    file.write_text(spec.to_xml())
    torques = tuple(size**3 * torque for torque in robot.torque_limits)
    given = COMPUTED | {"torque_limits": torques, "gripper": gripper, "title": ""}
    bigger = {"reach": size * robot.reach, "payload": size**2 * robot.payload}
    return replace(robot, name=name, model_file=file, **bigger, **given)


def drawn_again(task: cg.Task, starts: int) -> tuple[int, float]:
    """Return how many draws were thrown away, and the time of a start in ms."""
    env = cg.VectorEnv(task, starts, num_threads=1)
    again: list[int] = []
    own = rng.EpisodeRandom.rows

    def rows(self: rng.EpisodeRandom, which: np.ndarray) -> rng.EpisodeRandom:
        again.append(len(which))
        return own(self, which)

    rng.EpisodeRandom.rows = rows
    try:
        begun = time.perf_counter()
        env.reset(seed=0)
        return sum(again), 1000 * (time.perf_counter() - begun) / starts
    finally:
        rng.EpisodeRandom.rows = own
        env.close()


def rows(given: argparse.Namespace, arms: list[cg.Robot]) -> Iterator[str]:
    """Yield a line for each task and pair, and how many pairs were refused."""
    refused, how = 0, given.randomization
    for name, pair in product(given.tasks, product(arms, repeat=2)):
        title = f"{name:12}{' '.join(robot.name for robot in pair):32}"
        try:
            task = cg.task(name, pair, randomization=how)
            again, each = drawn_again(task, given.starts)
            yield f"{title}{again:6} more draws for {given.starts} starts{each:8.2f} ms"
        except ValueError as error:
            if OVERLAP in str(error):
                yield f"{title}{error}"
            refused += OVERLAP not in str(error)
    yield f"{refused} pairs refused, because they do not reach or are too unequal"


def main() -> None:
    """Print a line for each task and pair."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=["panda", "sawyer", "jaco"])
    parser.add_argument("--module", help="a file that registers arms")
    paired = [name for name in cg.list_tasks() if 2 in cg.task(name).robot_counts]
    parser.add_argument("--tasks", nargs="+", default=paired)
    parser.add_argument("--sizes", nargs="+", type=float, default=[1.0])
    parser.add_argument("--fat", type=float, default=1.0)
    parser.add_argument("--randomization", default="default")
    parser.add_argument("--starts", type=int, default=256)
    given = parser.parse_args()
    if given.module:
        cg.load_module(given.module)
    with tempfile.TemporaryDirectory() as folder:
        arms = [
            scaled(cg.get_robot(name), size, given.fat, Path(folder))
            for name, size in product(given.arms, given.sizes)
        ]
        for line in rows(given, arms):
            print(line, flush=True)


if __name__ == "__main__":
    main()
