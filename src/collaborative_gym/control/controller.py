"""From actions to servo commands and grips."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from collaborative_gym import math
from collaborative_gym.control.actions import ActionMode
from collaborative_gym.math import Array
from collaborative_gym.scene import STOP, Arm, Scene, lost_load
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import CONTROL_DT, SIM_DT, SUBSTEPS

_RAMP = 0.03
"""Time in which a joint's reference speed goes from rest to full, in s. Shorter asks
for more torque than the motors have; longer turns too little in one control step."""

_SPEED_MARGIN = 1.04
"""How far the reference may pass a joint's speed limit to make up for the ramp."""

_SLACK = 1.0 + 0.5 * _RAMP / CONTROL_DT
"""A joint that arrives at a limit must also come to rest there."""

_TEARING = 2.0
"""Distance between tcp and site at which a grip tears, over that at which it can
start."""


@dataclass(frozen=True)
class _Servos:
    """What an arm's servos do, as (joints,) arrays of the worlds' kind.

    Attributes:
      stiffness: in N m/rad.
      damping: in N m s/rad.
      torque: greatest, in N m.
      full: speed that an action of 1 asks for, in rad/s.
      fastest: greatest reference speed, in rad/s.
      low: least angles to go to, in rad.
      high: greatest angles to go to, in rad.
      ramp: how far a speed may have changed by each physics step and by the one after
        the last, (substeps + 1, joints), in rad/s.
    """

    stiffness: Array
    damping: Array
    torque: Array
    full: Array
    fastest: Array
    low: Array
    high: Array
    ramp: Array

    @classmethod
    def of(cls, arm: Arm, xp: Any) -> "_Servos":
        robot = arm.robot
        slope = arm.max_speed * SIM_DT / _RAMP
        return cls(
            stiffness=xp.asarray(robot.stiffness),
            damping=xp.asarray(robot.damping),
            torque=xp.asarray(robot.torque_limits),
            full=xp.asarray(arm.max_speed),
            fastest=xp.asarray(_SPEED_MARGIN * np.array(robot.velocity_limits)),
            low=xp.asarray(arm.joint_range[0] + STOP),
            high=xp.asarray(arm.joint_range[1] - STOP),
            ramp=xp.asarray(np.arange(1.0, SUBSTEPS + 2)[:, None] * slope),
        )


class Grips:
    """Takes, holds and tears the grips of a scene's arms.

    A grip starts at the beginning of a control step if the agent asks for it and the
    site is near. It lasts while the agent asks for it, unless it tears. It tears before
    a physics step that would load it above what the gripper holds, or at whose start
    the two are more than twice the starting distance apart. What is torn out of one
    hand also slips out of another hand that holds it at the same site; otherwise that
    hand could win a thing by force. After a tear the hand opens for one control step
    and cannot grip; otherwise a grip that is too weak would start and tear in every
    step.

    Args:
      scene: the compiled scene.
      sim: its worlds.
    """

    def __init__(self, scene: Scene, sim: Sim):
        self._sim, model, xp = sim, sim.model, sim.xp
        arms = [scene.arms[grip.agent] for grip in scene.grips]
        grippers = [arm.robot.gripper for arm in arms]
        widths = [grip.width for grip in scene.grips]
        self._agents = [grip.agent for grip in scene.grips]
        self._fingers = [arm.fingers for arm in arms]
        self._closed = [g.position(w) for g, w in zip(grippers, widths, strict=True)]

        def columns(names: list[str]) -> Array:
            """Return where `sensordata` has these vectors, (grips, 3)."""
            starts = [int(model.sensor(name).adr[0]) for name in names]
            return xp.asarray(np.add.outer(np.array(starts, int), np.arange(3)))

        self._tcps = columns([f"{agent}/tcp.position" for agent in self._agents])
        self._sites = columns([f"{grip.site}.position" for grip in scene.grips])
        self._forces = columns([grip.palm for grip in scene.grips])
        equalities = [model.equality(grip.name).id for grip in scene.grips]
        self._equalities = xp.asarray(np.array(equalities, int))
        self._thresholds = xp.asarray([grip.threshold for grip in scene.grips])
        self._strengths = xp.asarray([gripper.holding_force for gripper in grippers])
        sites = np.array([grip.site for grip in scene.grips])
        self._same_site = xp.asarray(sites == sites[:, None])

    def command(self, controls: Array, asked: dict[str, Array]) -> None:
        """Take and leave grips for a control step; close the fingers where one holds.

        Args:
          controls: (num_envs, substeps, nu), what is written to.
          asked: by agent, in which worlds it grips, (num_envs,).
        """
        sim, xp, sensed = self._sim, self._sim.xp, self._sim.sensordata
        is_held = sim.eq_active[:, self._equalities] > 0
        # A grip that held at the last command, and does not now, has torn.
        has_torn = (sim.userdata[:, : len(self._agents)] > 0) & ~is_held
        gap = math.norm(sensed[:, self._tcps] - sensed[:, self._sites])
        wanted = xp.stack([asked[agent] for agent in self._agents], axis=1)
        holds = wanted & (is_held | (gap < self._thresholds)) & ~has_torn
        sim.eq_active[:, self._equalities] = holds
        sim.userdata[:, : len(self._agents)] = holds
        closing = zip(self._fingers, self._closed, strict=True)
        for i, (fingers, closed) in enumerate(closing):
            is_closed = holds[:, i, None, None]
            opened = controls[:, :, fingers]
            controls[:, :, fingers] = xp.where(is_closed, closed, opened)

    def tears(self, sensordata: Array, active: Array) -> Array:
        """Return which grips tear; see `Breaks` of the simulation."""
        xp, shape = self._sim.xp, (*sensordata.shape[:-1], self._sim.model.neq)
        force = math.norm(sensordata[..., self._forces])
        gap = math.norm(sensordata[..., self._tcps] - sensordata[..., self._sites])
        holds = active[..., self._equalities]
        torn = (force > self._strengths) | (gap > _TEARING * self._thresholds)
        torn = xp.any((torn & holds)[..., None, :] & self._same_site, axis=-1)
        tears = xp.zeros(shape, dtype=xp.bool)
        tears[..., self._equalities] = torn & holds
        return tears


