"""The texts and numbers of a viewer's panel."""

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies.match import result
from collaborative_gym.tasks.task import Task, named_facts
from collaborative_gym.timing import CONTROL_DT


@dataclass(frozen=True)
class Reading:
    """The state of one world for people, by side, by agent or by name."""

    episode: int  # index within its seed
    seed: int
    time: float  # since the start, in s
    players: Mapping[str, str]  # names of the sides' policies
    scores: Mapping[str, float]  # points; a single side has none
    success: Mapping[str, bool]  # whether the goal is met now
    returns: Mapping[str, float]  # sums of rewards since the start
    rewards: Mapping[str, Mapping[str, float]]  # named terms of the last step
    measures: Mapping[str, float | bool]  # distances and the like
    units: Mapping[str, str]  # of the measures that have one
    previous: str  # how the last end or success came, a sentence, or empty
    has_ended: bool  # whether this episode is over
    trouble: str = ""  # why it cannot go on, a sentence, or empty
    is_loading: bool = False  # whether another world is being made
    has_met: bool = False  # whether the only side has met the goal in this episode
    tally: tuple[int, int] = (0, 0)  # episodes before with success, and all of them
    pull: float = 0.0  # strength of a user's pull, in N

    @property
    def rows(self) -> list[tuple[str, str]]:
        """The reading as rows of name and value; the heading of a part has no value."""
        # There are the same rows at any time, so that none jumps.
        rows = [(f"episode of seed {self.seed}", str(self.episode))]
        if len(self.players) == 1:
            rows.append(("succeeded before", "{} of {}".format(*self.tally)))
        rows += [("time", f"{self.time:.1f} s"), ("your pull", f"{self.pull:.1f} N")]
        indent = "  " * (len(self.players) > 1)
        for side, player in self.players.items():
            rows.append((side if indent else "policy", player))
            if side in self.scores:
                rows.append((f"{indent}score", f"{self.scores[side]:g}"))
            rows.append((f"{indent}success", _word(self.success[side])))
            rows.append((f"{indent}return", f"{self.returns[side]:z.1f}"))
        if self.measures:
            rows.append(("measured", ""))
            rows += [
                (f"  {name}", _word(value, self.units.get(name, "")))
                for name, value in self.measures.items()
            ]
        for agent, terms in self.rewards.items():
            rows.append((f"reward of {agent}", f"{sum(terms.values()):z.3f}"))
            rows += [(f"  {name}", _word(term)) for name, term in terms.items()]
        return [*rows, ("last result", ""), (f"  {self.previous or 'none'}", "")]


def read(
    env: VectorEnv,
    infos: Mapping[str, Any],
    players: Mapping[str, str],
    before: Reading | None = None,
    world: int = 0,
) -> Reading:
    """Return the reading of one world after a step or reset with these infos.

    `before` is the reading of the step before, or None.
    """
    names, progress = ("seed", "episode", "step"), env.progress
    seed, episode, step = (int(progress[name][world]) for name in names)
    infos = _one_world(infos, world)
    rewards = {
        agent: {name: float(term[0]) for name, term in named.items()}
        for agent, named in infos["reward_terms"].items()
    }
    earned = before.returns if before is not None and step > 1 else {}
    ended, success = bool(infos["ended"][0]), _by_side(env.sides, infos["success"])
    is_met = len(success) == 1 and step > 0 and bool(success[0][1][0])
    points = infos["metrics"].get("score", {})
    measures = list(_measures(env.facts, env.task.units, world))
    previous = "" if before is None else before.previous
    return Reading(
        episode=episode,
        seed=seed,
        time=step * env.control_dt,
        players=players,
        scores={side: float(own[0]) for side, own in points.items()},
        # At a start no success counts.
        success={side: bool(step > 0 and met[0]) for side, met in success},
        returns={
            side: earned.get(side, 0.0)
            + sum(sum(rewards.get(agent, {}).values()) for agent in agents)
            for side, agents in env.sides.items()
        },
        rewards=rewards,
        measures={name: value for name, _, value in measures},
        units={name: unit for name, unit, _ in measures if unit},
        previous=_sum_up(env, infos, players) if ended or is_met else previous,
        has_ended=ended,
        has_met=is_met or (before is not None and step > 1 and before.has_met),
        tally=(0, 0) if before is None else _tally(before, step),
    )


