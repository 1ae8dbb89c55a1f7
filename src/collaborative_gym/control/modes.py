"""What the numbers of an action mean: what every action mode does, and their names.

A mode owns an arm's drives. It adds them to the world before that is compiled, starts
them, turns actions into their controls, turns an expert's motions into actions, and
says which action holds still. No other module knows how an action is laid out; it asks
for the `parts`: `moves` of the arm and, where a task grips, `grip`, closed above 0.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from collaborative_gym.blocks import Block
from collaborative_gym.control.grips import Fingers, Grips
from collaborative_gym.errors import (
    check_kind,
    check_number,
    check_word,
    look_up,
    shown,
)
from collaborative_gym.math import Array
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import SUBSTEPS


@dataclass(frozen=True)
class Motion:
    """What an expert wants an arm to do in one control step, in any action mode.

    Experts compute with NumPy.

    Attributes:
      change: changes of the joint angles, (num_envs, joints), in rad. If the arm cannot
        make a change in one step, the whole change is scaled down, so that the motion
        keeps its direction. In modes that move the tool, it moves as by this change.
      grips: in which worlds to grip, (num_envs,) booleans, or one for all.
      in_step: whether this arm slows down with the slowest of all arms that are in
        step. Arms that hold one thing must do so.
      mass: of the load that the tcp bears, (num_envs,), in kg, or one for all.
    """

    change: np.ndarray
    grips: np.ndarray | bool = False
    in_step: bool = False
    mass: np.ndarray | float = 0.0

    def __post_init__(self) -> None:
        a = "an array (num_envs, joints) of changes in rad"
        check_kind("a Motion's change", self.change, np.ndarray, a)
        mass = np.asarray(self.mass)
        if mass.dtype.kind not in "iuf" or not (np.isfinite(mass) & (mass >= 0)).all():
            raise ValueError(
                f"a Motion's mass must be finite and 0 or more, got {shown(self.mass)}"
            )


@dataclass(frozen=True)
class Command:
    """What an action asked of an arm's joints in a control step, whatever the mode.

    Attributes:
      moves: what each joint is to do, as a share of the most, (num_envs, joints) in
        [-1, 1]: changes of angles, over the arm's `stride`, or torques, over limits.
      grips: in which worlds the arm is to grip, (num_envs,) booleans.
    """

    moves: Array
    grips: Array


Commands = dict[str, Command]
"""The commands by agent."""

Encoded = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
"""What `ActionMode.moves` returns."""


class ActionMode:
    """What actions do to the arms of a world; subclasses define the numbers.

    Args:
      scene: the compiled scene, which had this mode's `add_drives`.
      sim: its worlds.
      gripping: whether actions have a grip component.

    Attributes:
      arms: the arms by agent.
      tears: which grips break in a physics step, for `Sim.step`; None without grips.
    """

    def __init__(self, scene: Scene, sim: Sim, gripping: bool):
        self.arms, self.gripping = scene.arms, gripping
        self._sim = sim
        of_grasp = Fingers if scene.grasp.touches else Grips
        self._grips = of_grasp(scene, sim) if scene.grips else None
        self.tears = None if self._grips is None else self._grips.tears

    @classmethod
    def add_drives(cls, scene: Scene) -> None:
        """Add what moves the arms of a scene that is about to be compiled."""
        raise NotImplementedError

    def num_moves(self, agent: str) -> int:
        """Return how many components of an agent's action move its arm."""
        return self.arms[agent].num_joints

    def torques(self, sim: Sim, agent: str) -> Array:
        """Return the torques that the drives ask for, (num_envs, joints), in N m.

        It may be more than the motors have.
        """
        raise NotImplementedError

    def yields(
        self, torque: Array, before: Array, speed: Array, dt: float, env_ids: EnvIds
    ) -> Array:
        """Return the torque that drives lose as joints turn in a step, in N m.

        Args:
          torque: of the joints of all arms, in the order of the agents, at the step's
            beginning, (worlds, steps, joints), in N m.
          before: their speeds then, likewise, in rad/s.
          speed: those at its end.
          dt: how long it is, in s.
          env_ids: the worlds.
        """
        raise NotImplementedError

    def decode(self, moves: Mapping[str, Array]) -> Mapping[str, Array]:
        """Return the `Command.moves` of actions in the present state.

        Here these are the components themselves.

        Args:
          moves: by agent, the components that move, (num_envs, moves) in [-1, 1].
        """
        return moves

    def drive(self, controls: Array, commands: Mapping[str, Command]) -> None:
        """Write the controls of the drives for a control step.

        Args:
          controls: (num_envs, substeps, nu), what is written to.
          commands: what each arm is to do.
        """
        raise NotImplementedError

    def moves(self, motions: Mapping[str, Motion]) -> Encoded:
        """Return the components of motions, and the factors by which they exceed 1.

        Returns:
          By agent, (num_envs, moves) components, and (num_envs,) by what to divide them
          where that is more than 1.
        """
        raise NotImplementedError

    def start(self, env_ids: EnvIds) -> None:
        """Make the drives of freshly reset worlds hold the arms, grippers open.

        Subclasses add to it.
        """
        for arm in self.arms.values():
            self._sim.ctrl[env_ids, arm.fingers] = arm.robot.gripper.open_position

    def parts(self, agent: str) -> dict[str, Block]:
        """Return the parts of an agent's action, by name."""
        moves, grip = Block("moves", (self.num_moves(agent),)), Block("grip", (1,))
        return {"moves": moves} | ({"grip": grip} if self.gripping else {})

    def size(self, agent: str) -> int:
        """Return the number of components of an agent's action."""
        return self.num_moves(agent) + self.gripping

    def split(self, action: Array) -> tuple[Array, Array]:
        """Return the components that move, and in which worlds an action grips.

        They are (num_envs, moves) in [-1, 1] and (num_envs,) booleans.
        """
        if self.gripping:
            return action[:, :-1], action[:, -1] > 0.0
        return action, self._sim.xp.zeros(action.shape[0], dtype=bool)

    def commands(self, actions: Mapping[str, Array]) -> Commands:
        """Return each agent's command to its arm in the present state.

        Args:
          actions: by agent, (num_envs, size), each component in [-1, 1].
        """
        parts = {agent: self.split(actions[agent]) for agent in self.arms}
        moves = self.decode({agent: part[0] for agent, part in parts.items()})
        return {agent: Command(moves[agent], parts[agent][1]) for agent in self.arms}

    def prepare(self, commands: Mapping[str, Command]) -> Array:
        """Command drives and grips; return the controls of `Sim.step`."""
        sim = self._sim
        controls = sim.xp.repeat(sim.ctrl[:, None, :], SUBSTEPS, axis=1)
        self.drive(controls, commands)
        for arm in self.arms.values():
            controls[:, :, arm.fingers] = arm.robot.gripper.open_position
        if self._grips is not None:
            self._grips.command(controls, commands)
        return controls

    def idle(
        self, num_envs: int, grips: Mapping[str, Array | bool] | bool = False
    ) -> dict[str, np.ndarray]:
        """Return actions of agents that hold still.

        Args:
          num_envs: in how many worlds.
          grips: whether all of them grip; or in which worlds each one grips, by agent.
            Agents that are not named do not grip.
        """
        for own in grips.values() if isinstance(grips, Mapping) else (grips,):
            if np.asarray(own).dtype.kind not in "biuf":
                raise TypeError(
                    "grips must be True or False, or by agent in which worlds, got"
                    f" {shown(grips)}"
                )
        idle = {agent: np.zeros((num_envs, self.size(agent))) for agent in self.arms}
        for agent, action in idle.items() if self.gripping else ():
            own = grips.get(agent, False) if isinstance(grips, Mapping) else grips
            action[:, -1] = np.where(own, 1.0, -1.0)
        return idle

    def encode(
        self, motions: Mapping[str, Motion], pace: float = 1.0
    ) -> dict[str, np.ndarray]:
        """Return the actions, (num_envs, size) in [-1, 1] by agent, that make motions.

        Args:
          motions: what each arm is to do.
          pace: what to multiply the actions' moves by, 0 to 1.

        Raises:
          ValueError: if they are not motions of these arms; says what to give.
        """
        pace = check_number("pace", pace, at_least=0.0, at_most=1.0)
        self._check_motions(motions)
        moves, most = self.moves(motions)
        together = [most[agent] for agent in self.arms if motions[agent].in_step]
        grips = {agent: motions[agent].grips for agent in self.arms}
        actions = self.idle(self._sim.num_envs, grips)
        for agent, action in actions.items():
            peak = np.max(together if motions[agent].in_step else [most[agent]], axis=0)
            share = moves[agent] / np.maximum(1.0, peak)[:, None]
            action[:, : share.shape[1]] = pace * share
        return actions

    def _check_motions(self, motions: Mapping[str, Motion]) -> None:
        for agent, arm in self.arms.items():
            motion = motions.get(agent) if isinstance(motions, Mapping) else motions
            if not isinstance(motion, Motion):
                kind = type(motion).__name__
                found = "missing" if motion is None else f"of type {kind}"
                raise ValueError(
                    f"the motion of {agent} is {found}; return a Motion (joint changes,"
                    " grips) for each agent"
                )
            given, shape = motion.change.shape, (self._sim.num_envs, arm.num_joints)
            if given != shape:
                raise ValueError(
                    f"the change of {agent} has shape {given}, not {shape}: one number"
                    " for each world and joint, in rad"
                )

    @cached_property
    def _shapes(self) -> dict[str, tuple[int, int]]:
        return {agent: (self._sim.num_envs, self.size(agent)) for agent in self.arms}

    def check(self, actions: Any) -> dict[str, Array]:
        """Return each agent's actions as numbers within [-1, 1].

        Raises:
          ValueError: if they are not finite numbers of the right shapes.
        """
        agents = list(self.arms)
        is_mapping = isinstance(actions, Mapping)
        if not is_mapping or set(actions) != set(agents):
            given = f"keys {[*map(str, actions)]}" if is_mapping else shown(actions)
            raise ValueError(
                "actions must be a dictionary with an array for each of"
                f" {', '.join(agents)}, got {given}"
            )
        return {agent: self._checked(agent, actions[agent]) for agent in agents}

    def _checked(self, agent: str, given: Any) -> Array:
        xp, shape = self._sim.xp, self._shapes[agent]
        try:
            given = xp.asarray(given)
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(
                f"the action of {agent} cannot be read as numbers: {error}"
            ) from None
        if not xp.isdtype(given.dtype, ("integral", "real floating")):
            raise ValueError(
                f"the action of {agent} is of type {given.dtype}; give numbers"
            )
        if given.shape != shape:
            last = ", and one for the grip" if self.gripping else " (no grip)"
            raise ValueError(
                f"the action of {agent} has shape {tuple(given.shape)}, not {shape}:"
                f" {self.num_moves(agent)} numbers that move the arm{last}"
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


_MODES: dict[str, type[ActionMode]] = {}


def register_mode(name: str, mode: type[ActionMode]) -> None:
    """Let `TaskConfig.action` choose an action mode by name.

    Raises:
      TypeError: if the mode is no subclass of `ActionMode`.
      ValueError: if the name is taken, or not one word.
    """
    check_word("name", name)
    if not (isinstance(mode, type) and issubclass(mode, ActionMode)):
        raise TypeError(f"mode must be a subclass of ActionMode, got {shown(mode)}")
    if name in _MODES:
        raise ValueError(f"action mode {name!r} is registered already")
    _MODES[name] = mode


def get_mode(name: str) -> type[ActionMode]:
    """Return an action mode by name.

    Raises:
      KeyError: if there is none of that name.
    """
    return look_up("action mode", name, _MODES)


def list_modes() -> tuple[str, ...]:
    """Return the names of all action modes."""
    return tuple(_MODES)
