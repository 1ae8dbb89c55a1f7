"""Poke's expert: both arms meet, and one of them lines up and goes in."""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import Motion
from collaborative_gym.math import Array
from collaborative_gym.motion import reach, settling
from collaborative_gym.motion.solver import greatest
from collaborative_gym.sim.sim import Sim

if TYPE_CHECKING:
    from collaborative_gym.tasks.poke import Poke, PokeFacts

STYLES = {"ring-moves": "the stick holds still, and the ring comes over it"}

STICK, DONUT = "robot_1", "robot_2"
STICK_AHEAD = 0.08  # m from tcp to the stick's middle: 2 cm of it lie behind the tcp
DONUT_AHEAD = 0.11  # m from tcp to the ring's centre: its rear bar is held
WAIT = 0.2  # m before the ring's place, where the stick waits for it
_FAR, _SHORT = 0.5, 0.25
"""Distance of stick and ring below which hands go straight, in m, and as a share of
both reaches: short arms are still turned aside where long ones have come round."""
_BENT = 2.0  # rad from a joint of the posture, above which they do not


def expert(self: "Poke", sim: Sim, facts: "PokeFacts") -> dict[str, Motion]:
    """Present the ring, wait behind the hole until lined up with it, then go in."""
    normal = math.axis_z(facts.donut[1])
    position = facts.donut[0] - (_behind(facts) + STICK_AHEAD)[:, None] * normal
    return _steer(self, sim, facts, {STICK: (position, normal)})


def styled(
    self: "Poke", sim: Sim, facts: "PokeFacts", *, style: str, draws: np.ndarray
) -> dict[str, Motion]:
    """Present the stick, wait before its tip until lined up, then come over it."""
    axis = math.axis_z(facts.stick[1])
    _, turned = self.goal[DONUT]
    ahead = DONUT_AHEAD * math.axis_z(turned[None])
    position = facts.stick[0] + _behind(facts)[:, None] * axis - ahead
    turned = np.tile(turned, (sim.num_envs, 1))
    return _steer(self, sim, facts, {DONUT: (position, turned)})


def _behind(facts: "PokeFacts") -> np.ndarray:
    """Return how far behind the hole the stick's middle is to be, (num_envs,)."""
    beside = math.norm(facts.offset[:, :2])
    # From afar both may still swing, so that they are in line for a moment only.
    near = np.where(facts.offset[:, 2] < -0.15, 0.03, 0.05)
    is_lined_up = (beside < near) & (facts.cosine < 0.2) & (facts.axis[:, 2] > 0)
    # The stick's middle keeps its tip clear of the ring, the more the farther it is
    # from the hole, and goes in so slowly that it stays in line.
    return np.where(
        is_lined_up | facts.is_threaded,
        np.maximum(-facts.offset[:, 2] - 0.12, 0.0),
        0.16 + np.minimum(beside, 0.15),
    )


def _steer(
    task: "Poke", sim: Sim, facts: "PokeFacts", moving: dict[str, tuple[Array, Array]]
) -> dict[str, Motion]:
    """Return motions to these poses, and for others to where both meet."""
    reaches = sum(robot.reach for robot in task.robots.values())
    is_far, motions = facts.distance[:, None] > min(_FAR, _SHORT * reaches), {}
    for agent, arm in task.scene.arms.items():
        tcp, posture = sim.pose(f"{agent}/tcp"), task.postures[agent]
        place, turn = (np.tile(x, (sim.num_envs, 1)) for x in task.goal[agent])
        goal = moving.get(agent, (place, turn))
        change = reach(sim, arm, tcp=tcp, goal=goal, posture=posture)
        # From afar, or bent far, all joints go to the posture at once: a straight way
        # may turn a wrist into the ends of its joints, where it would stay.
        away = posture - sim.qpos[:, arm.qpos]
        swing = settling(sim, arm, change=away)
        swings = is_far | (greatest(away) > _BENT)[:, None]
        motions[agent] = Motion(np.where(swings, swing, change))
    return motions
