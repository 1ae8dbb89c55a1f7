"""Differences of episodes from the nominal one, and their presets."""

import math
from dataclasses import dataclass, replace

import numpy as np

from collaborative_gym.errors import check_kind, check_name
from collaborative_gym.tasks.settings import bounded, check_settings


@dataclass(frozen=True)
class Randomization:
    """How far an episode may differ from the nominal one.

    Each draw is uniform between minus and plus the bound, unless said otherwise. The
    first five define the start; the others disturb the episode, unseen by policies.

    Attributes:
      joint_noise: turn of every arm joint, in rad.
      object_position: shift of the objects, along each free axis, in m.
      object_yaw: turn of the objects about the vertical, in rad.
      target_position: shift of the target, along each axis, in m.
      lost: share of the episodes that begin after the task's `mishap`.
      link_mass: change of each arm's link masses, as a share.
      payload: change of each loose thing's and tool's mass, as a share.
      friction: change of all coefficients of friction, as a share.
      lost_torque: share of its torque limits that one arm, drawn at random, lacks.
      delay: how late all actions of an episode come, in control steps.
      delayed: share of the episodes in which they come late.
      lost_actions: share of the actions of each arm that never arrive; it then holds
        still, and holds what it has in its grip.
      position_noise: error of every observed place, along each axis, each step, in m.
      angle_noise: error of every observed joint angle, and of every observed pose about
        each axis, at every step, in rad.
      force_noise: error of every observed force, along each axis, each step, in N.
      torque_noise: error of every observed torque, likewise, in N m.
      force_bias: error of every observed force during a whole episode, in N.
      torque_bias: error of every observed torque, likewise, in N m.
      limp: agents whose arms have no torque and no gravity compensation; their grips
        still follow their actions.
      absent: agents whose arms touch nothing, as if they were not there; tools fixed in
        their hands still touch.
    """

    joint_noise: float = bounded(0.05, 0.0, math.pi)
    object_position: float = bounded(0.05, 0.0, 1.0)
    object_yaw: float = bounded(float(np.radians(15)), 0.0, math.pi)
    target_position: float = bounded(0.05, 0.0, 1.0)
    lost: float = bounded(0.0, 0.0, 1.0)
    link_mass: float = bounded(0.0, 0.0, 0.9)
    payload: float = bounded(0.0, 0.0, 0.9)
    friction: float = bounded(0.0, 0.0, 0.9)
    lost_torque: float = bounded(0.0, 0.0, 0.9)
    delay: int = bounded(0, 0, 100)
    delayed: float = bounded(1.0, 0.0, 1.0)
    lost_actions: float = bounded(0.0, 0.0, 1.0)
    position_noise: float = bounded(0.0, 0.0, 1.0)
    angle_noise: float = bounded(0.0, 0.0, math.pi)
    force_noise: float = bounded(0.0, 0.0, 1e3)
    torque_noise: float = bounded(0.0, 0.0, 1e3)
    force_bias: float = bounded(0.0, 0.0, 1e3)
    torque_bias: float = bounded(0.0, 0.0, 1e3)
    limp: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_settings(self)
        for name in "limp", "absent":
            agents = getattr(self, name)
            check_kind(name, agents, (tuple, list), "a tuple of agents")
            _ = [check_name(f"each of {name}", agent) for agent in agents]
            object.__setattr__(self, name, tuple(agents))

    @property
    def moves(self) -> np.ndarray:
        """Bounds of an object's moves along x, y, z and of its turn about z, (4,)."""
        return np.array([self.object_position] * 3 + [self.object_yaw])


_STARTS = "joint_noise", "object_position", "target_position"


def presets(default: Randomization) -> dict[str, Randomization]:
    """Return the presets of a task by name.

    `paper` starts as the thesis does, `default` is drawn around it, `lost` after a
    mishap, `wide` 1.5 times as far off, for training, `hard` with every disturbance and
    at least twice as far off as usual.
    """

    def scaled(by: float, start: Randomization) -> Randomization:
        # Rounded, so that 1.5 times 0.05 is 0.075.
        starts = {name: round(by * getattr(start, name), 15) for name in _STARTS}
        return replace(start, **starts, object_yaw=by * start.object_yaw)

    twice = scaled(2.0, Randomization())
    names = *_STARTS, "object_yaw"
    farther = {n: max(getattr(default, n), getattr(twice, n)) for n in names}
    return {
        "default": default,
        "paper": scaled(0.0, default),
        "wide": scaled(1.5, default),
        "lost": replace(default, lost=1.0),
        "hard": Randomization(
            **farther,
            link_mass=0.2,
            payload=0.2,
            friction=0.2,
            lost_torque=0.2,
            delay=1,
            delayed=0.5,
            lost_actions=0.05,
            position_noise=0.005,
            angle_noise=0.01,
            # Our choice: some newtons, as sensors in the wrists of such arms have.
            force_noise=3.5,
            torque_noise=0.2,
            force_bias=4.0,
            torque_bias=0.3,
        ),
    }
