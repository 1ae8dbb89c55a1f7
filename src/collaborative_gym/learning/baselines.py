"""The baseline of an environment: the best of its runs, and its card."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

from collaborative_gym.evaluation import Report, evaluate
from collaborative_gym.evaluation.machine import describe_machine
from collaborative_gym.evaluation.report import (
    format_number,
    format_statistic,
    strain_table,
)
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.files import replacing, write_text
from collaborative_gym.learning.config import (
    Hyperparameters,
    Resources,
    changed,
    recipe,
)
from collaborative_gym.learning.folder import CURVE
from collaborative_gym.learning.run import Result
from collaborative_gym.learning.settings import Settings
from collaborative_gym.policies.policy import POLICY_FILE
from collaborative_gym.tasks.registry import get_env, make_task
from collaborative_gym.tasks.task import Randomization

_EPISODES, _SEED = {"paper": 200, "default": 1000, "default, late": 200}, 0
"""The episodes of a card; no run is trained on them or chosen by them. In late ones,
every action comes one control step late."""

_CHOICE_EPISODES, _CHOICE_SEED = 200, 1
"""Other episodes, by which the run is chosen that is shipped."""

_COLUMNS = ("seed", "steps", "time", "start", "mean reward", "median", "completion")
_COLUMNS += ("performance", "time to success")


def write_baseline(
    results: Sequence[Result], output: str | Path, resources: Resources | None = None
) -> Path:
    """Write the baseline that the best of an environment's runs gives; return its card.

    It is the policy of the best run, `ID.safetensors`; its curve, `ID.png`; and the
    card, `ID.md`, with all runs' results. The best run is the one with the best
    completion and performance, in percent, in other episodes than the card's. Of equals
    it is the one whose arms keep farther apart there, to the centimetre, then the one
    that needs less energy.

    Args:
      results: of the environment's runs, whose seeds differ.
      output: the folder.
      resources: that they used.
    """
    output, resources = Path(output), resources or Resources()
    env_id, best = results[0].settings.identity.name, results[0]
    if len(results) > 1:
        best = max(results, key=lambda each: _rank(env_id, each, resources))
    for name, suffix in ((POLICY_FILE, ".safetensors"), (CURVE, ".png")):
        with replacing(output / f"{env_id}{suffix}") as partial:
            shutil.copyfile(best.folder / name, partial)
    reports = [_measure(env_id, each, resources) for each in results]
    rows = [
        _row(result, starts, report, result is best)
        for result, own in zip(results, reports, strict=True)
        for starts, report in own.items()
    ]
    lines = [
        *_description(best, len(results), resources),
        "",
        markdown_table(_COLUMNS, rows),
        "",
        "Strain of the shipped policy on `default`:",
        "",
        strain_table(reports[results.index(best)]["default"]),
    ]
    card = output / f"{env_id}.md"
    write_text(card, "\n".join(lines) + "\n")
    return card


def _measure(env_id: str, result: Result, resources: Resources) -> dict[str, Report]:
    return {
        starts: evaluate(
            make_task(env_id, randomization=starts.partition(",")[0]),
            result.policy(),
            episodes=episodes,
            seed=_SEED,
            delay=int(starts.endswith("late")),
            num_threads=resources.num_threads,
        )
        for starts, episodes in _EPISODES.items()
    }


def _rank(env_id: str, result: Result, resources: Resources) -> tuple[float, ...]:
    """Return the numbers whose greatest is shipped; see `write_baseline`."""
    report = evaluate(
        env_id,
        result.policy(),
        episodes=_CHOICE_EPISODES,
        seed=_CHOICE_SEED,
        num_threads=resources.num_threads,
    )
    return (
        round(report.completion.mean, 2),
        round(report.performance.mean, 2),
        round(report.strain["clearance"].worst, 2),
        -report.strain["energy"].mean,
    )


def _description(best: Result, count: int, resources: Resources) -> list[str]:
    """Return a card's lines above its numbers: the best policy, and how it learned."""
    settings, numbers = best.settings, best.settings.hyperparameters
    identity, machine = settings.identity, describe_machine()
    own = [f"{name} {_option(value)}" for name, value in changed(numbers).items()]
    episodes = "; ".join(f"{starts}: {n:,}" for starts, n in _EPISODES.items())
    curriculum = (
        f" At first, the simulator carried {100 * numbers.assistance:g} % of the"
        " weight, and less as success grew (nothing in what is reported)."
    ) * (numbers.assistance > 0)
    among = (
        f", and {_CHOICE_EPISODES} others the seed, by completion, performance,"
        " clearance and energy"
    ) * (count > 1)
    who, layers = _network(settings)
    return [
        f"# {identity.name}: baseline",
        "",
        f"PPO trained {who} ({', '.join(identity.robot_names)}) on the task's reward"
        f" {_beginning(settings.to_dict())}. The mode was {settings.mode}.{curriculum}"
        " Returns contain no penalties.",
        "",
        f"- environment: `{identity.name}`, randomization"
        f" `{_preset(identity.name, identity.config['randomization'])}`",
        f"- network: {layers}, {numbers.activation}; actions are means, without noise",
        f"- non-default hyperparameters: {', '.join(own) or 'none'}",
        f"- shipped: seed {settings.seed} at {best.best['steps'] / 1e6:.2f} M steps."
        f" {numbers.validation_episodes} validation episodes chose this checkpoint"
        f"{among}; the table has other episodes",
        *training_commands(settings, resources),
        f"- machine: {machine['cpu']}, {machine['cores']} core"
        f"{'s' * (machine['cores'] != 1)}, MuJoCo {machine['mujoco']}",
        "",
        "The table has means and 95 % intervals over episodes of seed"
        f" {_SEED} ({episodes})."
        " If all starts are the same, there is one deterministic episode and no"
        " interval. In `late`, every action comes one control step late.",
    ]


