"""A task compiled once, for all environments of it, and starts of its episodes."""

from collections.abc import Mapping
from copy import copy
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from collaborative_gym.control import ActionMode, get_mode
from collaborative_gym.envs.definition import try_out
from collaborative_gym.envs.starts import draw_starts
from collaborative_gym.envs.strain import add_strain_sensors
from collaborative_gym.envs.wrists import Wrists, add_wrist_sensors
from collaborative_gym.errors import check_kind
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Scene, refinement
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.tasks.declared import check_attributes, check_class
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.task import Task


class World:
    """A task's scene, compiled, and all that follows from it.

    Environments share it and change nothing of it. `World.of` compiles a task only
    once, however many environments, and variations by `Task.varied`, ask for it.

    Attributes:
      task: a copy of the task that knows the compiled world.
      scene: handles into it.
      model: the compiled world.
      refinement: how physics steps are refined.
      mode: the class of the action mode.
      definition: spaces, names and sides that follow from the task's methods.
      wrists: what reads the wrenches at the wrists; None if nobody observes them.
      feels: whether arms observe them, or the force of their pads.
      has_strain: whether the sensors that measure strain are in it.
    """

    def __init__(self, task: Task, strain: bool = False):
        check_class(type(task))
        check_attributes(task)
        self.task, self.has_strain = copy(task), strain
        self.scene = Scene(task.config.grasp)
        self.mode = get_mode(task.config.action)
        self.task.build(self.scene)
        self.mode.add_drives(self.scene)
        wrench, self.wrists = task.config.wrench, None
        self.feels = wrench != "off" or task.config.pad_force
        if strain or wrench != "off":
            add_wrist_sensors(self.scene)
        if strain or task.config.pad_force:
            self.scene.add_pad_sensors()
        if strain:
            add_strain_sensors(self.scene)
        self.model = self.scene.compile()
        self.refinement = refinement(self.model, self.scene.arms.values())
        sim = CpuSim(self.model, 3, 1, self.refinement)
        mode = self.mode(self.scene, sim, task.gripping)
        self.task.setup(self.scene, sim, action_mode=mode)
        if not hasattr(self.task, "action_mode"):
            raise ValueError(f"{type(task).__name__}.setup() must call super().setup()")
        if wrench != "off":
            self.wrists = Wrists(self.scene, self.model, is_raw=wrench == "raw")
        self.definition = try_out(self.task, self.scene, sim, self.feel)

    @classmethod
    def of(cls, task: Task, *, strain: bool = False) -> "World":
        """Return the world of a task, compiled at the first call and then shared."""
        check_kind("task", task, Task, "a task, as cg.task returns it")
        if not hasattr(task, "worlds"):
            raise ValueError(f"{type(task).__name__}'s __init__() must call super()'s")
        worlds = task.worlds
        if strain not in worlds:
            worlds[strain] = cls(task, strain)
            worlds[strain].task.worlds = worlds
        return worlds[strain]._varied(task)

    def _varied(self, task: Task) -> "World":
        """Return this world with the settings of another variation of its task."""
        if (task.config, task.name) == (self.task.config, self.task.name):
            return self
        varied = copy(self)
        varied.task = copy(self.task)
        varied.task.config, varied.task.name = task.config, task.name
        varied.task.worlds = task.worlds
        vars(varied).pop("identity", None)
        return varied

    def batch(self, num_envs: int, num_threads: int) -> tuple[CpuSim, ActionMode]:
        """Return so many worlds, and what actions mean in them."""
        sim = CpuSim(self.model, num_envs, num_threads, self.refinement)
        sim.memory = self.task.remember(num_envs)
        return sim, self.mode(self.scene, sim, self.task.gripping)

    def feel(self, sim: CpuSim) -> dict[str, Array]:
        """Return what arms feel by agent, (num_envs, k); nothing if none observes it.

        These are the wrench at the wrist, the force of the pads, or both.
        """
        scene, xp = self.scene, sim.xp
        if not self.feels:
            return {}
        # What pads press with is a number of the hand where no contact is felt.
        if self.wrists is not None or scene.grasp.touches:
            if scene.grips:
                scene.hands.renew(sim)
            sim.feel()
        felt = {agent: sim.qpos[:, :0] for agent in scene.arms}
        forces, sensed = sim.qpos[:, :0], sim.sensordata
        if self.wrists is not None:
            felt |= self.wrists.sensed(sensed)
        if not self.task.config.pad_force:
            return felt
        if scene.grips:
            forces = scene.hands.pad_forces(sensed, sim.eq_active)
        for agent, rows in felt.items():
            own = [i for i, grip in enumerate(scene.grips) if grip.agent == agent]
            force = xp.sum(forces[:, own], axis=1, keepdims=True)
            felt[agent] = xp.concat([rows, force], axis=1)
        return felt

    def flat(self, facts: Any, felt: Mapping[str, Array], xp: Any) -> dict[str, Array]:
        """Return all blocks by agent, one after the other, (num_envs, k) float32."""
        flat = {}
        for agent, own in self.task.observe(facts).items():
            names = [*self.definition.layout.observation[agent]]
            if [*own] != (names[: len(own)] if agent in felt else names):
                raise ValueError(f"{type(self.task).__name__}.observe() has new blocks")
            rows = list(own.values())
            rows += [felt[agent]] if agent in felt else []
            rows = [b if b.ndim == 2 else xp.reshape(b, (len(b), -1)) for b in rows]
            flat[agent] = xp.astype(xp.concat(rows, axis=1), xp.float32)
            seen, space = flat[agent], self.definition.observation_spaces[agent]
            if seen.shape[1:] != space.shape or not xp.all(xp.isfinite(seen)):
                name = f"{type(self.task).__name__}.observe()"
                raise ValueError(f"{name} gives {agent} other shapes, or infinity")
        return flat

    @cached_property
    def identity(self) -> Identity:
        """What the environment is: its task, arms, settings and versions."""
        return Identity.of(self.task)

    @cached_property
    def drawn_model(self) -> mujoco.MjModel:
        """The world with all that is only drawn; `qpos` and mocap are the same."""
        return self.scene.compile_to_draw()


class Starts:
    """The start of an episode for each world, drawn before it is needed.

    A start depends on nothing but the seed and the index of its episode. So where one
    is missing, those that other worlds need next are drawn with it: many at once take
    hardly longer than one.

    Attributes:
      sim: worlds of their own, as many, in which the starts wait.
      observations: what the robots see at the starts, by agent, (num_envs, k).
    """

    def __init__(self, world: World, num_envs: int, num_threads: int):
        self._world = world
        self.sim, self._mode = world.batch(num_envs, num_threads)
        self.observations: dict[str, Array] = {}
        self._drawn = np.full((2, num_envs), -1)

    def prepare(self, env_ids: np.ndarray, progress: Mapping[str, Array]) -> None:
        """Draw the starts of these worlds' present episodes, unless they are there."""
        task, sim, count = self._world.task, self.sim, self.sim.num_envs
        wanted = np.stack([progress["seed"], progress["episode"] + count])
        wanted[1, env_ids] -= count
        missing = (self._drawn != wanted).any(axis=0)
        if not missing[env_ids].any():
            return
        rows = np.flatnonzero(missing)
        self._drawn[:, rows] = -1
        draw_starts(task, sim, self._mode, rows, EpisodeRandom(*wanted[:, rows]))
        felt = self._world.feel(sim)
        self.observations = self._world.flat(task.measure(sim), felt, sim.xp)
        self._drawn[:, rows] = wanted[:, rows]
