"""Disturbances of episodes beside their starts, as `Randomization` describes them.

All of it is drawn from the seed and the index of an episode alone, before its first
step. So a saved state needs only the actions that are on their way.
"""

from typing import Any

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.control import ActionMode
from collaborative_gym.envs.progress import Progress
from collaborative_gym.errors import look_up
from collaborative_gym.math import Array
from collaborative_gym.rng import EpisodeRandom, Stream
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import Task

_OF_MODELS = ("link_mass", "payload", "friction", "lost_torque", "limp", "absent")
_OF_WRISTS = "force_noise", "torque_noise", "force_bias", "torque_bias"
_OF_STEPS = ("delay", "lost_actions", "position_noise", "angle_noise")


class Disturbances:
    """Changes models, actions and observations of worlds, and never their rewards.

    The reward counts what an arm does. A late or lost action costs what the arm does
    instead, not what the policy asked for. The rows of the progress get the actions
    that are on their way.

    Attributes:
      changes_actions: whether actions may arrive late or not at all.
      has_noise: whether the robots' sensors may err.
    """

    def __init__(
        self, task: Task, scene: Scene, sim: Sim, mode: ActionMode, progress: Progress
    ):
        self._task, self._scene, self._sim = task, scene, sim
        self._mode, self._progress = mode, progress
        self._bounds = bounds = task.config.randomization
        self._changes_models = any(getattr(bounds, name) for name in _OF_MODELS)
        self._blurs = bounds.position_noise > 0 or bounds.angle_noise > 0
        config = task.config
        # Columns of three forces, three torques and the force of the pads.
        self._felt = slice(6 * (config.wrench == "off"), 6 + config.pad_force)
        feels = self._felt.stop - self._felt.start
        self._shakes = feels > 0 and any(getattr(bounds, name) for name in _OF_WRISTS)
        self.has_noise = self._blurs or self._shakes
        self.changes_actions = bounds.delay > 0 or bounds.lost_actions > 0
        is_on = any(getattr(bounds, name) for name in _OF_STEPS)
        self._is_on = is_on or self._changes_models or self._shakes
        if not self._is_on:
            return
        for agent in (*bounds.limp, *bounds.absent):
            look_up("agent", agent, scene.arms)
        self._links, self._loads = _bodies(scene, sim.model)
        self._joints = np.r_[*(arm.qpos for arm in scene.arms.values())]
        self._places = _columns(sim.model, mujoco.mjtSensor.mjSENS_FRAMEPOS)
        self._turns = _columns(sim.model, mujoco.mjtSensor.mjSENS_FRAMEQUAT)
        self._sizes = len(self._joints), self._places.size, 3 * len(self._turns)
        worlds, steps = sim.num_envs, task.config.max_episode_steps
        self._is_late = np.zeros(worlds, bool)
        self._is_lost = np.zeros((worlds, steps, len(task.agents)), bool)
        if self._shakes:
            shape = worlds, steps + 1, len(task.agents), feels
            self._wrong = np.zeros(shape, np.float32)
        if self._blurs:
            # Single precision, as observations have no more.
            shape = worlds, steps + 1, sum(self._sizes)
            self._noise = np.zeros(shape, np.float32)
        if bounds.delay:
            for agent, still in mode.idle(worlds).items():
                queue = sim.xp.asarray(still)[:, None, :]
                queue = sim.xp.repeat(queue, bounds.delay, axis=1)
                progress.rows[_late(agent)] = queue

    def start(self, env_ids: np.ndarray) -> None:
        """Begin the episodes in which these worlds are, at their first step."""
        if self._bounds.delay:
            rows, still = self._progress.rows, self._mode.idle(len(env_ids))
            for agent, action in still.items():
                queue = self._sim.xp.asarray(rows[_late(agent)], copy=True)
                queue[env_ids] = self._sim.xp.asarray(action)[:, None, :]
                rows[_late(agent)] = queue
        self.draw(env_ids)

    def draw(self, env_ids: np.ndarray) -> None:
        """Draw what disturbs the episodes in which these worlds are."""
        if not self._is_on or not len(env_ids):
            return
        bounds, rows = self._bounds, self._progress.rows
        where = rows["seed"][env_ids], rows["episode"][env_ids]
        rng = EpisodeRandom(*where, Stream.DISTURBANCES)
        # All are drawn, even those that are off, so that none changes others.
        links = 1.0 + rng.within(bounds.link_mass, len(self._links))
        loads = 1.0 + rng.within(bounds.payload, len(self._loads))
        friction = 1.0 + rng.within(bounds.friction)
        agents = len(self._task.agents)
        weak = rng.uniform(0, agents).astype(int)
        self._is_late[env_ids] = rng.uniform(0.0, 1.0) < bounds.delayed
        lost = rng.uniform(0.0, 1.0, self._is_lost.shape[1:])
        self._is_lost[env_ids] = lost < bounds.lost_actions
        if self._blurs:
            bound = [bounds.angle_noise, bounds.position_noise, bounds.angle_noise]
            size = self._noise.shape[1:]
            self._noise[env_ids] = rng.within(np.repeat(bound, self._sizes), size)
        if self._changes_models:
            model = self._sim.model
            masses = np.ones((len(env_ids), model.nbody))
            changed = zip(self._links + self._loads, [*links.T, *loads.T], strict=True)
            for bodies, factor in changed:
                masses[:, bodies] = factor[:, None]
            torques = np.ones((len(env_ids), model.nu, 1))
            for i, arm in enumerate(self._scene.arms.values()):
                torques[weak == i, arm.servos] -= bounds.lost_torque
            factors = self._still(torques) | {
                "body_mass": masses,
                "body_inertia": masses[:, :, None],
                "geom_friction": friction[:, None, None],
                "actuator_forcerange": torques,
            }
            self._sim.vary(env_ids, factors)
        if self._shakes:
            # Drawn last, so that it changes nothing else.
            self._wrong[env_ids] = self._draw_wrong(rng)

    def _draw_wrong(self, rng: EpisodeRandom) -> np.ndarray:
        """Return the errors of sensors of force, (episodes, steps, agents, k)."""
        bounds, shape = self._bounds, self._wrong.shape[1:]
        bias, noise = (
            np.repeat([force, torque, force], [3, 3, 1])[self._felt]
            for force, torque in (
                (bounds.force_bias, bounds.torque_bias),
                (bounds.force_noise, bounds.torque_noise),
            )
        )
        return rng.within(bias, shape[1:])[:, None] + rng.within(noise, shape)

    def _still(self, torques: np.ndarray) -> dict[str, np.ndarray]:
        """Return factors of models with arms that are limp or absent.

        `torques` are the factors of the torque limits, which are written to.
        """
        model, bounds = self._sim.model, self._bounds
        links = dict(zip(self._scene.arms, self._links, strict=True))
        floats, touches = np.ones(model.nbody), np.ones(model.ngeom, np.int32)
        for agent in bounds.limp:
            torques[:, self._scene.arms[agent].servos] = 0.0
            floats[links[agent]] = 0.0
        for agent in bounds.absent:
            touches[np.isin(model.geom_bodyid, links[agent])] = 0
        return {
            "body_gravcomp": floats[None],
            "geom_contype": touches[None],
            "geom_conaffinity": touches[None],
        }

    def deliver(self, actions: dict[str, Array], resting: Array) -> dict[str, Array]:
        """Return the actions by agent that arrive; none is queued where worlds rest."""
        rows, xp = self._progress.rows, self._sim.xp
        if self._bounds.delay:
            late, due = xp.asarray(self._is_late)[:, None], {}
            for agent, action in actions.items():
                queue = rows[_late(agent)]
                due[agent] = xp.where(late, queue[:, 0], action)
                queued = xp.concat([queue[:, 1:], action[:, None]], axis=1)
                rows[_late(agent)] = xp.where(resting[:, None, None], queue, queued)
            actions = due
        if self._bounds.lost_actions:
            lost = xp.asarray(self._now(self._is_lost))
            able = {grip.agent for grip in self._scene.grips}
            grips = {a: self._scene.holds(self._sim, a) for a in able}
            still = self._mode.idle(self._sim.num_envs, grips)
            actions = {
                agent: xp.where(lost[:, i, None], xp.asarray(still[agent]), action)
                for i, (agent, action) in enumerate(actions.items())
            }
        return actions

    def see(self, facts: Any) -> Any:
        """Return the facts as the robots see them, of the present state."""
        if not self._blurs:
            return facts
        sim, task, xp = self._sim, self._task, self._sim.xp
        ends = np.cumsum(self._sizes)[:-1]
        noise = np.split(self._now(self._noise).astype(float), ends, axis=1)
        angles, places, turns = (xp.asarray(each) for each in noise)
        qpos = xp.asarray(sim.qpos, copy=True)
        qpos[:, self._joints] = qpos[:, self._joints] + angles
        sensed = xp.asarray(sim.sensordata, copy=True)
        shape = (sim.num_envs, -1, 3)
        sensed[:, self._places] = sensed[:, self._places] + places.reshape(shape)
        turned = math.from_rotation_vector(turns.reshape(shape))
        sensed[:, self._turns] = math.multiply(turned, sensed[:, self._turns])
        return task.measure(sim.seen(qpos, sensed))

    def feel(self, felt: dict[str, Array]) -> dict[str, Array]:
        """Return what arms feel, as `World.feel` does, as their sensors give it."""
        if not self._shakes:
            return felt
        wrong = self._sim.xp.asarray(self._now(self._wrong).astype(float))
        return {agent: f + wrong[:, i] for i, (agent, f) in enumerate(felt.items())}

    def _now(self, drawn: np.ndarray) -> np.ndarray:
        steps = np.asarray(self._progress.rows["step"])
        # The worlds that rest at their episode's end have no next step.
        steps = np.minimum(steps, drawn.shape[1] - 1)
        return drawn[np.arange(len(drawn)), steps]


