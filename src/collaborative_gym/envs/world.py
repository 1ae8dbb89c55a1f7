"""A task compiled once, for all environments of it."""

from copy import copy
from functools import cached_property
from typing import Any

import mujoco

from collaborative_gym.control import ActionMode, get_mode
from collaborative_gym.envs.definition import try_out
from collaborative_gym.envs.strain import add_strain_sensors
from collaborative_gym.errors import check_kind
from collaborative_gym.math import Array
from collaborative_gym.scene import Scene, refinement
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.task import Task


class World:
    """A task's scene, compiled, and all that follows from it.

    Environments share it and change nothing of it. `World.of` compiles a task only
    once, however many environments, and variations of the task by `Task.varied`, ask
    for it.

    Args:
      task: what to do; it is left as it is.
      strain: whether the sensors that measure strain are in it.

    Attributes:
      task: a copy of the task that knows the compiled world.
      scene: handles into it.
      model: the compiled world.
      refinement: how physics steps are refined.
      mode: the class of what actions mean.
      definition: spaces, names and sides, as the task's methods come to them.
    """

    def __init__(self, task: Task, strain: bool = False):
        self.task, self.scene = copy(task), Scene()
        self.mode = get_mode(task.config.action)
        self.task.build(self.scene)
        self.mode.add_drives(self.scene)
        if strain:
            add_strain_sensors(self.scene)
        self.model = self.scene.compile()
        self.refinement = refinement(self.model, self.scene.arms.values())
        sim = CpuSim(self.model, 3, 1, self.refinement)
        mode = self.mode(self.scene, sim, task.gripping)
        self.task.setup(self.scene, sim, action_mode=mode)
        self.definition = try_out(self.task, self.scene, sim)

    @classmethod
    def of(cls, task: Task, *, strain: bool = False) -> "World":
        """Return the world of a task, compiled before if it was asked for before."""
        check_kind("task", task, Task, "a task, as cg.task returns it")
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

    def flat(self, facts: Any, xp: Any) -> dict[str, Array]:
        """Return the flat view of what the robots see of facts, by agent.

        It has the numbers of all blocks, one after the other, (num_envs, k) float32.
        """
        flat = {}
        for agent, own in self.task.observe(facts).items():
            rows = list(own.values())
            rows = [b if b.ndim == 2 else xp.reshape(b, (len(b), -1)) for b in rows]
            flat[agent] = xp.astype(xp.concat(rows, axis=1), xp.float32)
        return flat

    @cached_property
    def identity(self) -> Identity:
        """What the environment is: its task, arms, settings and versions."""
        return Identity.of(self.task)

    @cached_property
    def drawn_model(self) -> mujoco.MjModel:
        """The world with all that is only drawn; `qpos` and mocap are the same."""
        return self.scene.compile_to_draw()
