"""Grips: an arm's hand and a site of a thing, held together by a constraint."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import Sim

_TEARING = 2.0  # distance at which a grip tears, over that at which it can start
_HOLDS, _CLOSED = 1.0, 2.0  # what `userdata` says of a hand that is not open


class Grips:
    """Takes, holds and tears the grips of a scene's arms.

    A grip starts at the beginning of a control step if the agent asks for it, the site
    is near and the hand was open: fingers that have closed on nothing take nothing
    until they have opened, so that no hand can sweep up what it does not see. It lasts
    while the agent asks for it, unless it tears. It tears before a physics step that
    would load it above what the gripper holds, or at whose start the two are more than
    twice the starting distance apart. What is torn out of one hand also slips out of
    another hand that holds it at the same site; otherwise that hand could win a thing
    by force. After a tear the hand opens for one control step and cannot grip;
    otherwise a grip that is too weak would start and tear in every step.
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

    def command(self, controls: Array, commands: Mapping[str, Any]) -> None:
        """Take and leave grips for a control step, and close the fingers that hold."""
        sim, xp, sensed = self._sim, self._sim.xp, self._sim.sensordata
        is_held = sim.eq_active[:, self._equalities] > 0
        hands = sim.userdata[:, : len(self._agents)]
        # A grip that held at the last command, and does not now, has torn.
        has_torn = (hands == _HOLDS) & ~is_held
        gap = math.norm(sensed[:, self._tcps] - sensed[:, self._sites])
        wanted = xp.stack([commands[agent].grips for agent in self._agents], axis=1)
        takes = (gap < self._thresholds) & (hands != _CLOSED)
        holds = wanted & (is_held | takes) & ~has_torn
        sim.eq_active[:, self._equalities] = holds
        is_empty = wanted & ~holds & ~has_torn
        sim.userdata[:, : len(self._agents)] = _HOLDS * holds + _CLOSED * is_empty
        for i, fingers in enumerate(self._fingers):
            is_closed, opened = holds[:, i, None, None], controls[:, :, fingers]
            controls[:, :, fingers] = xp.where(is_closed, self._closed[i], opened)

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
