"""A small task with all that a task can have, so that the core is tested on its own."""

import csv
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import gymnasium
import mujoco
import numpy as np
import pytest
from array_api_compat import array_namespace

import collaborative_gym as cg
from collaborative_gym import math, plugins
from collaborative_gym.blocks import POSE
from collaborative_gym.motion import reach
from collaborative_gym.tasks import registry

# Before any test imports Ray: what it starts is to listen on loopback alone.
os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")

# A shell that runs this in the background ignores Ctrl-C, and so would every child,
# which then never ends.
signal.signal(signal.SIGINT, signal.default_int_handler)

AGENTS = ("robot_1", "robot_2")
CAMERA = {"position": [1.5, 0, 1.2], "xyaxes": [0, 1, 0, -0.5, 0, 0.85]}


@dataclass(frozen=True)
class CarryConfig(cg.TaskConfig):
    """The settings of the small task; episodes are short."""

    max_episode_steps: int = 12
    height: float = 0.6


@dataclass(frozen=True)
class CarryFacts:
    """What the small task looks at."""

    joints: dict
    tcp: dict
    site: dict
    distance: dict
    cube: tuple
    height: object
    highest: object


class Carry(cg.Task[CarryConfig, CarryFacts]):
    """Two arms grip a cube between them and raise it; a push comes in step 3."""

    gripping = True
    config_class = CarryConfig
    block_units: ClassVar = {"joints": "rad", "tcp": POSE, "cube": "m"}

    def mounts(self):
        # A longer arm stands back, or its elbow would be in the cube.
        back = [max(0.0, robot.reach - 1.0) for robot in self.robots.values()]
        return (
            cg.Placement((0.0, -0.407 - back[0], 0.0), np.pi / 2),
            cg.Placement((0.0, 0.407 + back[1], 0.0), -np.pi / 2),
        )

    def build(self, scene):
        for agent, placement in self.placements.items():
            scene.add_robot(agent, self.robots[agent], placement=placement, stand=False)
        scene.add("cube", cube(), position=(0.0, 0.0, 0.487))
        for agent in self.agents:
            scene.add_grip(agent, f"cube/{agent}", threshold=0.08, width=0.02)
        scene.add_pose_sensor("cube", "cube/centre")
        scene.add_camera(**CAMERA)

    def remember(self, num_envs):
        kind = self.xp.float64
        return {
            "highest": self.xp.zeros(num_envs, dtype=kind),
            "push": self.xp.zeros((num_envs, 3), dtype=kind),
        }

    def reset(self, sim, env_ids, *, rng):
        noise = self.config.randomization.joint_noise
        for agent, arm in self.scene.arms.items():
            draw = rng.uniform(-noise, noise, arm.num_joints)
            self.scene.bend(
                sim, env_ids, agent=agent, angles=np.array(arm.robot.home) + draw
            )
        sim.memory["push"][env_ids] = sim.xp.asarray(rng.uniform(-20.0, 20.0, 3))

    def disturb(self, sim, steps):
        body = self.model.body("cube/cube").id
        is_now = (steps == 3)[:, None]
        sim.xfrc_applied[:, body, :3] = sim.xp.where(is_now, sim.memory["push"], 0.0)

    def measure(self, sim):
        cube = sim.pose("cube")
        height = cube[0][:, 2]
        highest = sim.xp.maximum(sim.memory["highest"], height)
        sim.memory["highest"] = highest
        tcp = {agent: sim.pose(f"{agent}/tcp") for agent in self.agents}
        site = {agent: sim.pose(f"cube/{agent}") for agent in self.agents}
        return CarryFacts(
            joints=self.joints(sim),
            tcp=tcp,
            site=site,
            distance={
                agent: math.distance(tcp[agent][0], site[agent][0])
                for agent in self.agents
            },
            cube=cube,
            height=height,
            highest=sim.xp.asarray(highest, copy=True),
        )

    def observe(self, facts):
        return {
            agent: {
                "joints": facts.joints[agent],
                "tcp": math.pose(*facts.tcp[agent]),
                "cube": facts.cube[0],
                "distance": facts.distance[agent][:, None],
                "highest": facts.highest[:, None],
            }
            for agent in self.agents
        }

    def reward(self, facts, commands):
        xp = array_namespace(facts.height)
        return {
            agent: {
                "distance": -facts.distance[agent],
                "height": xp.where(self.success(facts), 1.0, facts.height),
                "effort": -math.dot(command.moves, command.moves) / 100,
            }
            for agent, command in commands.items()
        }

    def success(self, facts):
        return facts.height > self.config.height

    def expert(self, sim, facts):
        motions = {}
        for agent, arm in self.scene.arms.items():
            (place, quat), home = facts.tcp[agent], np.array(arm.robot.home)
            goal = place + np.array([0.0, 0.0, 0.05])
            change = reach(
                sim, arm, tcp=facts.tcp[agent], goal=(goal, quat), posture=home
            )
            motions[agent] = cg.Motion(change, grips=True)
        return motions


