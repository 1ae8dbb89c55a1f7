"""Grips: where they are taken, and when they tear."""

from dataclasses import dataclass

from collaborative_gym import math
from collaborative_gym.math import Array
from collaborative_gym.scene import Grip, Scene
from collaborative_gym.sim.sim import Sim

_TEARING = 2.0
"""Distance between tcp and site at which a grip tears, in thresholds of taking it."""


@dataclass(frozen=True)
class _Hold:
    """A grip in the compiled world.

    Attributes:
      grip: the grip.
      equality: id of its constraint.
      fingers: the hand's finger actuators in `ctrl`.
      closed: where it closes them.
      strength: force at which it tears, in N.
      force: where `sensordata` has the force on the hand's palm.
      places: where it has the positions of tcp and site.
    """

    grip: Grip
    equality: int
    fingers: slice
    closed: float
    strength: float
    force: slice
    places: tuple[slice, slice]

    @classmethod
    def of(cls, grip: Grip, scene: Scene, sim: Sim) -> "_Hold":
        arm, model = scene.arms[grip.agent], sim.model

        def vector(name: str) -> slice:
            start = int(model.sensor(name).adr[0])
            return slice(start, start + 3)

        return cls(
            grip,
            equality=model.equality(grip.name).id,
            fingers=arm.fingers,
            closed=arm.robot.gripper.position(grip.width),
            strength=arm.robot.gripper.holding_force,
            force=vector(grip.palm),
            places=(
                vector(f"{grip.agent}/tcp.position"),
                vector(f"{grip.site}.position"),
            ),
        )

    def gap(self, sensordata: Array) -> Array:
        """Return the distance between tcp and site, (...,), in m."""
        tcp, site = (sensordata[..., place] for place in self.places)
        return math.norm(tcp - site)


class Grips:
    """Takes, holds and tears the grips of a scene's arms.

    A grip is taken at the start of a control step if the agent asks for it and the site
    is near. It lasts while the agent asks, unless it tears: a physics step that would
    load it above what the gripper holds, or that begins beyond twice the distance at
    which it can be taken, is taken without it. A torn grip is not taken in the next
    control step, in which the hand opens; else one that is too weak would be taken and
    torn in each.

    Args:
      scene: the compiled scene.
      sim: its worlds.
    """

    def __init__(self, scene: Scene, sim: Sim):
        self._sim = sim
        self._holds = [_Hold.of(grip, scene, sim) for grip in scene.grips]

    def command(self, controls: Array, asked: dict[str, Array]) -> None:
        """Take and leave grips for a control step; close the fingers where one holds.

        Args:
          controls: (num_envs, substeps, nu), what is written to.
          asked: by agent, in which worlds it grips, (num_envs,).
        """
        sim = self._sim
        for i, hold in enumerate(self._holds):
            is_held = sim.eq_active[:, hold.equality] > 0
            # What the last command held and is held no more has torn.
            has_torn = (sim.userdata[:, i] > 0) & ~is_held
            is_near = hold.gap(sim.sensordata) < hold.grip.threshold
            holds = asked[hold.grip.agent] & (is_held | is_near) & ~has_torn
            sim.eq_active[:, hold.equality] = sim.userdata[:, i] = holds
            controls[:, :, hold.fingers] = sim.xp.where(
                holds[:, None, None], hold.closed, controls[:, :, hold.fingers]
            )

    def tears(self, sensordata: Array) -> Array:
        """Return which grips tear; see `Breaks` of the simulation."""
        xp, shape = self._sim.xp, (*sensordata.shape[:-1], self._sim.model.neq)
        tears = xp.zeros(shape, dtype=xp.bool)
        for hold in self._holds:
            is_over = math.norm(sensordata[..., hold.force]) > hold.strength
            is_far = hold.gap(sensordata) > _TEARING * hold.grip.threshold
            tears[..., hold.equality] = is_over | is_far
        return tears
