"""Worlds that all the cases share, so that few are made."""

from functools import cached_property

import gymnasium
import pytest

import collaborative_gym as cg
from collaborative_gym import objects
from collaborative_gym.tasks.registry import make_task

ENV = "LiftTaskSawyers-v0"


class Shared:
    """Worlds, made when first asked for, and a folder for files."""

    def __init__(self, folder):
        self.folder = folder

    @cached_property
    def env(self):
        """Two worlds, one step on."""
        env = cg.make_vec(ENV, num_envs=2, seed=3, num_threads=1)
        env.reset()
        env.step(env.expert())
        return env

    @cached_property
    def single(self):
        """One world under PettingZoo."""
        env = cg.make("Poke", render_mode="rgb_array")
        env.reset(seed=3)
        return env

    @cached_property
    def gymnasium(self):
        """One world under Gymnasium."""
        env = gymnasium.make("PokeTaskSawyers-v0", disable_env_checker=True).unwrapped
        env.reset(seed=3)
        return env

    @cached_property
    def gymnasium_vector(self):
        """Two worlds under Gymnasium."""
        env = gymnasium.make_vec("PokeTaskSawyers-v0", num_envs=2, num_threads=1)
        env.reset(seed=3)
        return env

    @cached_property
    def task(self):
        """A task that is not built yet."""
        return make_task("Poke")

    @cached_property
    def scene(self):
        """A world with an arm and a pot."""
        scene = cg.Scene()
        scene.add_robot(
            "robot_1", cg.get_robot("panda"), placement=cg.Placement((0, 0, 1))
        )
        scene.add("cube", objects.cube())
        return scene

    @cached_property
    def state(self):
        """A state of the two worlds."""
        return self.env.get_state()

    def snapshot(self):
        """Return the state of all worlds that were made."""
        made = {
            "env": lambda env: env,
            "single": lambda env: env.vector_env,
            "gymnasium": lambda env: env.vector_env,
            "gymnasium_vector": lambda env: env.vector_env,
        }
        states = {}
        for name, vector_env in made.items():
            if name in self.__dict__:
                state = vector_env(self.__dict__[name]).get_state()
                states[name] = {
                    "physics": state.physics,
                    "memory": dict(state.memory),
                    "progress": dict(state.progress),
                }
        return states


@pytest.fixture(scope="session")
def shared(tmp_path_factory):
    """Return what the cases share."""
    return Shared(tmp_path_factory.mktemp("bad_inputs"))
