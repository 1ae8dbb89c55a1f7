"""The one environment loop: many worlds of one task, stepped together."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from collaborative_gym.control import Controller, JointChanges
from collaborative_gym.envs.definition import try_out
from collaborative_gym.envs.progress import Progress
from collaborative_gym.errors import (
    MOST_ENVS,
    MOST_THREADS,
    SimulationDiverged,
    check_count,
    check_flag,
    check_kind,
)
from collaborative_gym.math import Array
from collaborative_gym.pictures.rendering import Camera
from collaborative_gym.rng import EpisodeRandom, check_seed
from collaborative_gym.robots import Robot
from collaborative_gym.scene import Scene
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.sim.sim import EnvIds
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Randomization, Task, Terms
from collaborative_gym.timing import CONTROL_DT, SUBSTEPS

Observations = dict[str, Array]


@dataclass(frozen=True)
class EnvState:
    """What `VectorEnv.set_state` needs to continue episodes bit for bit.

    Attributes:
      physics: rows of the backend's state.
      memory: rows of the task's memory, by name.
      progress: rows of the episodes' counters and sums, by name.
    """

    physics: Array
    memory: dict[str, Array]
    progress: dict[str, Array]


class VectorEnv:
    """Worlds of one task, with dictionaries by agent of (num_envs, ...) arrays.

    An episode lasts `max_episode_steps` control steps, unless the task says earlier
    that it is `over`: then it is terminated. Where time is up or the physics diverged
    it is truncated. A world whose episode ends starts its next one in the same step.
    World i plays the episodes i, i + num_envs, i + 2 num_envs and so on of the seed.
    All arrays that are returned are the caller's own.

    `infos` has, at every step, arrays by world: `episode` (index), `step` (control
    steps done), `success`, `diverged`, and `reward_terms` by agent and term. Where an
    episode `ended` (a mask), `final_observation` (by agent) is its last observation and
    `metrics` describe it: `return` (summed over agents), `returns` by agent,
    `completion`, `performance`, `length`, `time_to_success` (s, NaN if never),
    `reward_terms` (sums), `episode` and `seed`. Elsewhere these rows mean nothing.
    Performance is a share of the steps that were played, whenever the episode ended.

    Where a task has several sides, `success` and the metrics `return`, `completion`,
    `performance` and `time_to_success` are dictionaries by side; nothing is summed over
    opponents.

    Args:
      task: what to do, from `make_task`.
      num_envs: how many worlds.
      seed: of the first episodes.
      num_threads: physics threads, 0 for one per CPU.
      auto_reset: whether a world goes on to its next episode by itself. Without, it
        stays as the episode left it, and the next step is allowed only after `reset`.

    Attributes:
      task: the task.
      num_envs: how many worlds.
      agents: the agents' names.
      sides: the agents of each side, by its name: "side_1" and so on.
      single_observation_spaces: space of one world's observation, by agent.
      single_action_spaces: space of one world's action, by agent.
      observation_blocks: names and sizes of an observation's parts, by agent.
      reward_terms: names of a reward's parts, by agent.
      model: the compiled world.
      scene: handles into it.
      sim: the physics.
      substeps: physics steps in a control step.
      control_dt: time of a control step, in s.
      facts: what the task measured of the present state.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        seed: int = 0,
        num_threads: int = 0,
        auto_reset: bool = True,
    ):
        check_kind("task", task, Task, "a task, as make_task returns it")
        num_envs = check_count("num_envs", num_envs, 1, MOST_ENVS)
        num_threads = check_count("num_threads", num_threads, 0, MOST_THREADS)
        auto_reset = check_flag("auto_reset", auto_reset)
        seed = check_seed(seed)
        # A copy of its own, so that one task may serve several environments.
        self.task = task = copy(task)
        self.num_envs = num_envs
        self.agents = task.agents
        self.substeps = SUBSTEPS
        self.control_dt = CONTROL_DT
        self.scene = Scene()
        task.build(self.scene)
        self.model = self.scene.compile()
        self.sim = CpuSim(self.model, num_envs, num_threads)
        self._mode = JointChanges(self.scene.arms, task.gripping, self.sim.xp)
        self._controller = Controller(self.scene, self.sim, self._mode)
        task.setup(self.scene, self.sim, self._mode)
        self._camera: Camera | None = None
        self._watcher: Callable[[], object] | None = None
        self._shots = 1
        self._auto_reset = auto_reset
        self._is_started = False
        self._is_over = False
        self._is_closed = False
        definition = try_out(task, self.scene, self.sim, self._controller)
        self.observation_blocks = definition.observation_blocks
        self.single_observation_spaces = definition.observation_spaces
        self.single_action_spaces = definition.action_spaces
        self.reward_terms = definition.reward_terms
        self.sides = definition.sides
        self._progress = Progress(
            task,
            self.sim.xp,
            num_envs=num_envs,
            seed=seed,
            sides=self.sides,
            reward_terms=self.reward_terms,
        )

    def reset(
        self,
        seed: int | None = None,
        episodes: Sequence[int] | None = None,
        *,
        stagger: bool = False,
    ) -> tuple[Observations, dict[str, Any]]:
        """Start an episode in every world.

        Args:
          seed: starts the episodes 0, 1, 2 ... of this seed; None goes on to each
            world's next episode, at first to those of the constructor's seed.
          episodes: with a seed, the episode index of each world instead.
          stagger: spread the worlds over the episode's length, as if each had started
            at another time, so that in training they do not all end together. The
            first episodes are shorter for it.

        Returns:
          Observations by agent, (num_envs, k) float32, and infos.

        Raises:
          TypeError: if the seed is no integer.
          ValueError: if the seed is negative or the episodes do not fit.
        """
        self._check_open()
        if seed is not None:
            self._progress.begin(check_seed(seed), self._check_episodes(episodes))
        elif episodes is not None:
            raise ValueError("episodes are counted within a seed; pass seed too")
        self._is_started, self._is_over = True, False
        self._start_episodes(np.arange(self.num_envs))
        if stagger:
            self._progress.stagger()
        facts = self.task.measure(self.sim)
        self.facts = facts
        self._observations = self._observe(facts)
        progress = self.progress
        infos = {
            "episode": progress["episode"],
            "step": progress["step"],
            "success": self._progress.met(self.task.success(facts)),
        }
        return _copied(self._observations), infos

    def step(
        self, actions: Mapping[str, Array]
    ) -> tuple[
        Observations,
        dict[str, Array],
        dict[str, Array],
        dict[str, Array],
        dict[str, Any],
    ]:
        """Do one control step in every world.

        Args:
          actions: by agent, (num_envs, k), each component in [-1, 1]; what lies beyond
            counts as the nearest bound.

        Returns:
          Observations, rewards, terminated and truncated by agent, and infos.

        Raises:
          ValueError: if the actions are not what the spaces say; no world is changed.
          RuntimeError: before the first `reset`, after `close`, and after an episode's
            end where worlds do not reset themselves.
        """
        self._check_started("step")
        if self._is_over:
            raise RuntimeError("the episode has ended; call reset() before step()")
        actions = self._check_actions(actions)
        controls = self._controller.command(actions)
        self.task.disturb(self.sim, self._progress.step)
        diverged = self._advance(controls)
        facts = self.task.measure(self.sim)
        terms, rewards = self._reward(facts, actions, diverged)
        success = self._progress.count(facts, terms, diverged)
        progress = self.progress
        over = self.task.over(facts)
        is_terminated = ~diverged & (False if over is None else over)
        ended = diverged | self._progress.is_timed_out | is_terminated
        final_observations = self._observe(facts)
        for agent in self.agents if diverged.any() else ():
            final_observations[agent][diverged] = self._observations[agent][diverged]
        infos = {
            "episode": progress["episode"],
            "step": progress["step"],
            "success": success,
            "diverged": diverged,
            "reward_terms": terms,
            "ended": ended,
            "final_observation": final_observations,
            "metrics": self._progress.metrics(diverged) if ended.any() else {},
        }
        if ended.any() and self._auto_reset:
            self._start_episodes(np.flatnonzero(ended))
            facts = self.task.measure(self.sim)
            self._observations = self._observe(facts)
        else:
            self._observations = _copied(final_observations)
            self._is_over = bool(ended.any())
        self.facts = facts
        terminated = {agent: is_terminated.copy() for agent in self.agents}
        truncated = {agent: ended & ~is_terminated for agent in self.agents}
        return _copied(self._observations), rewards, terminated, truncated, infos

    def expert(self) -> dict[str, np.ndarray]:
        """Return the task's scripted expert's actions for the present state."""
        self._check_started("expert")
        motions = self.task.expert(self.sim, self.facts)
        try:
            actions = self._mode.encode(self.sim, motions)
            self._check_actions(actions)
        except ValueError as error:
            raise ValueError(f"{type(self.task).__name__}.expert(): {error}") from None
        return actions

    def idle(self) -> dict[str, np.ndarray]:
        """Return actions of robots that hold still and grip nothing."""
        return self._mode.idle(self.num_envs)

    def get_state(self, env_ids: EnvIds = None) -> EnvState:
        """Return a copy of these worlds' episodes, one row each; None for all."""
        self._check_started("get_state")
        rows = slice(None) if env_ids is None else env_ids
        return EnvState(
            physics=self.sim.get_state(env_ids),
            memory=_taken(self.task.memory, rows),
            progress=_taken(self._progress.rows, rows),
        )

    def set_state(self, state: EnvState, env_ids: EnvIds = None) -> Observations:
        """Continue saved episodes in these worlds; return all worlds' observations.

        Args:
          state: from `get_state` of an environment with the same id and options.
          env_ids: as many worlds as the state has rows; None for all.

        Raises:
          IndexError: if there are no such worlds.
          ValueError: if the state does not fit; no world is changed.
          RuntimeError: for some of the worlds before the first `reset`.
        """
        self._check_open()
        if env_ids is not None:
            self._check_started("set_state")
        rows = np.arange(self.num_envs)[slice(None) if env_ids is None else env_ids]
        self._check_state(state, rows)
        order = np.argsort(rows)
        self.sim.set_state(state.physics[order], rows[order])
        for kept, given in (
            (self.task.memory, state.memory),
            (self._progress.rows, state.progress),
        ):
            for name, array in given.items():
                kept[name][rows] = array
        self._is_started = True
        self._is_over = bool(self._progress.is_timed_out.any())
        self.facts = self.task.measure(self.sim)
        self._observations = self._observe(self.facts)
        return _copied(self._observations)

    @property
    def progress(self) -> dict[str, np.ndarray]:
        """The `seed` and index (`episode`) of each world's episode, and its `step`."""
        return self._progress.where()

    def watch(self, watcher: Callable[[], object] | None, shots: int = 1) -> None:
        """Call `watcher` during every control step, to film or show the motion.

        The physics is the same to the bit with and without.

        Args:
          watcher: what to call, or None to stop. It may write `xfrc_applied` alone.
          shots: how often per control step, evenly spread and the last at its end;
            must divide `substeps`.
        """
        if shots < 1 or self.substeps % shots:
            raise ValueError(f"shots must divide {self.substeps}, got {shots}")
        self._watcher = watcher
        self._shots = 1 if watcher is None else shots

    def render(
        self, env_id: int = 0, *, width: int = 640, height: int = 480
    ) -> np.ndarray:
        """Return a picture of one world, (height, width, 3) uint8.

        Raises:
          IndexError: if there is no such world.
          ValueError: if the picture is too large.
          RuntimeError: if no off-screen renderer can start; says what to install.
        """
        self._check_started("render")
        if not 0 <= env_id < self.num_envs:
            raise IndexError(f"no world {env_id}; worlds are 0 to {self.num_envs - 1}")
        if self._camera is None or self._camera.size != (width, height):
            self._close_camera()
            model = self.scene.compile_to_draw()
            self._camera = Camera(model, width, height)
        sim = self.sim
        return self._camera.picture(sim.qpos[env_id], sim.mocap_pos[env_id])

    def close(self) -> None:
        """Free the renderer. No other call is allowed afterwards."""
        self._close_camera()
        self._is_closed = True

    def _close_camera(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _check_open(self) -> None:
        if self._is_closed:
            raise RuntimeError("this environment is closed; make another")

    def _check_started(self, name: str) -> None:
        self._check_open()
        if not self._is_started:
            raise RuntimeError(f"call reset() before {name}()")

    def _check_episodes(self, episodes: Sequence[int] | None) -> np.ndarray:
        """Return the index of each world's first episode."""
        if episodes is None:
            return np.arange(self.num_envs)
        first = np.asarray(episodes)
        if first.shape != (self.num_envs,):
            raise ValueError(
                f"episodes has shape {first.shape}; give one index for each of the"
                f" {self.num_envs} worlds"
            )
        if first.dtype.kind not in "iu" or (first < 0).any():
            raise ValueError(f"episodes are counted 0, 1, 2 ...; got {first.tolist()}")
        return first

    def _check_state(self, state: EnvState, rows: np.ndarray) -> None:
        if len(np.unique(rows)) < len(rows):
            raise ValueError(f"env_ids {rows.tolist()} name a world twice")
        held = (
            ("memory", state.memory, self.task.memory),
            ("progress", state.progress, self._progress.rows),
            ("physics", {"rows": state.physics}, {"rows": self.sim.get_state()}),
        )
        for part, given, own in held:
            shapes = {name: array.shape for name, array in given.items()}
            needed = {name: array[rows].shape for name, array in own.items()}
            if shapes != needed:
                raise ValueError(
                    f"the state does not fit these worlds: its {part} is {shapes}, not"
                    f" {needed}; take it from an environment with the same id and"
                    " options, and give as many env_ids as it has rows"
                )

    def _check_actions(self, actions: Mapping[str, Array]) -> dict[str, np.ndarray]:
        if not isinstance(actions, Mapping):
            raise ValueError(
                f"actions are a {type(actions).__name__}; give a dictionary with an"
                f" array for each of {', '.join(self.agents)}"
            )
        if set(actions) != set(self.agents):
            raise ValueError(
                f"actions are for {', '.join(map(str, actions)) or 'nobody'};"
                f" give one for each of {', '.join(self.agents)}"
            )
        last = (
            ", and one for the grip" if self.task.gripping else " (gripping is False)"
        )
        checked = {}
        for agent in self.agents:
            action = np.asarray(actions[agent], dtype=np.float64)
            shape = (self.num_envs, *self.single_action_spaces[agent].shape)
            if action.shape != shape:
                raise ValueError(
                    f"the action of {agent} has shape {action.shape}, not {shape}: a"
                    f" number for each joint{last}"
                )
            finite = np.isfinite(action)
            if not finite.all():
                world, index = np.argwhere(~finite)[0]
                raise ValueError(
                    f"the action of {agent} in world {world} is {action[world, index]}"
                    f" at index {index}; every component must be finite"
                )
            checked[agent] = np.clip(action, -1.0, 1.0)
        return checked

    def _advance(self, controls: np.ndarray) -> np.ndarray:
        """Step the physics; return which worlds diverged. Those are put back."""
        diverged = np.zeros(self.num_envs, bool)
        for part in np.split(controls, self._shots, axis=1):
            try:
                self.sim.step(part)
            except SimulationDiverged as error:
                diverged[list(error.env_ids)] = True
            if self._watcher is not None:
                self._watcher()
        # A sum is finite only if all its terms are, and sums are cheap.
        total = self.sim.qpos.sum(axis=1) + self.sim.qvel.sum(axis=1)
        diverged |= ~np.isfinite(total)
        if diverged.any():
            self.sim.reset(diverged)
            self.sim.forward(diverged)
        return diverged

    def _reward(
        self, facts: Any, actions: dict[str, np.ndarray], diverged: np.ndarray
    ) -> tuple[dict[str, Terms], dict[str, Array]]:
        terms: dict[str, Terms] = {
            agent: {
                name: np.where(diverged, 0.0, term).astype(np.float32)
                for name, term in named.items()
            }
            for agent, named in self.task.reward(facts, actions).items()
        }
        return terms, {agent: sum(terms[agent].values()) for agent in self.agents}

    def _start_episodes(self, env_ids: np.ndarray) -> None:
        seeds, episodes = self._progress.start(env_ids)
        self.sim.reset(env_ids)
        for name, array in self.task.remember(len(env_ids)).items():
            self.task.memory[name][env_ids] = array
        self.task.reset(self.sim, env_ids, EpisodeRandom(seeds, episodes))
        self._controller.start(env_ids)
        self.sim.forward(env_ids)

    def _observe(self, facts: Any) -> Observations:
        return {
            agent: np.concatenate(list(blocks.values()), axis=1, dtype=np.float32)
            for agent, blocks in self.task.observe(facts).items()
        }


def make_vec(
    env_id: str,
    num_envs: int,
    *,
    seed: int = 0,
    num_threads: int = 0,
    robots: Sequence[str | Robot] | None = None,
    randomization: str | Randomization = "default",
    **settings: Any,
) -> VectorEnv:
    """Return many worlds of an environment.

    Args:
      env_id: an id from `list_envs` or a task's name from `list_tasks`.
      num_envs: how many worlds.
      seed: of the first episodes.
      num_threads: physics threads, 0 for one per CPU.
      robots: the arms in the order of the agents, by name or value; None for the
        environment's own.
      randomization: how starts are drawn, "default", "paper" or a value.
      **settings: other fields of the task's config.

    Raises:
      KeyError: if there is no such environment, robot, preset or setting.
      ValueError: if the task cannot be done with these robots.
    """
    task = make_task(env_id, robots, randomization, **settings)
    return VectorEnv(task, num_envs, seed=seed, num_threads=num_threads)


def _copied(observations: Observations) -> Observations:
    return {agent: array.copy() for agent, array in observations.items()}


def _taken(arrays: Mapping[str, Array], rows: Any) -> dict[str, Array]:
    return {name: array[rows].copy() for name, array in arrays.items()}