def _row(result: Result, starts: str, report: Report, is_best: bool) -> list[str]:
    return [
        f"{result.settings.seed}" + " (shipped)" * is_best,
        f"{result.steps / 1e6:.2f} M",
        f"{result.seconds / 60:.0f} min",
        starts,
        format_statistic(report.mean_reward),
        format_number(report.mean_reward.median),
        format_statistic(report.completion, percent=True),
        format_statistic(report.performance, percent=True),
        format_statistic(report.time_to_success, unit=" s"),
    ]


def _network(settings: Settings) -> tuple[str, str]:
    numbers = settings.hyperparameters
    layers = " x ".join(map(str, numbers.hidden_sizes))
    if numbers.network == "set":
        layers = f"for sets, {layers} after the pooling"
    who = "one policy for all robots"
    return who if settings.mode == "shared" else "a policy for each robot", layers


def _beginning(own: Mapping[str, Any]) -> str:
    """Return words for the runs that led to a policy of this metadata, or settings."""
    runs = [own]
    while runs[-1].get("start_from"):
        runs.append(runs[-1]["start"]["metadata"])
    if len(runs) == 1:
        return f"from scratch {_guide(own)}"
    parts = [
        f"{before['steps'] / 1e6:.2f} M steps of seed {before['seed']}"
        f" {_guide(before)} (digest {after['start']['digest'][:12]})"
        for after, before in pairwise(runs)
    ]
    return (
        f"in {len(runs)} runs, each from the policy of the run before. First came"
        f" {', then '.join(reversed(parts))}. The last run, {_guide(own)}, took the"
        " steps and the time of the table"
    )


def _guide(own: Mapping[str, Any]) -> str:
    is_guided = bool(own["hyperparameters"].get("imitation"))
    return "with the expert's advice" if is_guided else "without demonstrations"


def training_commands(settings: Settings, resources: Resources) -> list[str]:
    """Return lines with the commands that train such a run again, the first run first.

    Runs whose policy files lack `randomization`, as early ones do, are left out.
    """
    identity, start = settings.identity, settings.start
    options = ""
    if resources.torch_threads != Resources.torch_threads:
        # Another number may change the last bits.
        options = f" --torch-threads {resources.torch_threads}"
    runs = [(identity.name, asdict(settings), identity.config["randomization"])]
    while "randomization" in start:
        runs.append((start["environment"], start["metadata"], start["randomization"]))
        start = start["metadata"]["start"]
    runs.reverse()
    commands = []
    for i, (env_id, own, starts) in enumerate(runs):
        # A run may have begun with a baseline of then, which is no folder to write to.
        before = f"runs/part_{i}" if i else own["start_from"]
        command = _command(env_id, own | {"start_from": before}, starts) + options
        output = f" --output runs/part_{i + 1}" if i + 1 < len(runs) else ""
        commands.append(command + output)
    count = len(commands)
    return [
        f"- command{f' {i + 1} of {count}' if count > 1 else ''}: `{command}`"
        for i, command in enumerate(commands)
    ]


def _command(env_id: str, own: Mapping[str, Any], starts: Mapping[str, Any]) -> str:
    numbers = dict(own["hyperparameters"])
    advised = numbers.get("imitation", 0.0) > 0.0
    others = changed(Hyperparameters(**numbers), recipe(env_id, advised=advised))
    if own["start_from"]:
        others["start_from"] = own["start_from"]
    options = ["--advised"] * advised
    options += [f"--{n.replace('_', '-')} {_option(own)}" for n, own in others.items()]
    if (preset := _preset(env_id, starts)) != "default":
        options.append(f"--randomization {preset}")
    for option in ("opponent", "partner"):
        if guests := own.get(f"{option}s"):
            options.append(f"--{option} {' '.join(guests)}")
    return " ".join(
        [f"collaborative-gym train {env_id} --seed {own['seed']}", *options]
    )


def _preset(env_id: str, randomization: Mapping[str, Any]) -> str:
    own = Randomization(**randomization)
    presets = get_env(env_id).task.randomizations.items()
    return next((name for name, preset in presets if preset == own), str(own))


def _option(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
