"""BalancePath: arms lead a ball along a path in space, on a board that they hold.

This is Balance with a moving target. Seen from above, the target follows a figure of
eight: in each lap it goes to and fro twice across the board and once along it.
Meanwhile it rises and sinks once. The ball must stay at the target, so the whole board
must rise and sink with it. An arm that holds still keeps its end of the board where it
is. The other arm can tilt the board but cannot lift the far end, because the board is a
lever of 1.6 m and an arm's wrist is weak. Teams of three to eight hold a round board,
as in Balance. Three Pandas need every arm; four can carry a limp one, and six an idle
one (`benchmarks/teams.py --tasks BalancePath --faults idle limp`).

Randomized: what Balance randomizes; the path's position (along every axis) and size
(0.9 to 1); where on the path the target starts, and in which direction it runs.
Pictures show the path as a line, as large as paths are on average.

Reward of each agent:

- `distance`: minus the distance between the centres of ball and target, in m.
- `fell`: -1 once the ball has left the board, even if it returns, else 0.

Success: this distance has stayed below 0.06 m for a whole lap of 12 s, without a break,
and the ball is on the board. From then on, performance is the share of steps for which
this remains true.

Coordination: `stage` is the greatest share of a lap that this has lasted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from collaborative_gym import math
from collaborative_gym.control import ActionMode
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks import registry
from collaborative_gym.tasks.balance import (
    REST_HEIGHT,
    Balance,
    BalanceConfig,
    BalanceFacts,
)
from collaborative_gym.tasks.experts import balance as player
from collaborative_gym.tasks.settings import bounded
from collaborative_gym.tasks.task import Blocks, Kept
from collaborative_gym.timing import CONTROL_DT, SIM_DT

_SMALLEST = 0.9  # share of the path's size
_CORNERS = 60  # of the line that shows it
_ROUNDS = (2.0, 1.0, 1.0)  # in a lap, along x, y and z
_START = (0.0, 0.0, np.pi / 2)  # rad, so that the target turns highest at y = 0


@dataclass(frozen=True)
class BalancePathConfig(BalanceConfig):
    """Settings of BalancePath.

    Attributes:
      success_distance: between the centres of ball and target, in m.
      path_x: how far the target goes either way along x, twice in a lap, in m.
      path_y: how far it goes either way along y, in m.
      path_z: how far it rises above the middle of the path and sinks below, in m.
      lap: time in which the target runs along the path, in s.
    """

    success_distance: float = bounded(0.06, 0.001, 10.0)
    path_x: float = bounded(0.1, 0.0, 1.0)
    path_y: float = bounded(0.15, 0.0, 1.0)
    path_z: float = bounded(0.15, 0.0, 1.0)
    lap: float = bounded(12.0, CONTROL_DT, 1e6)


@dataclass(frozen=True)
class BalancePathFacts(BalanceFacts):
    """Facts of BalancePath; `distance` is from the ball to the target."""

    target: Array  # (num_envs, 3) its place, in m
    target_velocity: Array  # (num_envs, 3) in m/s
    coming: tuple[Array, Array, Array]  # place, velocity, acceleration a step later
    followed: Array  # (num_envs,) how long the ball has been near it, in s, else 0
    stage: Array  # (num_envs,) that time, as a share of a lap


class BalancePath(Balance):
    """Lead a ball along a path in space, on a board that all arms hold."""

    config_class = BalancePathConfig
    config: BalancePathConfig
    units: ClassVar[Mapping[str, str]] = {"distance": "m", "followed": "s", "stage": ""}
    coordination: ClassVar[Mapping[str, Kept]] = {"stage": "greatest"}
    performance_from_start = False
    success_for = 1  # It says itself how long.
    expert = player.path_expert

    @property
    def marked_radius(self) -> float:
        return 0.0

    def build(self, scene: Scene) -> None:
        super().build(scene)
        scene.add_target("target", self.config.success_distance)
        size = self.config.path_x, self.config.path_y, self.config.path_z
        angles = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)[:, None]
        drawn = (1 + _SMALLEST) / 2 * np.array(size)  # As large as paths on average.
        scene.add_path("path", drawn * np.sin(angles * _ROUNDS + _START))

    def setup(self, scene: Scene, sim: Sim, *, action_mode: ActionMode) -> None:
        super().setup(scene, sim, action_mode=action_mode)
        config, xp = self.config, sim.xp
        self._size = xp.asarray([config.path_x, config.path_y, config.path_z])
        self._middle = xp.asarray(self.centre + np.array([0.0, 0.0, REST_HEIGHT]))
        self._rounds, self._start = xp.asarray(_ROUNDS), xp.asarray(_START)

    def poses(self) -> list[tuple[np.ndarray, np.ndarray]]:
        level, rise = super().poses(), np.array([0.0, 0.0, self.config.path_z])
        tilted = [(p + up * rise, q) for up in (-1.0, 1.0) for p, q in level[-4:]]
        return level + tilted

    def remember(self, num_envs: int) -> dict[str, Array]:
        blank = self.xp.zeros((num_envs, 7), dtype=self.xp.float64)
        # How far the path lies from its nominal place along x, y and z, the angle at
        # its start, which way round it goes, its size; when the ball was last away.
        own = {"path": blank[:, :6], "away": blank[:, 6]}
        return {**super().remember(num_envs), **own}

    def reset(self, sim: Sim, env_ids: np.ndarray, *, rng: EpisodeRandom) -> None:
        super().reset(sim, env_ids, rng=rng)
        moved = rng.within(self.config.randomization.target_position, 3)
        drawn = rng.uniform([0.0, -1.0, _SMALLEST], [2 * np.pi, 1.0, 1.0], 3)
        drawn[:, 1] = np.where(drawn[:, 1] < 0.0, -1.0, 1.0)
        path = np.concatenate([moved, drawn], axis=1)
        sim.memory["path"][env_ids] = sim.xp.asarray(path)
        start = self._at(sim, sim.time)[0][env_ids]
        self.scene.place(sim, env_ids, name="target", position=start)
        middle = self._middle + sim.xp.asarray(moved)
        self.scene.place(sim, env_ids, name="path", position=middle)

    def disturb(self, sim: Sim, steps: np.ndarray) -> None:
        super().disturb(sim, steps)
        coming = self._at(sim, sim.time + CONTROL_DT)[0]
        self.scene.place(sim, slice(None), name="target", position=coming)

    def _at(self, sim: Sim, time: Array) -> tuple[Array, Array, Array]:
        """Return the target's place, velocity and acceleration at times in s."""
        xp, path = sim.xp, sim.memory["path"]
        rate = (2 * np.pi / self.config.lap) * path[:, 4:5] * self._rounds
        angle = path[:, 3:4] * self._rounds + rate * time[:, None] + self._start
        size = path[:, 5:6] * self._size
        offset = size * xp.sin(angle)
        place = self._middle + path[:, :3] + offset
        return place, size * rate * xp.cos(angle), -(rate**2) * offset

    def measure(self, sim: Sim) -> BalancePathFacts:
        facts = super().measure(sim)
        target, velocity, _ = self._at(sim, sim.time)
        distance = math.distance(facts.ball[0], target)
        is_near = (distance < self.config.success_distance) & ~facts.fell
        away = sim.xp.where(is_near, sim.memory["away"], sim.time)
        sim.memory["away"] = away
        return BalancePathFacts(
            **{**vars(facts), "distance": distance},
            target=target,
            target_velocity=velocity,
            coming=self._at(sim, sim.time + CONTROL_DT),
            followed=sim.time - away,
            stage=(sim.time - away) / self.config.lap,
        )

    def observe(self, facts: BalancePathFacts) -> dict[str, Blocks]:
        place, velocity = facts.target, facts.target_velocity
        seen, frames = super().observe(facts), self._frames
        for agent, blocks in seen.items():
            if self.config.egocentric:
                place = frames.place(agent, facts.target)
                velocity = frames.direction(agent, facts.target_velocity)
            own = {"target": place, "target velocity": velocity}
            seen[agent] = {**blocks, **own}
        return seen

    def success(self, facts: BalancePathFacts) -> Array:
        # Times are sums of physics steps, and so are rounded.
        return facts.followed > self.config.lap - SIM_DT / 2

    def performing(self, facts: BalancePathFacts) -> Array:
        return facts.followed > 0.0

    def shortfall(self, facts: BalancePathFacts) -> Array:
        xp = self.xp
        missing = facts.distance + 1.0 - facts.followed / self.config.lap
        return xp.where(self.success(facts), 0.0, missing)


registry.register_task("BalancePath", BalancePath)
for _arms in ("Sawyers", "JacoSawyer"):
    _spec = registry.get_env(f"BalanceTask{_arms}-v0")
    registry.register_env(
        replace(_spec, env_id=f"BalancePath{_arms}-v0", task=BalancePath)
    )
registry.register_teams("BalancePath", BalancePath, pandas=[3, 4, 6])