class Duel(Carry):
    """Who is nearer to the cube wins, until it falls."""

    @property
    def sides(self):
        return (("robot_1",), ("robot_2",))

    def lead(self, facts):
        return facts.distance["robot_2"] - facts.distance["robot_1"]

    def reward(self, facts, commands):
        lead = self.lead(facts)
        return {"robot_1": {"lead": lead}, "robot_2": {"lead": -lead}}

    def success(self, facts):
        return self.lead(facts) > 0.0, self.lead(facts) < 0.0

    def over(self, facts):
        return facts.height < 0.4


def cube():
    """Return a cube that can move freely, with a grip site to either side."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="cube")
    body.add_freejoint()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.03, 0.03, 0.03], mass=1.0, group=2
    )
    body.add_site(name="centre")
    for agent, side in zip(AGENTS, (-0.1, 0.1), strict=True):
        body.add_site(name=agent, pos=[0, side, 0])
    return spec


@pytest.fixture
def simple_pick(monkeypatch):
    """Return the module of the tutorial's task; its id is forgotten afterwards."""
    file = Path(__file__).parents[1] / "examples" / "simple_pick.py"
    for name in ("_ENVS", "_TASKS"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))
    monkeypatch.setattr(plugins, "_loaded", {})
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield cg.load_module(str(file))
    del gymnasium.registry["SimplePick-v0"], sys.modules["simple_pick"]


@pytest.fixture
def read_progress():
    """Return a function that gives the rows of a run's `progress.csv`."""

    def read_progress(folder):
        with (folder / "progress.csv").open() as file:
            return [
                {n: float(cell) for n, cell in row.items() if cell and n != "digest"}
                for row in csv.DictReader(file)
            ]

    return read_progress


@pytest.fixture
def carry():
    """Return a function that makes the small task."""

    def make(robots=("panda", "panda"), **settings):
        return Carry([cg.get_robot(name) for name in robots], CarryConfig(**settings))

    return make


@pytest.fixture
def duel():
    """Return the small task as one of two sides."""
    return Duel([cg.get_robot("panda")] * 2, CarryConfig())


@pytest.fixture
def make_env(carry):
    """Return a function that makes a batch of the small task's worlds."""
    made = []

    def make(num_envs=1, seed=0, num_threads=1, auto_reset=True, **settings):
        task = carry(**settings)
        env = cg.VectorEnv(
            task,
            num_envs,
            seed=seed,
            num_threads=num_threads,
            auto_reset=auto_reset,
        )
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


@pytest.fixture
def carry_id(monkeypatch):
    """Return an id under which the small task is registered during the test."""
    env_id = "CarryPandas-v0"
    for name in ("_ENVS", "_TASKS"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))
    cg.register_task("Carry", Carry)
    cg.register_env(cg.EnvSpec(env_id, Carry, ("panda", "panda")))
    yield env_id
    del gymnasium.registry[env_id]
