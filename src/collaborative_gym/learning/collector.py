"""Collectors: worlds, and players that act in them and record rollouts."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from collaborative_gym.blocks import Layout, columns_of
from collaborative_gym.envs.vector_env import EnvState, Observations, VectorEnv
from collaborative_gym.evaluation.play import episode_row
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.casting import Casting
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.guests import NOBODY, Guests, Invitation
from collaborative_gym.learning.networks import LOG_STD_LIMITS, Actor
from collaborative_gym.learning.penalties import Penalties
from collaborative_gym.learning.team import Learner
from collaborative_gym.policies.network import OBSERVATION_LIMIT
from collaborative_gym.rng import training_seed

_BLOCK, _STARTS = 1 << 28, 1 << 10
"""Episodes between the first ones of two collectors, and collectors between two
rollouts. So a collector that starts anew plays episodes that nobody has played."""

_PARTS = "physics", "memory", "progress"  # of the state of worlds

ActorState = Mapping[str, Any]
"""The state of a player's `actor`, and the `mean` and `std` that normalize its
observations."""


@dataclass(frozen=True)
class Job:
    """The arguments that all collectors of a run share.

    Attributes:
      task: what to learn.
      learners: who learns what.
      layout: of the agents' observations and actions.
      seed: the run's seed.
      hyperparameters: how it learns.
      num_threads: physics threads of a collector, 0 for one per CPU.
      casting: who sits where.
    """

    task: Any
    learners: tuple[Learner, ...]
    layout: Layout
    seed: int
    hyperparameters: Hyperparameters
    num_threads: int = 0
    casting: Casting = field(default_factory=Casting)


@dataclass(frozen=True)
class Rollout:
    """Observations, actions and results of a learner's rows in one collector.

    Attributes:
      observations: (steps + 1, rows, k) float32, the last after the last step.
      actions: (steps, rows, a) float32.
      log_prob: of the actions, (steps, rows) float32.
      rewards: (steps, rows) float32.
      terminated: where an episode ended and nothing more could follow, (steps, rows).
      truncated: where only its time was up, (steps, rows).
      final_observations: (ends, k) float32 where time was up, as in `truncated`.
      advice: the expert's actions, as `actions`, and NaN where there is no advice; of
        width 0 without an expert.
    """

    observations: np.ndarray
    actions: np.ndarray
    log_prob: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    final_observations: np.ndarray
    advice: np.ndarray


@dataclass(frozen=True)
class Collected:
    """The rollouts of one collector.

    Attributes:
      steps: environment steps, over all its worlds.
      rollouts: by learner's name.
      episodes: a row for each episode that ended and was played in full.
      seated: who sat in each seat meanwhile, by name, for each row of `episodes`.
    """

    steps: int
    rollouts: dict[str, Rollout]
    episodes: list[dict[str, Any]]
    seated: list[tuple[str, ...]]


class Player:
    """Acts for a learner's rows, with noise that may last, and records the results.

    Args:
      learner: whose networks act.
      job: what all collectors share.
      worlds: ids of those in which it acts, by agent.

    Attributes:
      worlds: as given.
      noise: of the last actions, in standard deviations, (rows, a) float32.
    """

    noise: np.ndarray

    def __init__(self, learner: Learner, job: Job, worlds: Mapping[str, np.ndarray]):
        self.learner = learner
        self.worlds = worlds
        self._layout = job.layout
        counts = [len(worlds[agent]) for agent in learner.agents]
        self._ends = np.cumsum(counts)[:-1].tolist()
        rows = sum(counts) if learner.stacked else counts[0]
        self._shape = rows, learner.action_size(job.layout)
        self._actor = Actor(learner, job.layout, job.hyperparameters)
        stays = job.hyperparameters.grip_persistence * learner.is_grip(job.layout)
        self._stays = stays.astype(np.float32)
        self._fresh = np.sqrt(1.0 - stays**2).astype(np.float32)
        self._steps: list[tuple[np.ndarray, ...]] = []
        self._results: list[tuple[np.ndarray, ...]] = []
        self._finals: list[np.ndarray] = []

    def start(self, rng: np.random.Generator) -> None:
        """Draw the noise that the first actions follow."""
        self.noise = rng.standard_normal(self._shape, np.float32)

    def load(self, state: ActorState) -> None:
        """Act with these networks from now on."""
        self._actor.load_state_dict(state["actor"])
        self._mean, self._std = state["mean"], state["std"]
        log_std = self._actor.log_std.detach().clamp(*LOG_STD_LIMITS)
        self._spread = log_std.exp().numpy()
        self._density = -log_std.numpy() - 0.5 * math.log(2.0 * math.pi)

    def act(
        self,
        observations: Observations,
        rng: np.random.Generator,
        advice: Mapping[str, np.ndarray] | None = None,
    ) -> dict[str, np.ndarray]:
        """Return sampled actions by agent, for its worlds alone.

        Args:
          observations: of all worlds, by agent.
          rng: draws the noise.
          advice: the expert's actions in all worlds, by agent; NaN for none.
        """
        rows = self._seen(observations)
        with torch.no_grad():
            seen = (torch.from_numpy(rows) - self._mean) / self._std
            seen.clamp_(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)
            mean = self._actor(seen).numpy()
        fresh = rng.standard_normal(self._shape, np.float32)
        self.noise = self._stays * self.noise + self._fresh * fresh
        actions = mean + self._spread * self.noise
        log_prob = (self._density - 0.5 * self.noise**2).sum(axis=1)
        advised = actions[:, :0]
        if advice is not None:
            advised = self.learner.action_rows(self._own(advice)).astype(np.float32)
        self._steps.append((rows, actions, log_prob, advised))
        return self.learner.actions(actions, self._layout, self._ends)

    def record(
        self,
        rewards: Mapping[str, np.ndarray],
        final_observations: Observations,
        terminated: Mapping[str, np.ndarray],
        truncated: Mapping[str, np.ndarray],
    ) -> None:
        """Record the results of the last actions, as `VectorEnv.step` returns them.

        Args:
          rewards: (num_envs,) each.
          final_observations: those before the ended worlds were reset.
          terminated: (num_envs,) bool each, where nothing more was to come.
          truncated: (num_envs,) bool each, where time was up and values count on.
        """
        over = self._per_row(terminated)
        late = self._per_row(truncated) & ~over
        # Robots that share its reward, and that it does not command, are guests there.
        first = self.worlds[self.learner.agents[0]]
        own = {a: each[self.worlds.get(a, first)] for a, each in rewards.items()}
        earned = self.learner.rewards(own).astype(np.float32)
        self._results.append((earned, over, late))
        if late.any():
            self._finals.append(self._seen(final_observations)[late])

    def finish(self, observations: Observations) -> Rollout:
        """Return the rollout until these last observations, and begin a new one."""
        rows, *acted = zip(*self._steps, strict=True)
        actions, log_prob, advice = map(np.stack, acted)
        earned, over, late = map(np.stack, zip(*self._results, strict=True))
        last = self._seen(observations)
        seen = np.stack([*rows, last])
        finals = np.concatenate([last[:0], *self._finals])
        self._steps, self._results, self._finals = [], [], []
        return Rollout(seen, actions, log_prob, earned, over, late, finals, advice)

    def _seen(self, observations: Observations) -> np.ndarray:
        return self.learner.observations(self._own(observations))

    def _per_row(self, ends: Mapping[str, np.ndarray]) -> np.ndarray:
        own = list(self._own(ends).values())
        return np.concatenate(own) if self.learner.stacked else own[0]

    def _own(self, by_agent: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {agent: by_agent[agent][rows] for agent, rows in self.worlds.items()}


class Collector:
    """A share of a run's worlds, and a player for each learner.

    It can be lost without harm: networks come with each call, and a collector that is
    started anew begins episodes that nobody has played.

    Args:
      job: what all collectors share.
      index: which one it is, from 0.
      count: how many share the worlds.

    Attributes:
      count: how many states `state_dict` returns.
    """

    count = 1

    def __init__(self, job: Job, index: int = 0, count: int = 1):
        self._job, self._index = job, index
        share = len(range(index, job.hyperparameters.num_envs, count))
        seed, threads = training_seed(job.seed), job.num_threads
        strain = job.hyperparameters.contact_penalty > 0.0
        self.env = VectorEnv(
            job.task, share, seed=seed, num_threads=threads, strain=strain
        )
        if not job.hyperparameters.refined:
            self.env.sim.refinement = None
        self._players = [
            Player(learner, job, job.casting.worlds(learner, share))
            for learner in job.learners
        ]
        self._learns = {a: np.zeros(share, bool) for a in self.env.agents}
        for player in self._players:
            for agent, rows in player.worlds.items():
                self._learns[agent][rows] = True
        self._guests = Guests(self.env, job.casting)
        self._penalties = Penalties(self.env, job.hyperparameters)
        grips = self.env.scene.grips if self.env.task.gripping else ()
        self._gripping = sorted({grip.agent for grip in grips})
        self._observations: Observations | None = None

    def collect(
        self,
        actors: Mapping[str, ActorState],
        iteration: int,
        assistance: Assistance,
        invitation: Invitation = NOBODY,
    ) -> list[Collected]:
        """Return one rollout of these worlds, as a list of one.

        It depends on the worlds and the arguments, and on no generator's state.

        Args:
          actors: networks by learner's name.
          iteration: how many rollouts the run has had.
          assistance: lightens loose things, and raises demands.
          invitation: who may sit beside the learners.
        """
        rng = np.random.default_rng([self._job.seed, iteration, self._index])
        for player in self._players:
            player.load(actors[player.learner.name])
        self._guests.invite(invitation)
        observations = self._observations or self._start(iteration, rng)
        steps = self._job.hyperparameters.rollout_steps
        episodes: list[dict[str, Any]] = []
        seated: list[tuple[str, ...]] = []
        for _ in range(steps):
            actions = self._act(observations, rng)
            assistance.lift(self.env)
            observations, rewards, *ends, infos = self._step(
                actions, rng, assistance.demand
            )
            for player in self._players:
                player.record(rewards, infos["final_observation"], *ends)
            ended = np.flatnonzero(infos["ended"])
            for i in ended:
                # Of some worlds' first episodes the start was cut.
                if infos["step"][i] == infos["metrics"]["length"][i]:
                    episodes.append(episode_row(infos, int(i)))
                    seated.append(tuple(self._guests.names[i]))
            self._guests.draw(ended, rng)
        self._observations = observations
        rollouts = {p.learner.name: p.finish(observations) for p in self._players}
        return [Collected(steps * self.env.num_envs, rollouts, episodes, seated)]

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the worlds by the collector's number as text.

        It is empty before the first rollout.
        """
        if self._observations is None:
            return {str(self._index): {}}
        tensor: Any = torch.from_numpy
        worlds = self.env.get_state().map(tensor)
        own = {
            **{part: getattr(worlds, part) for part in _PARTS},
            "noise": {each.learner.name: tensor(each.noise) for each in self._players},
            "previous": {a: tensor(each) for a, each in self._previous.items()},
            **self._guests.state_dict(),
        }
        return {str(self._index): own}

    def load_state_dict(self, states: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        state = states[str(self._index)]
        if not state:
            self._observations = None
            return
        for player in self._players:
            player.noise = state["noise"][player.learner.name].numpy()
        self._previous = {a: each.numpy() for a, each in state["previous"].items()}
        self._guests.load_state_dict(state)
        parts = {part: state[part] for part in _PARTS}
        worlds = EnvState(**parts, identity=self.env.identity)
        self._observations = self.env.set_state(worlds.map(torch.Tensor.numpy))

    def close(self) -> None:
        """Free the worlds."""
        self.env.close()

    def _act(
        self, observations: Observations, rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        actions = {a: np.empty_like(still) for a, still in self.env.idle().items()}
        advice = None
        if self._job.hyperparameters.imitation:
            expert = self.env.expert().items()
            advice = {agent: np.array(each, np.float32) for agent, each in expert}
        self._guests.act(observations, actions, advice)
        for player in self._players:
            for agent, rows in player.act(observations, rng, advice).items():
                actions[agent][player.worlds[agent]] = rows
        return actions

    def _step(
        self, chosen: Mapping[str, np.ndarray], rng: np.random.Generator, demand: float
    ) -> tuple[Any, ...]:
        """Take a step, and charge the robots for it.

        Actions of learners may come late, and their grips fail; those of guests do not.
        """
        hyperparameters, count = self._job.hyperparameters, self.env.num_envs
        chosen = {agent: np.clip(each, -1.0, 1.0) for agent, each in chosen.items()}
        late = np.arange(count) < round(count * hyperparameters.delayed * demand)
        done = {
            a: np.where((late & self._learns[a])[:, None], self._previous[a], each)
            for a, each in chosen.items()
        }
        lost = hyperparameters.lost_grips * demand
        missed = hyperparameters.missed_grips * demand
        for agent in self._gripping if lost or missed else ():
            holds = self.env.scene.holds(self.env.sim, agent)
            fails = rng.random(count) < np.where(holds, lost, missed)
            grip = columns_of(self.env.action_parts[agent], "grip")
            done[agent][np.ix_(fails & self._learns[agent], grip)] = -1.0
        observations, rewards, *ends, infos = self.env.step(done)
        rewards = self._penalties.charge(rewards, infos["success"], demand)
        fresh, idle = infos["ended"][:, None], self.env.idle()
        self._previous = {a: np.where(fresh, idle[a], chosen[a]) for a in chosen}
        return observations, rewards, *ends, infos

    def _start(self, iteration: int, rng: np.random.Generator) -> Observations:
        for player in self._players:
            player.start(rng)
        self._guests.draw(np.arange(self.env.num_envs), rng)
        self._previous = self.env.idle()
        first = (iteration * _STARTS + self._index) * _BLOCK
        observations, _ = self.env.reset(
            seed=training_seed(self._job.seed),
            episodes=range(first, first + self.env.num_envs),
            stagger=True,
        )
        return observations


class Collectors:
    """Several collectors in this process that are called as one is.

    Args:
      jobs: of each; they share the worlds evenly.

    Attributes:
      count: how many there are.
    """

    def __init__(self, jobs: Sequence[Job]):
        self.count = len(jobs)
        self._all = [Collector(job, i, self.count) for i, job in enumerate(jobs)]

    def collect(self, *given: Any) -> list[Collected]:
        """Return one rollout of each, as `Collector.collect` does."""
        return [one for each in self._all for one in each.collect(*given)]

    def state_dict(self) -> dict[str, Any]:
        """Return the states of all, by their numbers as text."""
        return {n: own for each in self._all for n, own in each.state_dict().items()}

    def load_state_dict(self, states: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        for each in self._all:
            each.load_state_dict(states)

    def close(self) -> None:
        """Free the worlds."""
        for each in self._all:
            each.close()