def _tally(before: Reading, step: int) -> tuple[int, int]:
    """Return the tally after a reading; an episode without an end does not count."""
    if step or not (before.has_met or before.has_ended):
        return before.tally
    return before.tally[0] + before.has_met, before.tally[1] + 1


def _one_world(infos: Any, world: int) -> Any:
    if isinstance(infos, Mapping):
        return {name: _one_world(value, world) for name, value in infos.items()}
    return infos[world : world + 1]


def _by_side(sides: Iterable[str], given: Any) -> list[tuple[str, Any]]:
    """Return a value for each side, from a mapping or from the single side's value."""
    return [(s, given[s] if isinstance(given, Mapping) else given) for s in sides]


def _measures(
    facts: Any, units: Mapping[str, str], world: int
) -> Iterator[tuple[str, str, float | bool]]:
    """Yield name, unit and value of the facts that are one number or truth a world."""
    for fact, value in named_facts(facts).items():
        parts = value.items() if isinstance(value, Mapping) else [("", value)]
        for agent, part in parts:
            if getattr(part, "ndim", None) == 1:
                name = f"{fact.replace('_', ' ')} {agent}".rstrip()
                yield name, units.get(fact, ""), np.asarray(part)[world].item()


def _word(value: float | bool, unit: str = " ") -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    # What has no unit is a count or a share.
    return f"{value:z.3f} {unit}".rstrip() if unit else f"{value:z.3g}"


@lru_cache
def meanings(task: type[Task], facts: type) -> Mapping[str, str]:
    """Return what reward terms and measures are, as far as the task's file says it.

    Its docstring has a line on each term, and its facts have comments. The keys are the
    names in a reading's rows without agents, of terms after "reward ".
    """
    page = inspect.getdoc(inspect.getmodule(task)) or ""
    lines = re.findall(r"^- `(\w+)`((?:[^\n]|\n  )+)", page, re.M)
    said = {f"reward {term}": line.lstrip(" :,") for term, line in lines}
    for kind in facts.__mro__[-2::-1]:
        with suppress(OSError, TypeError):  # It may have no file.
            source = inspect.getsource(kind)
            comments = re.findall(r"^    (\w+):.*  # (.+)$", source, re.M)
            said |= {fact.replace("_", " "): text for fact, text in comments}
    words = ((n, text.replace("(num_envs,)", "").split()) for n, text in said.items())
    return {name: " ".join(own).strip(", ") for name, own in words}


def _sum_up(
    env: VectorEnv, infos: Mapping[str, Any], players: Mapping[str, str]
) -> str:
    metrics = infos["metrics"]
    times = _by_side(players, metrics["time_to_success"])
    returns = _by_side(players, metrics["return"])
    results = [result(players, infos)] if len(players) > 1 else []
    is_early = infos["step"][0] < env.task.config.max_episode_steps
    if infos["ended"][0] and is_early and not infos["diverged"][0]:
        results.append(f"over after {infos['step'][0] * CONTROL_DT:.1f} s")
    for (side, time), (_, earned) in zip(times, returns, strict=True):
        if infos["diverged"][0]:
            end = "the physics diverged"
        elif np.isnan(time[0]):
            end = "no success"
        else:
            end = f"success after {time[0]:.1f} s"
        name = f"{side} " if len(times) > 1 else ""
        results.append(f"{name}{end}, return {earned[0]:z.1f}")
    return f"episode {metrics['episode'][0]}: {'; '.join(results)}"
