"""Refinement: physics steps that are too long for a crash, taken again as short ones.

A physics step is short enough for arms that do a task, but not for arms that crash: a
hand that meets a table at full speed is deep in it after one step, and what it hits
there throws its joints beyond their speeds. Such a step is taken again as many short
steps, in which contacts and stops are stiffer and act in time. If a joint still gets
too fast, its arm makes a protective stop: all its joints slow down alike, so that the
arm keeps its path and only loses energy.

Whether a step is taken again depends on nothing but the state at its start and the
controls. So results stay the same to the bit for any number of worlds and threads, and
worlds in which nothing crashes do not change by a bit.
"""

import math
from collections.abc import Collection

import mujoco
import numpy as np
from array_api_compat import array_namespace

from collaborative_gym.math import Array
from collaborative_gym.scene.collisions import SOLREF
from collaborative_gym.scene.contacts import depth_sensors
from collaborative_gym.scene.handles import Arm
from collaborative_gym.sim.sim import Refinement
from collaborative_gym.timing import SIM_DT

SHORT_STEPS = 10  # that take the place of a physics step

_DEEPEST = 0.005  # m, depth of a contact beyond which a step is refined
# Speeds over a joint's limit: beyond which a step is refined, and what no joint has
# after a short step. Strong arms drag weak ones at up to this speed, and motors may not
# brake harder. At 3.0, BalanceTaskJacoSawyer takes twice the time with random actions.
_FASTEST, _STOPPED = 4.0, 3.9

_BEYOND = 0.005  # rad beyond a joint's range, from where on a step is refined
_SHORT_SOLREF = 0.003  # s, time in which contacts and stops give way in short steps


def refinement(model: mujoco.MjModel, arms: Collection[Arm]) -> Refinement:
    """Return how the physics steps of a compiled world are refined."""
    rules = _Rules(model, arms)
    return Refinement(
        steps=SHORT_STEPS,
        fields=_short(model),
        strays=rules.strays,
        too_deep=rules.too_deep,
        too_fast=rules.too_fast,
        stop=rules.stop,
    )


class _Rules:
    def __init__(self, model: mujoco.MjModel, arms: Collection[Arm]):
        self._arms = list(arms)
        # Whatever is no arm's has no limits.
        self._limits = np.full(model.nv, np.inf)
        self._low, self._high = -np.full(model.nq, np.inf), np.full(model.nq, np.inf)
        for arm in arms:
            self._limits[arm.dof] = arm.robot.velocity_limits
            self._low[arm.qpos] = arm.joint_range[0] - _BEYOND
            self._high[arm.qpos] = arm.joint_range[1] + _BEYOND
        sensors = np.concatenate(list(depth_sensors(model).values()))
        places = model.sensor_objid[sensors], model.sensor_refid[sensors]
        odd = np.isin(places, _unusual(model)).any(axis=0)
        self._depths = model.sensor_adr[sensors[~odd]]

    def strays(self, qpos: Array, qvel: Array) -> Array:
        """Return after which steps an arm is too fast or too far.

        One that is not finite is both.
        """
        xp, fastest = array_namespace(qpos), _FASTEST * self._limits
        steps, stray = math.prod(qpos.shape[1:-1]), False
        for each, *bounds in ((qpos, self._low, self._high), (qvel, -fastest, fastest)):
            # All steps of a world are one row: few long ones are faster than many.
            rows = xp.reshape(each, (len(each), steps * len(bounds[0])))
            low, high = (xp.asarray(np.tile(bound, steps)) for bound in bounds)
            inside = (rows >= low) & (rows <= high)
            if not xp.all(inside):  # Seldom.
                stray = stray | ~xp.all(xp.reshape(inside, each.shape), axis=-1)
        return xp.zeros(qpos.shape[:-1], dtype=xp.bool) | stray

    def too_deep(self, sensordata: Array) -> Array:
        """Return after which steps something is too deep in something else."""
        xp = array_namespace(sensordata)
        is_shallow = sensordata[..., self._depths] >= -_DEEPEST
        if xp.all(is_shallow):  # Nearly always, and faster.
            return xp.zeros(sensordata.shape[:-1], dtype=xp.bool)
        return ~xp.all(is_shallow, axis=-1)

    def too_fast(self, qvel: Array) -> Array:
        """Return after which short steps an arm needs a protective stop."""
        xp = array_namespace(qvel)
        return ~xp.all(xp.abs(qvel) / xp.asarray(self._limits) <= _STOPPED, axis=-1)

    def stop(self, start: Array, qpos: Array, qvel: Array) -> None:
        """Slow arms down that are still too fast after a short step."""
        xp = array_namespace(qpos)
        for arm in self._arms:
            limits = xp.asarray(arm.robot.velocity_limits)
            fastest = xp.max(xp.abs(qvel[:, arm.dof]) / limits, axis=1)[:, None]
            share = _STOPPED / xp.maximum(fastest, _STOPPED)
            before, after = start[:, arm.qpos], qpos[:, arm.qpos]
            slowed = before + share * (after - before)
            qpos[:, arm.qpos] = xp.where(share < 1.0, slowed, after)
            qvel[:, arm.dof] *= share


def _unusual(model: mujoco.MjModel) -> np.ndarray:
    """Return the bodies whose trees have contacts that do not give way as all others.

    Those of a puck do not: it may be deep in what it bounces from.
    """
    collides = (model.geom_contype | model.geom_conaffinity) > 0
    odd = collides & (model.geom_solref != SOLREF).any(axis=1)
    return np.unique(model.body_rootid[model.geom_bodyid[odd]])


def _short(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    fields = {"opt.timestep": np.array(SIM_DT / SHORT_STEPS)}
    for name in ("geom_solref", "jnt_solref"):
        usual = getattr(model, name)
        stiff = np.where(usual == SOLREF, (_SHORT_SOLREF, 1.0), usual)
        # A damping that is given directly turns a body round within one step.
        stiff[usual[:, 0] < 0.0, 1] *= SHORT_STEPS
        fields[name] = stiff
    return fields
