"""How heavy a pot one arm alone and two arms together bring to Lift's target.

    python benchmarks/lift_capacity.py [ENV_ID | ROBOT,ROBOT ...]

Each number is found by bisecting the pot's mass in simulation, with the joint torque
limits as the task has them, from the `paper` start. "alone" is the greatest mass that
the arm brings into the success radius even for a moment, by its own handle, the other
arm idle: it may carry the pot to any of several places in the radius. "together" is the
greatest mass that the expert brings into the radius and holds there. "pot / alone" is
the pot's mass over the better "alone". Lift promises 1.2 in the last two columns.
"""

import sys
from functools import partial
from itertools import product

import numpy as np
from rich.console import Console
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.motion import carry, strongest_way
from collaborative_gym.objects.pot import GRIP_RADIUS
from collaborative_gym.tasks.lift import Lift
from collaborative_gym.tasks.registry import make_task

STEPS = 200
HALVINGS = 6
"""Of the interval in which a mass is sought."""


class LiftAlone(Lift):
    """Lift in which one arm does what it can and the other holds still.

    Worlds differ in the place to which the arm carries the pot.
    """

    lifter: str
    angles = tuple(np.radians([-75, -60, -45, -30, -15, 0, 20, 40]))

    def setup(self, scene, sim, *, action_mode):
        """Find how the lifter carries the pot to each place near the target."""
        super().setup(scene, sim, action_mode=action_mode)
        placement = self.placements[self.lifter]
        base = np.array(placement.position)
        flat = (base - self.target) * (1.0, 1.0, 0.0)
        nearer, up = flat / np.linalg.norm(flat), np.array([0.0, 0.0, 1.0])
        radius = 0.9 * self.config.success_radius
        start = scene.spec.site(f"pot/handle_{self.agents.index(self.lifter) + 1}").pos
        self.start = np.array([0.0, 0.0, 0.7]) + start
        self.goals, self.ways = [], []
        turn = math.from_yaw(np.array(-placement.yaw))
        for angle in self.angles:
            pot = self.target + radius * (np.cos(angle) * nearer + np.sin(angle) * up)
            goal = pot + GRIP_RADIUS * up
            ends = [
                math.rotate(turn, end - base).round(6) for end in (self.start, goal)
            ]
            try:
                start, end = map(tuple, ends)
                way = strongest_way(self.robots[self.lifter], start=start, end=end)
            except ValueError:
                continue
            self.goals.append(goal)
            self.ways.append(way)

    def success(self, facts):
        """Return where the pot is near the target, whoever holds it."""
        return facts.to_target < self.config.success_radius

    def expert(self, sim, facts):
        """Return motions that grip as Lift's expert does, then carry alone."""
        motions = {
            agent: cg.Motion(np.zeros((sim.num_envs, arm.num_joints)))
            for agent, arm in self.scene.arms.items()
        }
        own = super().expert(sim, facts)[self.lifter]
        arm = self.scene.arms[self.lifter]
        tcp = facts.tcps[self.lifter][0]
        goals = np.array(self.goals)[: sim.num_envs]
        line = goals - self.start
        progress = math.dot(tcp - self.start, line) / math.dot(line, line)
        step = 0.02 / math.norm(line)
        there = np.clip(progress + step, 0.0, 1.0)[:, None]
        posture = np.stack(
            [way.at(progress[i : i + 1])[0] for i, way in enumerate(self.ways)]
        )
        goal, holds = self.start + there * line, facts.gripping[self.lifter]
        carried = carry(
            sim, arm, tcp=tcp, goal=goal, posture=posture, is_loaded=holds | True
        )
        change = np.where(holds[:, None], carried, own.change)
        mass = np.where(holds, self.pot_mass, own.mass)
        motions[self.lifter] = cg.Motion(change, own.grips, mass=mass)
        return motions


def arguments(name: str) -> tuple[str, tuple[str, ...] | None]:
    """Return the environment id or task, and the robots, that a name stands for."""
    return (
        ("Lift", tuple(name.split(","))) if name not in cg.list_envs() else (name, None)
    )


def lifts_alone(name: str, lifter: str, mass: float) -> bool:
    """Return whether one arm brings a pot of this mass near the target."""
    env_id, robots = arguments(name)
    model = make_task(env_id, robots, randomization="paper", pot_mass=mass)
    task = LiftAlone(tuple(model.robots.values()), model.config)
    task.lifter = lifter
    env = cg.VectorEnv(task, num_envs=1, num_threads=1)
    count = len(env.task.ways)
    if not count:
        return False
    env = cg.VectorEnv(task, num_envs=count, num_threads=1)
    env.reset(seed=0)
    return any(env.step(env.expert())[4]["success"].any() for _ in range(STEPS))


def lift_together(name: str, mass: float) -> bool:
    """Return whether the expert brings a pot of this mass to the target and stays."""
    env_id, robots = arguments(name)
    task = make_task(env_id, robots, randomization="paper", pot_mass=mass)
    env = cg.VectorEnv(task, num_envs=1, num_threads=1)
    env.reset(seed=0)
    inside = [env.step(env.expert())[4]["success"][0] for _ in range(STEPS)]
    return bool(np.all(inside[-50:]))


def greatest(succeeds, low: float, high: float) -> float:
    """Return the greatest mass in kg that succeeds, between two bounds."""
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if succeeds(middle) else (low, middle)
    return low


def main() -> None:
    """Print a row for each environment or pair on the command line, or for all."""
    pairs = [",".join(pair) for pair in product(cg.list_robots(), repeat=2)]
    ids = [name for name in cg.list_envs() if name.startswith("LiftTask")]
    table = Table(title="Lift: masses in kg")
    headings = ("robots", "pot", "robot_1 alone", "robot_2 alone", "together")
    for heading in (*headings, "pot / alone", "together / pot"):
        table.add_column(heading, justify="right")
    for name in sys.argv[1:] or ids + pairs:
        env_id, robots = arguments(name)
        env = cg.VectorEnv(make_task(env_id, robots, randomization="paper"), num_envs=1)
        mass = env.task.pot_mass
        alone = [
            greatest(partial(lifts_alone, name, agent), 0.1 * mass, 1.5 * mass)
            for agent in env.agents
        ]
        together = greatest(partial(lift_together, name), 0.5 * mass, 2.5 * mass)
        margins = mass / max(alone), together / mass
        cells = (mass, *alone, together, *margins)
        table.add_row(name, *(f"{cell:.2f}" for cell in cells))
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
