"""From actions to servo commands and grips."""

from dataclasses import dataclass

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Arm, Grip, Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.timing import CONTROL_DT, MAX_CHANGE, SIM_DT, SUBSTEPS

_RAMP = 0.03
"""Time in which a joint's reference speed goes from rest to full, in s. Shorter asks
for more torque than the motors have; longer turns too little in one control step."""

_SPEED_MARGIN = 1.04
"""How far the reference may pass a joint's speed limit to make up for the ramp."""


@dataclass(frozen=True)
class _Servos:
    """What a robot's tuples say of its servos, as (joints,) arrays.

    Attributes:
      stiffness: in N m/rad.
      damping: in N m s/rad.
      torque: greatest, in N m.
      limit: greatest speed, in rad/s.
      full: speed that an action of 1 asks for, in rad/s.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    torque: np.ndarray
    limit: np.ndarray
    full: np.ndarray

    @classmethod
    def of(cls, robot: Robot) -> "_Servos":
        limit = np.array(robot.velocity_limits)
        return cls(
            stiffness=np.array(robot.stiffness),
            damping=np.array(robot.damping),
            torque=np.array(robot.torque_limits),
            limit=limit,
            full=np.minimum(MAX_CHANGE / CONTROL_DT, limit),
        )


class Controller:
    """Turns each agent's action into commands of its arm.

    Arm components in [-1, 1] are scaled to the change of joint angle that the joint
    can make in one control step, at most `MAX_CHANGE`, and added to the measured angle.
    With `gripping` one more component follows; above 0 it grips.

    Args:
      scene: the compiled scene.
      model: its model.
      gripping: whether actions have a grip component.
    """

    def __init__(self, scene: Scene, model: mujoco.MjModel, gripping: bool):
        self._arms = scene.arms
        self._gripping = gripping
        self._servos = {a: _Servos.of(arm.robot) for a, arm in scene.arms.items()}
        self._scale = {
            agent: np.minimum(
                MAX_CHANGE, np.array(arm.robot.velocity_limits) * CONTROL_DT
            )
            for agent, arm in scene.arms.items()
        }
        self._grips = [(grip, model.equality(grip.name).id) for grip in scene.grips]

    def action_size(self, agent: str) -> int:
        """Return the number of components of an agent's action."""
        return len(self._arms[agent].robot.joints) + self._gripping

    def joint_actions(self, agent: str, action: Array) -> Array:
        """Return the arm's part of an action, without the grip."""
        return action[:, : len(self._arms[agent].robot.joints)]

    def scale(self, agent: str) -> np.ndarray:
        """Return the change of joint angles that an action of 1 asks for, in rad."""
        return self._scale[agent]

    def start(self, sim: Sim, env_ids: Array) -> None:
        """Make the servos of freshly reset worlds hold their angles, grippers open."""
        for arm in self._arms.values():
            sim.act[env_ids, arm.act] = sim.qpos[env_ids, arm.qpos]
            gripper = arm.robot.gripper
            sim.ctrl[env_ids, arm.fingers] = gripper.open_position

    def command(self, sim: Sim, actions: dict[str, Array]) -> np.ndarray:
        """Prepare one control step.

        Args:
          sim: the worlds; servo targets and grips are written.
          actions: by agent, (num_envs, action_size), each component in [-1, 1].

        Returns:
          (num_envs, substeps, nu) controls for `Sim.step`.
        """
        controls = np.repeat(np.asarray(sim.ctrl)[:, None], SUBSTEPS, axis=1)
        for agent, arm in self._arms.items():
            action = self.joint_actions(agent, actions[agent])
            self._command_joints(sim, controls, arm, self._servos[agent], action)
            controls[:, :, arm.fingers] = arm.robot.gripper.open_position
        for grip, equality in self._grips:
            self._command_grip(sim, controls, grip, equality, actions[grip.agent])
        return controls

    def _command_joints(
        self,
        sim: Sim,
        controls: np.ndarray,
        arm: Arm,
        servos: _Servos,
        action: Array,
    ) -> None:
        """Write how the targets of an arm's servos move during the control step.

        The reference speed ramps from the measured one to that which brings the joint
        to its new angle in time. The servo's target leads the reference angle by
        damping / stiffness of the speed, which turns damping into feedback on the speed
        error, and by what the servo yields to its present load: a held load does not
        sink a little at every step.
        """
        stiffness, damping = servos.stiffness, servos.damping
        full, fastest = servos.full, _SPEED_MARGIN * servos.limit
        angle, speed = sim.qpos[:, arm.qpos], sim.qvel[:, arm.dof]
        low, high = arm.joint_range
        change = action * full * CONTROL_DT
        # A joint that arrives at a limit must also come to rest there.
        slack = 1.0 + 0.5 * _RAMP / CONTROL_DT
        change = np.clip(change, (low - angle) / slack, (high - angle) / slack)
        load = stiffness * (sim.act[:, arm.act] - angle) - damping * speed
        load = np.clip(load, -servos.torque, servos.torque) / stiffness
        start = np.clip(speed, -full, full)
        ramp = np.abs(change / CONTROL_DT - start) / full * _RAMP
        final = (change - start * ramp / 2) / (CONTROL_DT - ramp / 2)
        final = np.clip(final, -fastest, fastest)
        lead, slope = damping / stiffness, full * SIM_DT / _RAMP
        # The reference speed of each physics step, and of the one after the last.
        reached = np.arange(1.0, SUBSTEPS + 2)[:, None] * slope
        ramped = np.clip((final - start)[:, None], -reached, reached)
        reference = start[:, None] + ramped
        ahead = lead / SIM_DT * (reference[:, 1:] - reference[:, :-1])
        sim.act[:, arm.act] = angle + lead * reference[:, 0] + load
        controls[:, :, arm.servos] = reference[:, :-1] + ahead

    def _command_grip(
        self,
        sim: Sim,
        controls: np.ndarray,
        grip: Grip,
        equality: int,
        action: Array,
    ) -> None:
        """Switch one grip, and close the fingers where it holds."""
        tcp, site = sim.pose(f"{grip.agent}/tcp")[0], sim.pose(grip.site)[0]
        is_near = math.distance(tcp, site) < grip.threshold
        holds = (action[:, -1] > 0.0) & (is_near | (sim.eq_active[:, equality] > 0.0))
        sim.eq_active[:, equality] = holds
        arm = self._arms[grip.agent]
        controls[holds, :, arm.fingers] = arm.robot.gripper.position(grip.width)
