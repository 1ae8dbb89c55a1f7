"""What the numbers of an action mean, and how motions become actions.

An action has components that move the arm. Where a task has gripping, it has one more,
which grips above 0. No other module knows that.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from collaborative_gym.math import Array
from collaborative_gym.scene import Arm
from collaborative_gym.sim.sim import Sim
from collaborative_gym.timing import CONTROL_DT


@dataclass(frozen=True)
class Motion:
    """What an expert wants an arm to do in one control step, whatever actions mean.

    Experts compute with NumPy.

    Attributes:
      change: of the joint angles, (num_envs, joints), in rad. Where it is more than the
        arm can do, all of it is scaled down, so that the motion keeps its direction.
      grips: in which worlds to grip, (num_envs,) booleans, or one for all.
      in_step: whether this arm slows down with the slowest of all arms that are in
        step. Arms that hold one thing must do so.
    """

    change: np.ndarray
    grips: np.ndarray | bool = False
    in_step: bool = False


def grip_columns(size: int, gripping: bool) -> np.ndarray:
    """Return which of an action's components grip, (size,) booleans."""
    return np.arange(size) == (size - 1 if gripping else size)


class ActionMode:
    """How an arm's motion is written into an action; subclasses define the numbers.

    Args:
      arms: the arms by agent.
      gripping: whether actions have a grip component.
      xp: namespace of the worlds' arrays.
    """

    def __init__(self, arms: Mapping[str, Arm], gripping: bool, xp: Any = np):
        self.arms = arms
        self.gripping = gripping
        self.xp = xp

    def num_moves(self, agent: str) -> int:
        """Return how many components of an agent's action move its arm."""
        raise NotImplementedError

    def changes(self, sim: Sim, agent: str, moves: Array) -> Array:
        """Return the joint changes that components in [-1, 1] ask for, in rad."""
        raise NotImplementedError

    def moves(self, sim: Sim, agent: str, changes: np.ndarray) -> np.ndarray:
        """Return the components that ask for joint changes, not limited to [-1, 1]."""
        raise NotImplementedError

    def size(self, agent: str) -> int:
        """Return the number of components of an agent's action."""
        return self.num_moves(agent) + self.gripping

    def split(self, action: Array) -> tuple[Array, Array]:
        """Return an action's components that move, and in which worlds it grips.

        Args:
          action: (num_envs, size).

        Returns:
          (num_envs, moves) in [-1, 1] and (num_envs,) booleans.
        """
        if self.gripping:
            return action[:, :-1], action[:, -1] > 0.0
        return action, self.xp.zeros(action.shape[0], dtype=bool)

    def idle(
        self, num_envs: int, grips: Mapping[str, Array | bool] | bool = False
    ) -> dict[str, np.ndarray]:
        """Return actions of agents that hold still.

        Args:
          num_envs: in how many worlds.
          grips: whether all of them grip; or in which worlds each one grips, by agent.
            Agents that are not named do not grip.
        """
        idle = {agent: np.zeros((num_envs, self.size(agent))) for agent in self.arms}
        for agent, action in idle.items() if self.gripping else ():
            own = grips.get(agent, False) if isinstance(grips, Mapping) else grips
            action[:, -1] = np.where(own, 1.0, -1.0)
        return idle

    def encode(
        self, sim: Sim, motions: Mapping[str, Motion], pace: float = 1.0
    ) -> dict[str, np.ndarray]:
        """Return the actions, (num_envs, size) in [-1, 1] by agent, that make motions.

        Args:
          sim: the worlds.
          motions: what each arm is to do.
          pace: what to multiply the actions' moves by, 0 to 1.

        Raises:
          ValueError: if they are not motions of these arms; says what to give.
        """
        self._check(sim, motions)
        moves = {a: self.moves(sim, a, motions[a].change) for a in self.arms}
        most = {a: np.abs(move).max(axis=1) for a, move in moves.items()}
        together = [most[agent] for agent in self.arms if motions[agent].in_step]
        grips = {agent: motions[agent].grips for agent in self.arms}
        actions = self.idle(sim.num_envs, grips)
        for agent, action in actions.items():
            peak = np.max(together if motions[agent].in_step else [most[agent]], axis=0)
            share = moves[agent] / np.maximum(1.0, peak)[:, None]
            action[:, : share.shape[1]] = pace * share
        return actions

    def _check(self, sim: Sim, motions: Mapping[str, Motion]) -> None:
        for agent, arm in self.arms.items():
            motion = motions.get(agent) if isinstance(motions, Mapping) else motions
            if not isinstance(motion, Motion):
                raise ValueError(
                    f"what {agent} is to do is of type {type(motion).__name__}; return"
                    " a Motion (joint changes, grips) for each agent"
                )
            shape = sim.num_envs, arm.num_joints
            if np.shape(motion.change) != shape:
                raise ValueError(
                    f"the change of {agent} has shape {np.shape(motion.change)}, not"
                    f" {shape}: one number for each world and joint, in rad"
                )


class JointChanges(ActionMode):
    """A change of each joint's angle, as a share of the largest in one control step."""

    def __init__(self, arms: Mapping[str, Arm], gripping: bool, xp: Any = np):
        super().__init__(arms, gripping, xp)
        self._speeds = {agent: xp.asarray(arm.max_speed) for agent, arm in arms.items()}

    def num_moves(self, agent: str) -> int:
        return self.arms[agent].num_joints

    def changes(self, sim: Sim, agent: str, moves: Array) -> Array:
        return moves * self._speeds[agent] * CONTROL_DT

    def moves(self, sim: Sim, agent: str, changes: np.ndarray) -> np.ndarray:
        return changes / self.arms[agent].max_change


def check_actions(
    actions: Any, xp: Any, shapes: Mapping[str, tuple[int, ...]], gripping: bool
) -> dict[str, Array]:
    """Return each agent's actions as numbers within [-1, 1].

    Args:
      actions: what was given.
      xp: array API namespace of the backend's arrays.
      shapes: what each agent's actions must have.
      gripping: whether the last component is a grip.

    Raises:
      ValueError: if they are not finite numbers of these shapes.
    """
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions are a {type(actions).__name__}; give a dictionary with an"
            f" array for each of {', '.join(shapes)}"
        )
    if set(actions) != set(shapes):
        raise ValueError(
            f"actions are for {', '.join(map(str, actions)) or 'nobody'};"
            f" give one for each of {', '.join(shapes)}"
        )
    last = ", and one for the grip" if gripping else " (gripping is False)"
    return {
        agent: _checked(actions[agent], xp, agent, shape, last)
        for agent, shape in shapes.items()
    }


def _checked(
    given: Any, xp: Any, agent: str, shape: tuple[int, ...], last: str
) -> Array:
    if not hasattr(given, "__array_namespace__"):
        try:
            given = xp.asarray(given)
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(
                f"the action of {agent} cannot be read as numbers: {error}"
            ) from None
    if given.shape != shape:
        raise ValueError(
            f"the action of {agent} has shape {tuple(given.shape)}, not {shape}: a"
            f" number for each joint{last}"
        )
    if not xp.isdtype(given.dtype, ("integral", "real floating")):
        raise ValueError(
            f"the action of {agent} is of type {given.dtype}; give numbers"
        )
    action = xp.astype(given, xp.float64)
    finite = xp.isfinite(action)
    if not xp.all(finite):
        world, index = (int(axis[0]) for axis in xp.nonzero(~finite))
        raise ValueError(
            f"the action of {agent} in world {world} is"
            f" {float(action[world, index])} at index {index}; every component"
            " must be finite"
        )
    return xp.minimum(xp.maximum(action, -1.0), 1.0)
