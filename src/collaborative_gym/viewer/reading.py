"""What a viewer's panel says of the present state."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv


@dataclass(frozen=True)
class Reading:
    """What is to be said of one world.

    Attributes:
      episode: index of the episode within its seed.
      seed: its seed.
      time: since its start, in s.
      success: whether the goal is met now.
      rewards: the last control step's named terms, by agent; at a start there are none.
      measures: distances and whatever else the task measures, by name.
      previous: how the episode before ended, a sentence; empty at the first.
    """

    episode: int
    seed: int
    time: float
    success: bool
    rewards: Mapping[str, Mapping[str, float]]
    measures: Mapping[str, float | bool]
    previous: str

    @property
    def rows(self) -> list[tuple[str, str]]:
        """The reading as rows of name and value; the heading of a part has no value."""
        rows = [
            (f"episode of seed {self.seed}", str(self.episode)),
            ("time", f"{self.time:.1f} s"),
            ("success", _word(self.success)),
        ]
        for agent, terms in self.rewards.items():
            rows.append((f"reward of {agent}", f"{sum(terms.values()):.3f}"))
            rows += [(f"  {name}", _word(term)) for name, term in terms.items()]
        if self.measures:
            rows.append(("measured", ""))
            rows += [
                (f"  {name}", _word(value)) for name, value in self.measures.items()
            ]
        if self.previous:
            rows += [("previous", ""), (f"  {self.previous}", "")]
        return rows


def read(env: VectorEnv, infos: Mapping[str, Any], previous: str) -> Reading:
    """Return what there is to say of a batch of one world."""
    place = env.progress
    has_begun = place["step"][0] > 0
    terms = infos.get("reward_terms", {}) if has_begun else {}
    return Reading(
        episode=int(place["episode"][0]),
        seed=int(place["seed"][0]),
        time=float(place["step"][0]) * env.control_dt,
        success=bool(has_begun and infos["success"][0]),
        rewards={
            agent: {name: float(term[0]) for name, term in named.items()}
            for agent, named in terms.items()
        },
        measures=dict(_measures(env.facts)),
        previous=previous,
    )


def _measures(facts: Any) -> Iterator[tuple[str, float | bool]]:
    """Yield the facts that are a single number or truth of each world, by name."""
    named = facts if isinstance(facts, Mapping) else getattr(facts, "__dict__", {})
    for fact, value in named.items():
        parts = value.items() if isinstance(value, Mapping) else [("", value)]
        for agent, part in parts:
            if getattr(part, "ndim", None) == 1:
                name = f"{fact.replace('_', ' ')} {agent}".rstrip()
                is_truth = np.asarray(part).dtype == bool
                yield name, bool(part[0]) if is_truth else float(part[0])


def _word(value: float | bool) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3f}"


def sum_up(infos: Mapping[str, Any]) -> str:
    """Return how the episode ended whose last step gave these infos."""
    metrics = infos["metrics"]
    time_to_success = metrics["time_to_success"][0]
    if infos["diverged"][0]:
        result = "the physics diverged"
    elif np.isnan(time_to_success):
        result = "no success"
    else:
        result = f"success after {time_to_success:.1f} s"
    episode, earned = metrics["episode"][0], metrics["return"][0]
    return f"episode {episode}: {result}, return {earned:.1f}"
