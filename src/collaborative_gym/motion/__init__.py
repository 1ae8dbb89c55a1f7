"""How arms move: the angles of poses, steps towards them, what arms can carry."""

from collaborative_gym.motion.chart import Chart
from collaborative_gym.motion.loads import alone, greatest_load, strength, strongest_way
from collaborative_gym.motion.poses import (
    central_pose,
    hold,
    hold_moved,
    quickest_way,
    safest_way,
    solve_pose,
    turn_fingers,
)
from collaborative_gym.motion.solver import Chains, joint_change, rotation_error
from collaborative_gym.motion.steering import (
    carry,
    reach,
    settling,
    shortened,
    standoff,
)

__all__ = [
    "Chains",
    "Chart",
    "alone",
    "carry",
    "central_pose",
    "greatest_load",
    "hold",
    "hold_moved",
    "joint_change",
    "quickest_way",
    "reach",
    "rotation_error",
    "safest_way",
    "settling",
    "shortened",
    "solve_pose",
    "standoff",
    "strength",
    "strongest_way",
    "turn_fingers",
]