class Controller:
    """Turns each agent's action into commands of its arm.

    Args:
      scene: the compiled scene.
      sim: its worlds.
      mode: what actions mean.

    Attributes:
      tears: which grips break in a physics step, for `Sim.step`; None without grips.
    """

    def __init__(self, scene: Scene, sim: Sim, mode: ActionMode):
        self._sim = sim
        self._mode = mode
        self._arms = scene.arms
        self._servos = {a: _Servos.of(arm, sim.xp) for a, arm in scene.arms.items()}
        self._grips = Grips(scene, sim) if scene.grips else None
        self.tears = None if self._grips is None else self._grips.tears

    def start(self, env_ids: EnvIds) -> None:
        """Make the servos of freshly reset worlds hold their angles, grippers open."""
        sim = self._sim
        for arm in self._arms.values():
            sim.act[env_ids, arm.act] = sim.qpos[env_ids, arm.qpos]
            sim.ctrl[env_ids, arm.fingers] = arm.robot.gripper.open_position

    def command(self, actions: dict[str, Array]) -> Array:
        """Prepare one control step: write servo targets and grips.

        Args:
          actions: by agent, (num_envs, size), each component in [-1, 1].

        Returns:
          (num_envs, substeps, nu) controls for `Sim.step`.
        """
        sim, mode, grips = self._sim, self._mode, {}
        controls = sim.xp.repeat(sim.ctrl[:, None, :], SUBSTEPS, axis=1)
        for agent, arm in self._arms.items():
            moves, grips[agent] = mode.split(actions[agent])
            change = mode.changes(sim, agent, moves)
            self._command_joints(controls, arm, self._servos[agent], change)
            controls[:, :, arm.fingers] = arm.robot.gripper.open_position
        if self._grips is not None:
            self._grips.command(controls, grips)
        return controls

    def _command_joints(
        self, controls: Array, arm: Arm, servos: _Servos, change: Array
    ) -> None:
        """Write how the targets of an arm's servos move during the control step.

        The reference speed ramps from the measured one to that which brings the joint
        to its new angle in time. The servo's target leads the reference angle by
        damping / stiffness times the speed, which turns damping into feedback on the
        speed error, and by most of what the servo yields to its present load.
        """
        sim, xp = self._sim, self._sim.xp
        stiffness, damping, torque = servos.stiffness, servos.damping, servos.torque
        full, fastest = servos.full, servos.fastest
        angle, speed = sim.qpos[:, arm.qpos], sim.qvel[:, arm.dof]
        kept = 1.0 - lost_load(change, xp)
        change = xp.maximum(change, (servos.low - angle) / _SLACK)
        change = xp.minimum(change, (servos.high - angle) / _SLACK)
        load = stiffness * (sim.act[:, arm.act] - angle) - damping * speed
        load = xp.minimum(xp.maximum(load, -torque), torque) * kept / stiffness
        start = xp.minimum(xp.maximum(speed, -full), full)
        ramp = xp.abs(change / CONTROL_DT - start) / full * _RAMP
        final = (change - start * ramp / 2) / (CONTROL_DT - ramp / 2)
        final = xp.minimum(xp.maximum(final, -fastest), fastest)
        # The reference speed of each physics step, and of the one after the last.
        ramped = xp.maximum((final - start)[:, None, :], -servos.ramp)
        reference = start[:, None, :] + xp.minimum(ramped, servos.ramp)
        lead = damping / stiffness
        ahead = lead / SIM_DT * (reference[:, 1:, :] - reference[:, :-1, :])
        sim.act[:, arm.act] = angle + lead * reference[:, 0, :] + load
        controls[:, :, arm.servos] = reference[:, :-1, :] + ahead
