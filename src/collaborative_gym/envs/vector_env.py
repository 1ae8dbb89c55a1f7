"""The one environment loop: many worlds of one task, stepped together."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from collaborative_gym import errors
from collaborative_gym.control import Commands
from collaborative_gym.envs.arguments import check_env_ids, check_episodes
from collaborative_gym.envs.definition import Trial
from collaborative_gym.envs.disturbances import Disturbances
from collaborative_gym.envs.progress import Progress, copied, where
from collaborative_gym.envs.state import EnvState, check_state, made_anew, put, take
from collaborative_gym.envs.strain import Strain
from collaborative_gym.envs.turns import Turns
from collaborative_gym.envs.world import Starts, World
from collaborative_gym.math import Array
from collaborative_gym.pictures.rendering import Camera
from collaborative_gym.rng import EpisodeDraws, Stream, check_seed
from collaborative_gym.sim.sim import EnvIds
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.task import STYLE_DRAWS, Task, Terms
from collaborative_gym.timing import CONTROL_DT, SUBSTEPS

Observations = ByAgent = dict[str, Array]


class VectorEnv:
    """Worlds of one task, with dictionaries by agent of (num_envs, ...) arrays.

    An episode lasts `max_episode_steps` control steps, unless the task says earlier
    that it is `over`. Then it is terminated. If its time is up or its physics diverged,
    it is truncated. A world whose episode ends starts its next one in the same step.
    World i plays the episodes i, i + num_envs, i + 2 num_envs and so on of the seed.
    `reset` returns observations and infos; `step` returns observations, rewards,
    terminated, truncated and infos. The caller owns these arrays.

    `infos` always has the same entries, arrays by world: `episode` (index), `step`
    (control steps done), `success`, `diverged`, `ended`, `resting`, `reward_terms` by
    agent and term, `final_observation` by agent (the last one of an episode that
    `ended`), and `metrics`. The metrics describe the episode so far, or all of it if it
    `ended`: `return` (summed over agents), `returns` by agent, `completion`,
    `performance`, `at_goal` (share of its steps at which the goal was met), `length`,
    `time_to_success` (s, NaN if never), `reward_terms` (sums), `episode` and `seed`. If
    asked for, they also have the `strain`, as docs/concepts.md describes it. Many tasks
    have measures of how their arms work together, the `coordination`. Performance is a
    share of the steps that were played, from the first success on or from the start,
    even if the end is early.

    If a task has several sides, `success` and the metrics `return`, `completion`,
    `performance`, `at_goal` and `time_to_success` are dictionaries by side; nothing is
    summed over opponents. Such a task has one more metric by side, `score`, the sum of
    what `Task.score` gave. It is 0 for all sides if the episode diverged. The side with
    the higher score at the end has won the episode; equal scores are a draw.

    A world that does not reset itself rests after its episode's end, until `reset`: it
    does not move, earns nothing and keeps its infos. The mask `resting` marks it.

    Only one thread at a time may use an environment, and only in the process that made
    it. A call that fails leaves every world as it was. Copies and pickles continue from
    the present state, if the task's class can make the task again from arms and config.

    Args:
      task: what to do, from `cg.task`.
      num_envs: how many worlds.
      seed: the first episodes' seed.
      num_threads: physics threads, 0 for one per CPU.
      auto_reset: whether a world starts its next episode by itself.
      strain: whether to measure the strain too, which takes time and changes no bit.

    Attributes:
      world: the compiled world, which other environments may share.
      task: the task of these worlds.
      num_envs: how many worlds.
      agents: the agents' names.
      sides: the agents of each side, by its name: "side_1" and so on.
      single_observation_spaces: of one world, by agent.
      single_action_spaces: of one world, by agent.
      observation_blocks: a `Block` for each part of an observation, by agent and name.
      action_parts: the same for an action: `moves`, and `grip` if the task grips.
      reward_terms: names of a reward's parts, by agent.
      model: MuJoCo's model of the world.
      scene: handles into it.
      sim: the physics.
      action_mode: what actions mean here.
      substeps: physics steps in a control step.
      control_dt: time of a control step, in s.
      strain: what measures the strain, None unless it was asked for.
    """

    _facts: Any = None
    _camera: Camera | None = None
    _watcher: Callable[[], object] | None = None
    _shots, _is_started, _is_closed = 1, False, False

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        seed: int = 0,
        num_threads: int = 0,
        auto_reset: bool = True,
        strain: bool = False,
    ):
        num_envs = errors.check_count("num_envs", num_envs, 1, errors.MOST_ENVS)
        num_threads = errors.check_count(
            "num_threads", num_threads, 0, errors.MOST_THREADS
        )
        seed, auto_reset = check_seed(seed), errors.check_flag("auto_reset", auto_reset)
        strain = errors.check_flag("strain", strain)
        self._options = dict(num_envs=num_envs, seed=seed, num_threads=num_threads)
        self._options |= dict(auto_reset=auto_reset, strain=strain)
        self.world = world = World.of(task, strain=strain)
        self.task, self.scene, self.model = world.task, world.scene, world.model
        self.num_envs, self.agents = num_envs, task.agents
        self.substeps, self.control_dt = SUBSTEPS, CONTROL_DT
        sim, self.action_mode = world.batch(num_envs, num_threads)
        self.sim, mode = sim, self.action_mode
        self.strain = Strain(self.scene, sim, mode) if strain else None
        defined = world.definition
        self.observation_blocks = defined.layout.observation
        self.action_parts = defined.layout.action
        self.single_observation_spaces = defined.observation_spaces
        self.single_action_spaces = defined.action_spaces
        self.reward_terms, self.sides = defined.reward_terms, defined.sides
        self._starts = Starts(world, num_envs, num_threads)
        self._turns = Turns()
        self._style_draws = EpisodeDraws(num_envs, (STYLE_DRAWS,), Stream.STYLE)
        self._auto_reset = auto_reset
        self._progress = Progress(world, sim.xp, num_envs=num_envs, seed=seed)
        parts = self.task, self.scene, sim, mode, self._progress
        self._disturbances = Disturbances(*parts)

    def __reduce__(self) -> tuple[Any, ...]:
        state = self.get_state() if self._is_started else None
        task = self.task
        made = type(task), tuple(task.robots.values()), task.config, task.name
        return made_anew, (type(self), made, self._options, state)

    @property
    def facts(self) -> Any:
        """What the task measures of the present state."""
        if self._facts is None:
            self._facts = self.task.measure(self.sim)
        return self._facts

    @property
    def identity(self) -> Identity:
        """What the environment is: its task, arms, settings and versions."""
        return self.world.identity

    def reset(
        self,
        seed: int | None = None,
        episodes: Sequence[int] | None = None,
        *,
        stagger: bool = False,
        env_ids: EnvIds = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Start an episode in every world, or in some.

        Args:
          seed: starts the episodes 0, 1, 2 ... of this seed; None starts each world's
            next episode, at first those of the constructor's seed.
          episodes: with a seed, the episode index of each of these worlds instead.
          stagger: spread the worlds over the episode's length, as if each had started
            at another time, so that in training they do not all end together. This
            makes the first episodes shorter.
          env_ids: the worlds; None for all. No bit of the others changes.

        Returns:
          Observations of all worlds by agent, (num_envs, k) float32, and infos.

        Raises:
          IndexError: if there are no such worlds.
          TypeError: if the seed is not an integer.
          ValueError: if the seed is negative or the episodes do not fit.
          RuntimeError: for some of the worlds before the first `reset` of all.
        """
        with self._turns.take(self._keep):
            self._check_open()
            if env_ids is not None and not self._is_started:
                raise RuntimeError("call reset() of all worlds before that of some")
            rows = check_env_ids(env_ids, self.num_envs)
            if seed is None and episodes is not None:
                raise ValueError("episodes are counted within a seed; pass seed too")
            first = rows if episodes is None else check_episodes(episodes, len(rows))
            stagger = errors.check_flag("stagger", stagger)
            new_seed = None if seed is None else check_seed(seed)
            if new_seed is not None:
                self._progress.begin(new_seed, first, rows)
            rows = np.sort(rows)
            self._start_episodes(rows)
            if stagger:
                self._progress.stagger(rows)
            observations = self._seen()
            success, terms = self._progress.begun(self.facts)
            resting = self._progress.has_ended
            last = copied(observations, self.sim.xp)
            infos = self._progress.infos(success, terms, resting, last)
            self._is_started, self._observations = True, observations
            return copied(observations, self.sim.xp), infos

    def step(
        self, actions: Mapping[str, Array]
    ) -> tuple[Observations, ByAgent, ByAgent, ByAgent, dict[str, Any]]:
        """Do one control step in every world whose episode has not ended.

        Args:
          actions: by agent, (num_envs, k), each component in [-1, 1]; a number beyond
            counts as the nearest bound.

        Returns:
          Observations, rewards, terminated and truncated by agent, and infos.

        Raises:
          ValueError: if the actions are not what the spaces say, or what the task's
            methods return is not finite; the worlds are then as before.
          RuntimeError: before the first `reset`, after `close`, and where the episodes
            of all worlds have ended and none resets itself.
        """
        with self._turns.take(self._keep):
            self._check_started("step")
            progress, xp = self._progress, self.sim.xp
            resting = progress.has_ended
            if xp.all(resting):
                raise RuntimeError("the episode has ended; call reset() before step()")
            actions = self.action_mode.check(actions)
            if self._disturbances.changes_actions:
                actions = self._disturbances.deliver(actions, resting)
            commands, diverged = self._advance(actions, resting)
            facts = self._facts = self.task.measure(self.sim)
            lost = resting | diverged
            try:
                terms, rewards = self._reward(facts, commands, lost)
                success = progress.count(facts, terms, diverged, resting)
                last = self._seen()
            except Exception:  # Our own words, where a method returns what it may not.
                Trial(self.task, self.sim).check(facts, commands)
                raise
            if xp.any(lost):
                for agent in self.agents:
                    last[agent][lost] = self._observations[agent][lost]
            infos = progress.infos(success, terms, resting, last)
            terminated, truncated = progress.endings(self.agents)
            observations, has_ended = last, infos["ended"] & ~resting
            if self._auto_reset and xp.any(has_ended):
                begun = where(has_ended, xp)
                self._start_episodes(begun)
                observations = self._begun(last, begun)
            self._observations = copied(observations, xp)
            return copied(observations, xp), rewards, terminated, truncated, infos

    def expert(self, style: str = "", *, pace: float = 1.0) -> dict[str, Array]:
        """Return the scripted expert's actions for the present state.

        Args:
          style: one of the task's `styles`, or its usual way.
          pace: what to multiply the actions' moves by.
        """
        with self._turns.take():
            self._check_started("expert")
            at = self.sim, self.facts
            if style:
                draws = self._style_draws.now(self._progress.rows)
                motions = self.task.styled(*at, style=style, draws=draws)
            else:
                motions = self.task.expert(*at)
            with errors.naming(f"{type(self.task).__name__}.expert()"):
                return self.action_mode.check(self.action_mode.encode(motions, pace))

    def idle(
        self, grips: Mapping[str, Array | bool] | bool = False
    ) -> dict[str, np.ndarray]:
        """Return actions of robots that hold still.

        `grips` says whether they grip; by agent, it may be a mask (num_envs,).
        """
        return self.action_mode.idle(self.num_envs, grips)

    def get_state(self, env_ids: EnvIds = None) -> EnvState:
        """Return a copy of these worlds' episodes, one row each; None for all.

        Raises:
          IndexError: if there are no such worlds.
        """
        with self._turns.take():
            self._check_started("get_state")
            rows = check_env_ids(env_ids, self.num_envs)
            return take(self.sim, self._progress.rows, rows, self.identity)

    def set_state(
        self, state: EnvState, env_ids: EnvIds = None, *, from_another: bool = False
    ) -> Observations:
        """Continue saved episodes in these worlds; return all worlds' observations.

        Args:
          state: from `get_state`.
          env_ids: as many worlds as the state has rows; None for all.
          from_another: also take the state of another environment, such as one with
            other settings or another version of the physics, if it fits.

        Raises:
          IndexError: if there are no such worlds.
          TypeError: if it is not a state.
          ValueError: if the state is of another environment or does not fit.
          RuntimeError: for some of the worlds before the first `reset`.
        """
        with self._turns.take(self._keep):
            self._check_open()
            if env_ids is not None:
                self._check_started("set_state")
            rows = check_env_ids(env_ids, self.num_envs)
            parts = self.sim, self._progress.rows
            own = take(*parts, rows, self.identity)
            steps = self.task.config.max_episode_steps
            check_state(state, own, steps, from_another=from_another)
            put(state, *parts, rows)
            self._disturbances.draw(np.sort(rows))
            self._facts = None
            self._observations = self._seen()
            self._is_started = True
            return copied(self._observations, self.sim.xp)

    @property
    def progress(self) -> dict[str, Array]:
        """The `seed` and index (`episode`) of each world's episode, and its `step`."""
        return self._progress.where()

    def watch(self, watcher: Callable[[], object] | None, shots: int = 1) -> None:
        """Call `watcher` during every control step, to film or show the motion.

        The physics is the same to the bit with and without. If it raises, the worlds
        are as they were before the step.

        Args:
          watcher: what to call, or None to stop. It may write only `xfrc_applied`.
          shots: how often per control step, evenly spread and the last at its end;
            must divide `substeps`.
        """
        shots = errors.check_count("shots", shots)
        if shots < 1 or self.substeps % shots:
            raise ValueError(f"shots must divide {self.substeps}, got {shots}")
        errors.check_callback("watcher", watcher)
        self._watcher, self._shots = watcher, 1 if watcher is None else shots

    def render(
        self, env_id: int = 0, *, width: int = 1280, height: int = 720
    ) -> np.ndarray:
        """Return a picture of one world, (height, width, 3) uint8.

        Raises:
          IndexError: if there is no such world.
          ValueError: if the picture is too large.
          RuntimeError: if no off-screen renderer can start; says what to install.
        """
        with self._turns.take():
            self._check_started("render")
            size = (
                errors.check_count("width", width),
                errors.check_count("height", height),
            )
            last = self.num_envs - 1
            if not 0 <= errors.check_count("env_id", env_id, -(2**63)) <= last:
                raise IndexError(f"no world {env_id}; worlds are 0 to {last}")
            if self._camera is None or self._camera.size != size:
                self._close_camera()
                self._camera = Camera(self.world.drawn_model, *size)
            sim = self.sim
            return self._camera.picture(sim.qpos[env_id], sim.mocap_pos[env_id])

    def close(self) -> None:
        """Free the renderer. No other call is allowed afterwards."""
        with self._turns.take():
            self._close_camera()
            self._is_closed = True

    def _close_camera(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _keep(self) -> Callable[[], None]:
        """Return what puts the worlds back to where they are now."""
        # Arrays of memory and progress are not written to, but replaced.
        physics = self.sim.get_state()
        memory, rows = dict(self.sim.memory), dict(self._progress.rows)
        facts = self._facts

        def put_back() -> None:
            self.sim.memory, self._progress.rows = memory, rows
            self._facts = facts
            self._disturbances.draw(np.arange(self.num_envs))
            self.sim.set_state(physics)

        return put_back

    def _check_open(self) -> None:
        if self._is_closed:
            raise RuntimeError("this environment is closed; make another")

    def _check_started(self, name: str) -> None:
        if self._is_closed or not self._is_started:
            self._check_open()
            raise RuntimeError(f"call reset() before {name}()")

    def _advance(self, actions: ByAgent, resting: Array) -> tuple[Commands, Array]:
        """Step the physics; return the commands, and which worlds diverged."""
        sim, idle, moving = self.sim, where(resting, self.sim.xp), None
        if len(idle):
            kept, moving = sim.get_state(idle), where(~resting, sim.xp)
        memory = dict(sim.memory)
        commands = self.action_mode.commands(actions)
        controls = self.action_mode.prepare(commands)
        self.task.disturb(sim, self._progress.next_step)
        diverged = sim.xp.zeros(self.num_envs, dtype=sim.xp.bool)
        length, strain = self.substeps // self._shots, self.strain
        for start in range(0, self.substeps, length):
            try:
                records = strain.records(length) if strain else None
                now = controls[:, start : start + length]
                sim.step(now, records, self.action_mode.tears, moving)
            except errors.SimulationDiverged as error:
                diverged[list(error.env_ids)] = True
            if strain:
                strain.count(self._progress.rows, ~(resting | diverged))
            if self._watcher is not None:
                self._watcher()
        if len(idle):
            sim.set_state(kept, idle)
            for name, array in copied(sim.memory, sim.xp).items():
                array[idle] = memory[name][idle]
                sim.memory[name] = array
        # A sum is finite only if all its terms are, and sums are cheap.
        total = sim.xp.sum(sim.qpos, axis=1) + sim.xp.sum(sim.qvel, axis=1)
        diverged = (diverged | ~sim.xp.isfinite(total)) & ~resting
        if strain:
            strain.count_clearance(self._progress.rows, ~(resting | diverged))
        if sim.xp.any(diverged):
            sim.reset(diverged)
            sim.forward(diverged)
        return commands, diverged

    def _reward(
        self, facts: Any, commands: Commands, lost: Array
    ) -> tuple[dict[str, Terms], dict[str, Any]]:
        xp = self.sim.xp
        terms: dict[str, Terms] = {}
        rewards: dict[str, Any] = {}
        for agent, own in self.task.reward(facts, commands).items():
            names = self.reward_terms[agent]
            if own.keys() ^ names:
                raise ValueError(
                    f"{type(self.task).__name__}.reward() has the terms {tuple(own)}"
                    f" for {agent}, but {names} at first; return every term at every"
                    " step, zero where it does not count"
                )
            if xp.any(lost):
                own = {name: xp.where(lost, 0.0, term) for name, term in own.items()}
            terms[agent] = {n: xp.astype(term, xp.float32) for n, term in own.items()}
            total: Any = sum(terms[agent].values())
            rewards[agent] = total
            if total.shape != lost.shape or not xp.all(xp.isfinite(total)):
                raise ValueError(f"the reward of {agent} is no number in each world")
        return terms, rewards

    def _begun(self, last: Observations, env_ids: np.ndarray) -> Observations:
        if self._disturbances.has_noise:
            return self._seen()
        observations = copied(last, self.sim.xp)
        for agent, rows in self._starts.observations.items():
            observations[agent][env_ids] = rows[env_ids]
        return observations

    def _start_episodes(self, env_ids: np.ndarray) -> None:
        if not len(env_ids):
            return
        self._progress.start(env_ids)
        self._starts.prepare(env_ids, self._progress.rows)
        waiting = self._starts.sim
        memory = self.sim.memory = copied(self.sim.memory, self.sim.xp)
        for name, array in waiting.memory.items():
            memory[name][env_ids] = array[env_ids]
        self._disturbances.start(env_ids)
        self.sim.set_state(waiting.get_state(env_ids), env_ids)
        self._facts = None

    def _seen(self) -> Observations:
        world, facts, felt = self.world, self.facts, {}
        if world.feels:
            felt = self._disturbances.feel(world.feel(self.sim))
        if self._disturbances.has_noise:
            facts = self._disturbances.see(facts)
        return world.flat(facts, felt, self.sim.xp)
