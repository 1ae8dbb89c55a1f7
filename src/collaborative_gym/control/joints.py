"""Modes whose actions come to joint changes that servos make, and the thesis's mode."""

from collections.abc import Mapping

import numpy as np
from array_api_compat import array_namespace

from collaborative_gym.control import modes
from collaborative_gym.control.drives import Servo, add_fingers, add_servos, lost_load
from collaborative_gym.math import Array
from collaborative_gym.robots.data import GRAVITY
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import CONTROL_DT


class ServoMode(modes.ActionMode):
    """Modes with a `Servo` for each joint; they say by how much an action turns it."""

    servo = Servo  # the class of an arm's servos

    def __init__(self, scene: Scene, sim: Sim, gripping: bool):
        super().__init__(scene, sim, gripping)
        self._servos = {a: self.servo(arm, sim) for a, arm in self.arms.items()}

    @classmethod
    def add_drives(cls, scene: Scene) -> None:
        for agent, robot in scene.robots.items():
            add_servos(scene.spec, agent, robot)
            add_fingers(scene.spec, agent, robot)

    def start(self, env_ids: EnvIds) -> None:
        super().start(env_ids)
        for servo in self._servos.values():
            servo.hold(self._sim, env_ids)

    def drive(self, controls: Array, commands: Mapping[str, modes.Command]) -> None:
        for agent, servo in self._servos.items():
            change = commands[agent].moves * servo.full * CONTROL_DT
            servo.command(self._sim, controls, change)

    def torques(self, sim: Sim, agent: str) -> Array:
        return self._servos[agent].torques(sim)

    def yields(
        self, torque: Array, before: Array, speed: Array, dt: float, env_ids: EnvIds
    ) -> Array:
        parts, start = [], 0
        for agent, servo in self._servos.items():
            own = slice(start, start := start + self.arms[agent].num_joints)
            parts.append(servo.yields(before[..., own], speed[..., own], dt, env_ids))
        return array_namespace(speed).concat(parts, axis=-1)

    def _borne(self, agent: str, motion: modes.Motion) -> np.ndarray:
        """Return a motion's change, and what makes up for a load that servos let go."""
        if not np.any(motion.mass):
            return motion.change
        arm, sim, mass = self.arms[agent], self._sim, np.asarray(motion.mass)
        tcp = sim.pose(f"{agent}/tcp")[0]
        lever = sim.jacobian(arm.hand, tcp)[0][:, 2, arm.dof]
        lost = lost_load(motion.change) * GRAVITY * mass[..., None] * lever
        return motion.change + self._servos[agent].turn_against(lost)


class JointChanges(ServoMode):
    """A change of each joint's angle, as a share of the largest in one control step."""

    def moves(self, motions: Mapping[str, modes.Motion]) -> modes.Encoded:
        moves = {
            agent: self._borne(agent, motions[agent]) / arm.stride
            for agent, arm in self.arms.items()
        }
        return moves, {agent: np.abs(each).max(axis=1) for agent, each in moves.items()}


modes.register_mode("joints", JointChanges)
