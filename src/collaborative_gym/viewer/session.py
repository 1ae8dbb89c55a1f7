"""Worlds that a policy plays in real time, and the requests of their viewers."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco

from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_count
from collaborative_gym.plugins import location_of
from collaborative_gym.policies import Policy
from collaborative_gym.policies.match import name_players
from collaborative_gym.viewer.reading import Reading, read
from collaborative_gym.viewer.spring import Spring

SLOWEST, FASTEST = 0.1, 4.0
"""Bounds of the speed, in simulated seconds per second."""

MOST_WORLDS = 16
"""Most worlds that are shown beside one another."""

_PICTURES = 60  # most pictures per second, of the user's time
_LAG = 0.1  # longest delay that the world catches up, in s
_HOLD = 1.0  # time for which the end of an episode is shown, of the user's time in s

Load = Callable[[VectorEnv], tuple[VectorEnv, Policy, Mapping[str, Any]]]
"""From the present world to another, its policy, and the policy of each agent."""


@dataclass(frozen=True)
class Frame:
    """The worlds after a control step: their states, and the reading of each."""

    state: EnvState
    readings: tuple[Reading, ...]


class Session:
    """Worlds that a policy plays in real time until `end`.

    The worlds belong to the thread that calls `run`. Everything else may be used by any
    thread; requests take effect at the end of the present control step, which is then
    played without waiting. All worlds start together, and go on to their next episodes
    once all are at an end.

    Args:
      env: up to 16 worlds that do not reset themselves, so that ends are seen.
      policy: commands the robots. Where it fails, the session says so and pauses.
      warn: called with a sentence about what went wrong.
      policies: the policy of each agent, as `evaluate` takes it; None for `policy`.
      moves_on: whether the next start comes a second after a success of a single side.

    Attributes:
      env: the worlds.
      world: index of the one that is read.
      policies: the policy of each agent.
      is_paused: whether time stands still.
      moves_on: as given.
      was_pulled: whether anybody has pulled at anything.
      readings: of the present state, one for each world.
      film: the episodes so far, a frame for their start and for each control step.
        Later frames are of a future that may differ once time goes on again.
      perturb: a pull at a body of the world that is read, for `Spring.pull`, or None.
        Without any, an episode has the same bits as in every other environment.
    """

    def __init__(
        self,
        env: VectorEnv,
        policy: Policy,
        warn: Callable[[str], object],
        *,
        policies: Mapping[str, Any] | None = None,
        moves_on: bool = False,
    ):
        check_count("num_envs", env.num_envs, 1, MOST_WORLDS)
        self.env, self.world = env, 0
        self.policies = policies or dict.fromkeys(env.agents, policy)
        self.film: list[Frame] = []
        self.perturb: mujoco.MjvPerturb | None = None
        self._policy = policy
        self._warn = warn
        self._speed = 1.0
        self.is_paused = False
        self.moves_on = moves_on
        self.was_pulled = False
        self._has_ended = False
        self._requests: deque[Callable[[], None]] = deque()
        self._asked = threading.Event()
        self._spring = Spring(env)
        self._refresh: Callable[[], object] = lambda: None
        self._due = self._shown = self._ended = 0.0
        self._previous: list[Frame] = []
        self._players = name_players(self.policies, env.sides, env.task.colours)
        self._observations, infos = env.reset()
        self._roll_on(infos, ())

    @property
    def reading(self) -> Reading:
        """The reading of the world that is read."""
        return self.readings[self.world]

    def look(self, world: int) -> None:
        """Read another world; a pull at the one before ends."""
        if world != self.world:
            self.world = check_count("world", world, 0, self.env.num_envs - 1)
            self.perturb = None

    @property
    def speed(self) -> float:
        """Simulated seconds per second."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        if not SLOWEST <= speed <= FASTEST:
            raise ValueError(f"speed must be {SLOWEST} to {FASTEST}, got {speed}")
        self._speed = speed

    def pause(self) -> None:
        """Let time stand still."""
        self.is_paused = True
        self._asked.set()

    def play(self) -> None:
        """Let time go on."""
        self.is_paused = False
        self._asked.set()

    def step(self) -> None:
        """Do one control step and pause."""
        self._ask(self._step, pauses=True)

    def reset(self) -> None:
        """Start the same episode again, with the same bits."""
        self._ask(
            lambda: self._start(self.reading.seed, [r.episode for r in self.readings])
        )

    def next(self) -> None:
        """Start the seed's next episode."""
        self._ask(self._start)

    def seek(self, step: int) -> None:
        """Pause, and go to a control step of the film, or to its last."""
        self._ask(lambda: self._go_to(step), pauses=True)

    def back(self) -> None:
        """Pause, and go to the end of the episode before, if there is any."""
        self._ask(self._go_back, pauses=True)

    def change(self, load: Load, seed: int, episode: int) -> None:
        """Start an episode of other worlds, or with other policies.

        World i plays the episode that comes i after this one.

        `load` is called in the session's thread; where it fails, all stays as it is.
        """
        self._ask(lambda: self._change(load, seed, episode))

    def end(self) -> None:
        """Let `run` return."""
        self._has_ended = True
        self._asked.set()

    def run(self, refresh: Callable[[], object]) -> None:
        """Play until `end`.

        `refresh` is called in this thread, so that it may read the world, whenever
        there may be something new to draw, also while paused.
        """
        self._refresh = refresh
        self._due = time.perf_counter()
        self.env.watch(self._after_physics, self.env.substeps)
        try:
            while not self._has_ended:
                self._go_on()
        finally:
            self.env.watch(None)

    def _ask(self, request: Callable[[], None], *, pauses: bool = False) -> None:
        self.is_paused |= pauses
        self._requests.append(request)
        self._asked.set()

    def _go_on(self) -> None:
        """Grant a request, or else do the next control step, or else wait."""
        self._asked.clear()
        if self._requests:
            request = self._requests.popleft()
            if self._requests:
                self._asked.set()
            request()
        elif self.is_paused or time.perf_counter() < self._ended + _HOLD:
            self._draw()
            self._asked.wait(1 / _PICTURES)
            self._due = time.perf_counter()
        else:
            self._step()

    def _start(self, *episode: Any) -> None:
        self._begin(self.env.reset(*episode), self.readings)

    def _begin(self, begun: tuple[Any, Any], before: tuple[Reading, ...]) -> None:
        self._spring.forget()
        self._observations, infos = begun
        self._roll_on(infos, before)
        self._draw()

    def _change(self, load: Load, seed: int, episode: int) -> None:
        self._note(is_loading=True)
        try:
            env, policy, policies = load(self.env)
            begun = env.reset(seed, [episode + i for i in range(env.num_envs)])
        except Exception as error:
            self._stop("the choice", error)
            return
        if env is not self.env:
            self.env.close()
            env.watch(self._after_physics, env.substeps)
            self.env, self._spring, self.perturb = env, Spring(env), None
            self.film, self._previous = [], []
        self._policy, self.policies, self.is_paused = policy, policies, False
        self._players = name_players(policies, env.sides, env.task.colours)
        self._begin(begun, ())

    def _roll_on(self, infos: Mapping[str, Any], before: tuple[Reading, ...]) -> None:
        """Show a new state, and film it; a start begins a new film."""
        given = self.env, infos, self._players
        self.readings = tuple(
            replace(
                read(*given, before[i] if before else None, i),
                pull=self._spring.strength * (i == self.world),
            )
            for i in range(self.env.num_envs)
        )
        step = max(self.env.progress["step"])
        if step == 0:
            if len(self.film) > 1:
                self._previous = self.film
            self.film = []
        self.film = [*self.film[:step], Frame(self.env.get_state(), self.readings)]
        self._ended = time.perf_counter() if self._has_finished else 0.0

    @property
    def _has_finished(self) -> bool:
        return all(reading.has_ended for reading in self.readings)

    def _note(self, **changes: Any) -> None:
        self.readings = tuple(replace(each, **changes) for each in self.readings)
        self._draw()

    def _go_to(self, step: int) -> None:
        frame = self.film[min(step, len(self.film) - 1)]
        self._spring.forget()
        self._observations = self.env.set_state(frame.state)
        # A new object, so that a slider that was drawn past the end is set back even
        # where the world was at the end already.
        self.readings, self._ended = frame.readings, 0.0
        self._note()

    def _go_back(self) -> None:
        if self._previous:
            self.film, self._previous = self._previous, []
            self._go_to(len(self.film))

    def _step(self) -> None:
        if self._has_finished or self._is_done():
            self._start()
            return
        try:
            actions = self._policy(self._observations)
            self.was_pulled |= self.perturb is not None
            self._spring.pull(self.perturb, self.world)
            self._observations, _, _, _, infos = self.env.step(actions)
        except Exception as error:
            if self._has_ended:  # The drawing failed, not the policy.
                raise
            self._stop("the policy", error)
            return
        self._roll_on(infos, self.readings)
        if self.is_paused:
            self._draw()

    def _is_done(self) -> bool:
        """Return whether the next start is due, a second after the goal was met.

        With several worlds that is so once each has met it, or is at its end.
        """
        if not self.moves_on or self.is_paused or len(self.env.sides) > 1:
            return False
        step = int(max(self.env.progress["step"]))
        until = max(0, step + 1 - round(_HOLD / self.env.control_dt))
        return all(
            own[-1].has_ended or any(any(each.success.values()) for each in own[:until])
            for own in zip(*(frame.readings for frame in self.film), strict=True)
        )

    def _stop(self, what: str, error: Exception) -> None:
        where = location_of(error)
        trouble = f"{type(error).__name__}: {error}{f' ({where})' if where else ''}"
        self._warn(f"{what} failed: {trouble}")
        self.is_paused = True
        self._note(trouble=trouble, is_loading=False)

    def _after_physics(self) -> None:
        """Draw, wait until it is time for the next physics step, and pull in it."""
        now = time.perf_counter()
        length = self.env.control_dt / self.env.substeps / self._speed
        self._due = max(self._due + length, now - _LAG)
        if now - self._shown >= 1 / _PICTURES:
            self._draw()
        if not self._has_ended:
            self._asked.wait(max(0.0, self._due - time.perf_counter()))
        self._spring.pull(self.perturb, self.world)

    def _draw(self) -> None:
        self._shown = time.perf_counter()
        try:
            self._refresh()
        except BaseException:
            self._has_ended = True
            raise
