"""How arms move: poses, ways to them, loads."""

from collaborative_gym.motion.kinematics import reach, solve_pose, standoff

__all__ = ["reach", "solve_pose", "standoff"]
