"""Grips: when hands take, hold and lose things, however their grasp holds them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from collaborative_gym.control.drives import FULL
from collaborative_gym.math import Array
from collaborative_gym.scene import Scene
from collaborative_gym.scene.hands import Bonds
from collaborative_gym.sim.sim import Sim

_TEARING = 2.0  # distance at which a grip tears, over that at which it can start
_HOLDS, _CLOSED, _TORN = 1.0, 2.0, -3.0  # `userdata` of hands; below 0, they open


class Grips:
    """Takes, holds and tears the grips of a scene's arms.

    A grip starts at the beginning of a control step if the agent asks for it, the site
    is near and the hand was open: fingers that have closed on nothing take nothing
    until they have opened, so no hand can sweep up what it does not see. It lasts while
    the agent asks for it, unless it tears: before a physics step that would load it
    above what the grasp bears, or at whose start the two are farther apart than twice
    the distance at which a grip can start. What is torn out of one hand also slips out
    of another that holds it at the same site, and each opens for three control steps,
    while the thing falls. Otherwise arms would win things by tearing them away.
    """

    def __init__(self, scene: Scene, sim: Sim):
        assert isinstance(scene.hands, Bonds)
        self._sim, self._bonds, xp = sim, scene.hands, sim.xp
        arms = [scene.arms[grip.agent] for grip in scene.grips]
        grippers = [arm.robot.gripper for arm in arms]
        closed, self._opens = scene.grasp.closes, scene.grasp.draws
        self._agents = [grip.agent for grip in scene.grips]
        self._fingers = [arm.fingers for arm in arms]
        self._closed = [
            gripper.position(grip.width) if closed else gripper.open_position
            for gripper, grip in zip(grippers, scene.grips, strict=True)
        ]
        self._equalities = xp.asarray(self._bonds.ids)
        self._thresholds = xp.asarray([grip.threshold for grip in scene.grips])
        self._strengths = xp.asarray(self._bonds.strengths)
        sites = np.array([grip.site for grip in scene.grips])
        self._same_site = xp.asarray(sites == sites[:, None])

    def command(self, controls: Array, commands: Mapping[str, Any]) -> None:
        """Take and leave grips for a control step, and close the fingers that hold."""
        sim, xp, bonds = self._sim, self._sim.xp, self._bonds
        is_held = sim.eq_active[:, self._equalities] > 0
        hands = sim.userdata[:, : len(self._agents)]
        # A grip that held at the last command, and does not now, has torn.
        has_torn = (hands == _HOLDS) & ~is_held & self._opens
        opens = xp.where(has_torn, _TORN, xp.minimum(hands, xp.zeros_like(hands)))
        wanted = xp.stack([commands[agent].grips for agent in self._agents], axis=1)
        wanted = wanted & (opens == 0.0)
        takes = (bonds.gaps(sim.sensordata) < self._thresholds) & (hands != _CLOSED)
        holds = wanted & (is_held | takes)
        bonds.hold(sim, holds)
        bonds.renew(sim)
        hands[:] = _HOLDS * holds + _CLOSED * (wanted & ~holds) + opens + (opens < 0.0)
        for i, fingers in enumerate(self._fingers):
            is_closed, opened = holds[:, i, None, None], controls[:, :, fingers]
            controls[:, :, fingers] = xp.where(is_closed, self._closed[i], opened)

    def tears(self, sensordata: Array, active: Array) -> Array:
        """Return which grips tear; see `Breaks` of the simulation."""
        xp, shape = self._sim.xp, (*sensordata.shape[:-1], self._sim.model.neq)
        load, gap = self._bonds.loads(sensordata), self._bonds.gaps(sensordata)
        holds = active[..., self._equalities]
        torn = (load > self._strengths) | (gap > _TEARING * self._thresholds)
        torn, tears = torn & holds, xp.zeros(shape, dtype=xp.bool)
        if xp.any(torn):  # Seldom.
            slips = xp.any(torn[..., None, :] & self._same_site, axis=-1)
            tears[..., self._equalities] = slips & holds
        return tears


class Fingers:
    """Fingers that close with all their force where an agent asks for a grip.

    They hold what they touch, and nothing tears: what they do not bear slips.
    """

    tears = None

    def __init__(self, scene: Scene, sim: Sim):
        self._xp, self._hands = sim.xp, []
        for agent in dict.fromkeys(grip.agent for grip in scene.grips):
            arm = scene.arms[agent]
            gripper = arm.robot.gripper
            # So far beyond that their servos press with all they have.
            ends = gripper.open_position, gripper.closed_position
            beyond = ends[1] + np.copysign(FULL, ends[1] - ends[0])
            self._hands.append((agent, arm.fingers, beyond))

    def command(self, controls: Array, commands: Mapping[str, Any]) -> None:
        """Close and open fingers for a control step."""
        for agent, fingers, closed in self._hands:
            opened = controls[:, :, fingers]
            wanted = commands[agent].grips[:, None, None]
            controls[:, :, fingers] = self._xp.where(wanted, closed, opened)