def _late(agent: str) -> str:
    """Return the name of the rows of an agent's actions that are on their way."""
    return f"{agent}: late actions"


def _columns(model: mujoco.MjModel, kind: mujoco.mjtSensor) -> np.ndarray:
    """Return where the sensors of a kind are in `sensordata`, (sensors, values)."""
    own = np.flatnonzero(model.sensor_type == kind)
    size = 3 if kind == mujoco.mjtSensor.mjSENS_FRAMEPOS else 4
    return model.sensor_adr[own][:, None] + np.arange(size)


def _bodies(scene: Scene, model: mujoco.MjModel) -> tuple[list[list[int]], ...]:
    """Return the bodies of each arm's links, and those of each tool and loose thing."""
    links = {agent: [] for agent in scene.arms}
    loads: dict[str, list[int]] = {}
    for body in range(model.nbody):
        agent, _, rest = model.body(body).name.partition("/")
        tool = rest.partition("/")[0]
        if tool and tool in scene.tools.get(agent, ()):
            loads.setdefault(f"{agent}/{tool}", []).append(body)
        elif agent in links:
            links[agent].append(body)
        elif model.body_treeid[body] >= 0:
            loads.setdefault(f"tree {model.body_treeid[body]}", []).append(body)
    return list(links.values()), list(loads.values())
