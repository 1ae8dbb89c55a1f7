"""Training against a still arm, with a reward that aims at success alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from collaborative_gym.certificate.budget import Budget
from collaborative_gym.envs.state import EnvState
from collaborative_gym.learning.config import FAULTS, PENALTIES, Resources, recipe
from collaborative_gym.learning.folder import LAST
from collaborative_gym.math import array_namespace
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.tasks.task import Task


def aim_at_success(task: Task, starts: EnvState) -> Task:
    """Return a task whose episodes begin in states of its worlds, drawn from `starts`.

    Each agent earns 1 at every step at which the goal is met, less `Task.shortfall`.
    """
    kind: Any = type(task)

    class Rival(kind):
        def reset(self, sim, env_ids, *, rng):
            super().reset(sim, env_ids, rng=rng)
            which = rng.uniform(0, len(starts.physics)).astype(int)
            sim.set_state(starts.physics[which], env_ids)
            for name, rows in starts.memory.items():
                sim.memory[name][env_ids] = rows[which]

        def reward(self, facts, actions):
            shortfall = self.shortfall(facts)
            xp = array_namespace(shortfall)
            met = xp.where(self.success(facts), 1.0, 0.0)
            terms = {"success": met, "shortfall": -shortfall}
            return dict.fromkeys(self.agents, terms)

    Rival.__name__ = f"{kind.__name__}Rival"
    rival = Rival(tuple(task.robots.values()), task.config)
    rival.name = task.name
    return rival


def train_rival(
    task: Task,
    starts: EnvState,
    partner: tuple[str, str],
    *,
    budget: Budget,
    seed: int,
    folder: Path,
    num_threads: int,
    on_step: Callable[[float], object],
) -> NetworkPolicy:
    """Return a policy of the other arms, trained in episodes that begin in `starts`.

    A run that was killed goes on in its folder. `partner` is the still agent with its
    policy; `on_step` is called after each update with the steps of all worlds.

    Raises:
      ImportError: if the extra `train` is not installed.
    """
    from collaborative_gym.learning.train import train

    steps = budget.ppo_steps
    hyperparameters = replace(
        recipe(task.name),
        **dict.fromkeys((*PENALTIES, *FAULTS), 0.0),
        total_steps=steps,
        assistance=0.0,
        validation_interval=max(1, steps // 8),
    )
    is_begun = (folder / LAST).exists()
    result = train(
        aim_at_success(task, starts),
        seed=seed,
        output=None if is_begun else folder,
        resume=folder if is_begun else None,
        hyperparameters=hyperparameters,
        partner=dict([partner]),
        resources=Resources(num_threads=num_threads),
        on_row=lambda row, best: on_step(hyperparameters.steps_per_update),
    )
    return result.policy()
