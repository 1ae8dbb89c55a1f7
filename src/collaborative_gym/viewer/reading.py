"""What a viewer's panel says about the present state."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies.match import result
from collaborative_gym.tasks.task import named_facts
from collaborative_gym.timing import CONTROL_DT


@dataclass(frozen=True)
class Reading:
    """What a viewer says about one world.

    Attributes:
      episode: index of the episode within its seed.
      seed: its seed.
      time: since its start, in s.
      players: who plays each side, by its name.
      scores: the points of each side, by its name; of a single one there are none.
      success: whether each side's goal is met now.
      returns: what each side has earned since the start.
      rewards: the last control step's named terms, by agent; at a start 0.
      measures: distances and whatever else the task measures, by name.
      units: of these measures that have one, as far as the task names them.
      previous: how the last episode ended that is over, a sentence, or empty.
      has_ended: whether this one is over.
      trouble: why it cannot go on, a sentence; empty where it can.
      is_loading: whether another world is being made in its place.
    """

    episode: int
    seed: int
    time: float
    players: Mapping[str, str]
    scores: Mapping[str, float]
    success: Mapping[str, bool]
    returns: Mapping[str, float]
    rewards: Mapping[str, Mapping[str, float]]
    measures: Mapping[str, float | bool]
    units: Mapping[str, str]
    previous: str
    has_ended: bool
    trouble: str = ""
    is_loading: bool = False

    @property
    def rows(self) -> list[tuple[str, str]]:
        """The reading as rows of name and value; the heading of a part has no value."""
        rows = [("stopped", ""), (f"  {self.trouble}", "")] if self.trouble else []
        # There are the same rows at any time, so that none jumps.
        rows.append((f"episode of seed {self.seed}", str(self.episode)))
        rows.append(("time", f"{self.time:.1f} s"))
        indent = "  " * (len(self.players) > 1)
        for side, player in self.players.items():
            rows.append((side if indent else "policy", player))
            if side in self.scores:
                rows.append((f"{indent}score", f"{self.scores[side]:g}"))
            rows.append((f"{indent}success", _word(self.success[side])))
            rows.append((f"{indent}return", f"{self.returns[side]:z.1f}"))
        for agent, terms in self.rewards.items():
            rows.append((f"reward of {agent}", f"{sum(terms.values()):z.3f}"))
            rows += [(f"  {name}", _word(term)) for name, term in terms.items()]
        if self.measures:
            rows.append(("measured", ""))
            rows += [
                (f"  {name}", f"{_word(value)} {self.units.get(name, '')}".rstrip())
                for name, value in self.measures.items()
            ]
        return [*rows, ("ended last", ""), (f"  {self.previous or 'none'}", "")]


def read(
    env: VectorEnv,
    infos: Mapping[str, Any],
    before: Reading | None,
    players: Mapping[str, str],
) -> Reading:
    """Return the reading of a batch of one world.

    Args:
      env: the world.
      infos: of its last step or reset.
      before: the reading of the step before, or None.
      players: who plays each side, by its name.
    """
    place = env.progress
    has_begun = place["step"][0] > 0  # At a start no success counts.
    rewards = {
        agent: {name: float(term[0]) for name, term in named.items()}
        for agent, named in infos["reward_terms"].items()
    }
    earned = before.returns if before is not None and place["step"][0] > 1 else {}
    success = _by_side(env.sides, infos["success"])
    points = infos["metrics"].get("score", {})
    measures = list(_measures(env.facts, env.task.units))
    scores = {side: float(own[0]) for side, own in points.items()}
    previous = "" if before is None else before.previous
    return Reading(
        episode=int(place["episode"][0]),
        seed=int(place["seed"][0]),
        time=float(place["step"][0]) * env.control_dt,
        players=players,
        scores=scores,
        success={side: bool(has_begun and is_met[0]) for side, is_met in success},
        returns={
            side: earned.get(side, 0.0)
            + sum(sum(rewards.get(agent, {}).values()) for agent in agents)
            for side, agents in env.sides.items()
        },
        rewards=rewards,
        measures={name: value for name, _, value in measures},
        units={name: unit for name, unit, _ in measures if unit},
        previous=_sum_up(env, infos, players) if infos["ended"][0] else previous,
        has_ended=bool(infos["ended"][0]),
    )


def _by_side(sides: Iterable[str], told: Any) -> list[tuple[str, Any]]:
    """Return a value for each side; a single side has no name in it."""
    return [(side, told[side] if isinstance(told, Mapping) else told) for side in sides]


def _measures(
    facts: Any, units: Mapping[str, str]
) -> Iterator[tuple[str, str, float | bool]]:
    """Yield name, unit and value of the facts that are one number or truth a world."""
    for fact, value in named_facts(facts).items():
        parts = value.items() if isinstance(value, Mapping) else [("", value)]
        for agent, part in parts:
            if getattr(part, "ndim", None) == 1:
                name = f"{fact.replace('_', ' ')} {agent}".rstrip()
                is_truth = np.asarray(part).dtype == bool
                value = bool(part[0]) if is_truth else float(part[0])
                yield name, units.get(fact, ""), value


def _word(value: float | bool) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:z.3f}"


def _sum_up(
    env: VectorEnv, infos: Mapping[str, Any], players: Mapping[str, str]
) -> str:
    """Return how an episode ended, by the infos of its last step."""
    metrics = infos["metrics"]
    times = _by_side(players, metrics["time_to_success"])
    returns = _by_side(players, metrics["return"])
    results = [result(players, infos)] if len(players) > 1 else []
    has_diverged = infos["diverged"][0]
    if infos["step"][0] < env.task.config.max_episode_steps and not has_diverged:
        results.append(f"over after {infos['step'][0] * CONTROL_DT:.1f} s")
    for (side, time), (_, earned) in zip(times, returns, strict=True):
        if has_diverged:
            told = "the physics diverged"
        elif np.isnan(time[0]):
            told = "no success"
        else:
            told = f"success after {time[0]:.1f} s"
        name = f"{side} " if len(times) > 1 else ""
        results.append(f"{name}{told}, return {earned[0]:z.1f}")
    return f"episode {metrics['episode'][0]}: {'; '.join(results)}"
