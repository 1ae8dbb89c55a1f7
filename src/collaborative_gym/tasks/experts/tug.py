"""Tug's expert: it pulls, and goes to postures that pull harder."""

from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym import motion
from collaborative_gym.control import Motion
from collaborative_gym.motion.loads import relief
from collaborative_gym.motion.solver import tcp_jacobian
from collaborative_gym.sim.sim import Sim

if TYPE_CHECKING:
    from collaborative_gym.tasks.tug import Tug, TugFacts

_HAUL = 0.1  # change of the hand in a step, in m: more than a bar gives way
_TO_STRONGER = 0.3  # change of a joint in a step towards a stronger posture, in rad


def expert(self: "Tug", sim: Sim, facts: "TugFacts") -> dict[str, Motion]:
    """Return motions that pull; across the pull, hands go where the other arm does."""
    motions = {}
    for agent, arm in self.scene.arms.items():
        pull = np.array([0.0, self.ways[agent], 0.0])
        jacobian = tcp_jacobian(sim, arm, facts.tcps[agent])
        angle, (low, high) = facts.joints[agent], arm.joint_range
        change = motion.joint_change(
            jacobian[:, :3],
            np.tile(_HAUL * pull, (sim.num_envs, 1)),
            nullspace=_TO_STRONGER * relief(arm.robot, jacobian, pull),
            room=(low - angle, high - angle),
        )
        motions[agent] = Motion(change)
    return motions
