"""A task that one arm can do or not, and a budget of seconds."""

from dataclasses import dataclass

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.motion import reach

REACHED = 0.05  # m


@dataclass(frozen=True)
class PressConfig(cg.TaskConfig):
    """The settings of the task; episodes are short."""

    max_episode_steps: int = 15
    together: bool = True


@dataclass(frozen=True)
class PressFacts:
    """How far the hands are from their buttons."""

    joints: dict
    tcp: dict
    away: dict


class Press(cg.Task[PressConfig, PressFacts]):
    """Hands go to buttons above them: both at once, or it is enough that one does."""

    config_class = PressConfig

    def build(self, scene):
        for agent, placement in self.placements.items():
            scene.add_robot(agent, self.robots[agent], placement=placement)
            scene.add_target(f"{agent}_button", REACHED)

    def reset(self, sim, env_ids, *, rng):
        self.start_arms(sim, env_ids, rng=rng)
        for agent, placement in self.placements.items():
            places = np.array(placement.position) + np.array([0.45, 0.0, 0.75])
            places = places + rng.within(0.02, 3)
            self.scene.place(sim, env_ids, name=f"{agent}_button", position=places)

    def measure(self, sim):
        tcp = {agent: sim.pose(f"{agent}/tcp") for agent in self.agents}
        buttons = {agent: sim.pose(f"{agent}_button")[0] for agent in self.agents}
        away = {a: math.distance(tcp[a][0], buttons[a]) for a in self.agents}
        self._buttons = buttons
        return PressFacts(self.joints(sim), tcp, away)

    def observe(self, facts):
        return {
            agent: {"joints": facts.joints[agent], "away": facts.away[agent][:, None]}
            for agent in self.agents
        }

    def reward(self, facts, actions):
        return {agent: {"away": -facts.away[agent]} for agent in self.agents}

    def success(self, facts):
        return self.shortfall(facts) <= 0.0

    def shortfall(self, facts):
        away = np.stack([np.maximum(d - REACHED, 0.0) for d in facts.away.values()])
        return away.max(axis=0) if self.config.together else away.min(axis=0)

    def expert(self, sim, facts):
        motions = {}
        for agent, arm in self.scene.arms.items():
            place, quat = facts.tcp[agent]
            step = self._buttons[agent] - place
            far = np.maximum(math.norm(step), 1e-6)[:, None]
            goal = place + step * np.minimum(1.0, 0.09 / far)
            home = np.array(arm.robot.home)
            change = reach(sim, arm, tcp=(place, quat), goal=(goal, quat), posture=home)
            motions[agent] = cg.Motion(change)
        return motions


@pytest.fixture
def press():
    """Return a function that makes the task."""

    def make(**settings):
        robots = [cg.get_robot("panda")] * 2
        return Press(robots, PressConfig(**settings))

    return make


@pytest.fixture
def small():
    """Return a budget of seconds; its searches find what is easily found."""
    return cg.Budget(
        episodes=12,
        fractions=(0.5,),
        motion_steps=10,
        knots=2,
        candidates=12,
        rounds=4,
        training_starts=2,
        searched_starts=2,
        replays=0,
        ppo_steps=0,
    )
