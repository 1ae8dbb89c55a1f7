"""What the training loop drives: collectors, and learners that learn from them."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import torch

from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.collector import Collected, Collectors
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.guests import NOBODY, Invitation
from collaborative_gym.learning.learner import SkrlLearner
from collaborative_gym.policies.network import NetworkPolicy, Weights

_CRITIC_ALONE = 10
"""Rollouts in which only critics learn, if policies know something already. The advice
of a critic that knows nothing would make them forget it."""


@dataclass(frozen=True)
class Iteration:
    """What one rollout and one update brought.

    Attributes:
      episodes: a row for each episode that ended and was played in full, as
        `evaluation.episode_row` gives it.
      updates: by learner, the numbers that `update.UPDATE` names.
      seated: who sat in each seat meanwhile, by name, for each row of `episodes`.
    """

    episodes: list[dict[str, Any]]
    updates: dict[str, dict[str, float]]
    seated: list[tuple[str, ...]] = field(default_factory=list)


class Backend:
    """Collects from worlds of one task, here or elsewhere, and learns in this process.

    It draws from torch's own generators, which the caller seeds.

    Args:
      learners: a learner for each group of robots that the mode has.
      collectors: who has the worlds.
      hyperparameters: how it is learned; None for the defaults.

    Attributes:
      steps: environment steps done so far, over all worlds.
    """

    def __init__(
        self,
        learners: Sequence[SkrlLearner],
        collectors: Collectors,
        hyperparameters: Hyperparameters | None = None,
    ):
        self.steps = 0
        self._iteration = 0
        self._learners = {each.learner.name: each for each in learners}
        self._first = self._members()
        self._collectors = collectors
        self._hyperparameters = hyperparameters or Hyperparameters()
        self._assistance = Assistance(self._hyperparameters.assistance)
        self._has_policy = False
        self._quietness = 0.0  # How far the noise has shrunk, from 0 to 1.

    def start(self, policy: NetworkPolicy) -> None:
        """Let all learners begin with what a policy has learned."""
        self._has_policy = True
        for learner in self._learners.values():
            learner.start(policy)
        self._first = self._members()

    def collect(self, invitation: Invitation = NOBODY) -> list[Collected]:
        """Return one rollout of every collector that is alive; the worlds go on."""
        actors = {name: each.acting() for name, each in self._learners.items()}
        given = actors, self._iteration, self._assistance, invitation
        return self._collectors.collect(*given)

    def advance(self, invitation: Invitation = NOBODY) -> Iteration:
        """Collect one rollout in every world, and learn from it.

        Args:
          invitation: who may sit beside those that learn.

        Raises:
          RuntimeError: if the task fails in a collector elsewhere, or none answers.
        """
        collected = self.collect(invitation)
        episodes = [row for each in collected for row in each.episodes]
        self._assistance.adapt(episodes)
        critic_alone = self._has_policy and self._iteration < _CRITIC_ALONE
        updates = {
            name: learner.learn(
                [each.rollouts[name] for each in collected], critic_alone=critic_alone
            )
            for name, learner in self._learners.items()
        }
        self._iteration += 1
        self.steps += sum(each.steps for each in collected)
        self._quieten()
        seated = [names for each in collected for names in each.seated]
        return Iteration(episodes, updates, seated)

    def weights(self, member: str = "") -> dict[str, Weights]:
        """Return what the networks of a member have learned so far, by name."""
        found: dict[str, Weights] = {}
        for learner in self._of(member):
            found |= learner.weights()
        return found

    def restart(self, member: str, like: str | None) -> None:
        """Let a member go on from all that another one has learned.

        Args:
          member: who.
          like: the other one; None to begin again as the member once began.
        """
        if like is None:
            states = [self._first[each.learner.name] for each in self._of(member)]
        else:
            states = [each.state_dict() for each in self._of(like)]
        for learner, state in zip(self._of(member), states, strict=True):
            learner.load_state_dict(deepcopy(state))

    def _quieten(self) -> None:
        """Let the noise shrink as far as it should have by now, and never grow."""
        numbers = self._hyperparameters
        due = self._assistance.demand
        if numbers.quiet_share:
            left = (numbers.total_steps - self.steps) / numbers.total_steps
            due = 1.0 - min(max(left / numbers.quiet_share, 0.0), 1.0)
        # A run that was made longer may have shrunk it further than is due.
        further = max(due - self._quietness, 0.0)
        self._quietness = max(due, self._quietness)
        for learner in self._learners.values():
            learner.quieten(numbers.final_noise**further)

    def _members(self) -> dict[str, Any]:
        """Return what the learners of members know, by name."""
        learners = self._learners.items()
        return {
            name: deepcopy(each.state_dict())
            for name, each in learners
            if each.learner.member
        }

    def _of(self, member: str) -> list[SkrlLearner]:
        learners = self._learners.values()
        return [each for each in learners if each.learner.member == member]

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on: tensors, numbers and texts, nested.

        On CPUs it goes on bit for bit, where no collector is lost.
        """
        learners = self._learners.items()
        cuda = torch.cuda.is_initialized()
        return {
            "steps": self.steps,
            "iteration": self._iteration,
            "assistance": self._assistance.state_dict(),
            "has_policy": self._has_policy,
            "quietness": self._quietness,
            "learners": {name: each.state_dict() for name, each in learners},
            "first": self._first,
            "generator": torch.get_rng_state(),
            "cuda_generators": torch.cuda.get_rng_state_all() if cuda else [],
            "worlds": self._collectors.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        With another number of collectors than it had, the worlds begin new episodes.
        """
        for name, learner in self._learners.items():
            learner.load_state_dict(state["learners"][name])
        self._first = state["first"]
        self._collectors.load_state_dict(state["worlds"])
        self.steps, self._iteration = state["steps"], state["iteration"]
        self._assistance.load_state_dict(state["assistance"])
        self._has_policy, self._quietness = state["has_policy"], state["quietness"]
        if self._has_policy:
            for learner in self._learners.values():
                learner.hold_statistics()
        torch.set_rng_state(state["generator"])
        if torch.cuda.is_initialized() and state["cuda_generators"]:
            torch.cuda.set_rng_state_all(state["cuda_generators"])

    def close(self) -> None:
        """Free what it holds. No other call is allowed afterwards."""
        self._collectors.close()
