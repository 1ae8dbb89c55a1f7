"""The baselines: several runs for each environment, the best one with its card."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from collaborative_gym.errors import check_kind, look_up
from collaborative_gym.evaluation import Report, evaluate
from collaborative_gym.evaluation.machine import describe_machine
from collaborative_gym.evaluation.report import (
    format_number,
    format_statistic,
    strain_rows,
)
from collaborative_gym.files import replacing, write_text
from collaborative_gym.learning.config import (
    Hyperparameters,
    Resources,
    changed,
    recipe,
)
from collaborative_gym.learning.folder import CURVE, LAST
from collaborative_gym.learning.run import OnRow, Result
from collaborative_gym.learning.settings import Settings
from collaborative_gym.learning.train import train
from collaborative_gym.policies.policy import POLICY_FILE
from collaborative_gym.tasks.registry import as_task

_EPISODES, _SEED = {"paper": 200, "default": 1000, "default, late": 200}, 0
"""What a card reports on; no run is trained on these episodes or chosen by them. Where
they are late, each action is done one control step late."""


class _Display(Protocol):
    """Shows how a run goes, while its context lasts."""

    def show(
        self, row: Mapping[str, float], best: Mapping[str, float] | None = None
    ) -> None: ...


Displays = Callable[[str, int], AbstractContextManager[_Display]]
"""Makes a display of a title and a run's total steps."""


@dataclass(frozen=True)
class Candidate:
    """One of an environment's runs, whose best policy may be shipped.

    Attributes:
      seed: of the run.
      result: what came of the training.
      reports: by the starts that they tell of, "paper", "default", and "default, late"
        for actions that are done one control step late.
    """

    seed: int
    result: Result
    reports: Mapping[str, Report]


def train_baselines(
    env_ids: Sequence[str],
    output: str | Path,
    *,
    seeds: Sequence[int] = (0, 1, 2),
    changes: Mapping[str, Any] | None = None,
    start_from: str | Path | None = None,
    resources: Resources | None = None,
    checkpoint_interval: int = 100_000,
    displays: Displays | None = None,
) -> Iterator[Path]:
    """Train baselines one after the other, and yield each one's card.

    For each environment there are in `output`: a folder with a run for each seed; the
    policy of the run with the best validation, as `ID.safetensors`; its curve,
    `ID.png`; and the card, `ID.md`, with all runs' results. Runs that are there already
    are continued or, where they are complete, taken as they are.

    Args:
      env_ids: which environments.
      output: the folder.
      seeds: of each environment's runs.
      changes: hyperparameters to use instead of those of each environment's recipe, by
        name; None for none.
      start_from: a policy to begin with, "baseline" for the shipped one of each
        environment; None for networks drawn by chance.
      resources: device and threads.
      checkpoint_interval: environment steps between two checkpoints.
      displays: makes what shows a run; None for no display.

    Raises:
      KeyError: if there is no such environment, or hyperparameter.
      ValueError: if there are no seeds, or a run that is there has other
        hyperparameters.
      Exception: what `train` raises.
    """
    if not seeds:
        raise ValueError("give at least one seed")
    recipes = changed_recipes(env_ids, changes)
    output = Path(output)
    resources = resources or Resources()
    for env_id, hyperparameters in recipes.items():
        candidates = []
        for seed in seeds:
            folder = output / env_id / f"seed{seed}"
            is_there = (folder / LAST).exists()
            title = f"{env_id}, seed {seed}"
            with _shown(displays, title, hyperparameters.total_steps) as on_row:
                result = train(
                    env_id,
                    "collaborative",
                    seed=seed,
                    output=None if is_there else folder,
                    resume=folder if is_there else None,
                    hyperparameters=hyperparameters,
                    start_from=start_from,
                    resources=resources,
                    checkpoint_interval=checkpoint_interval,
                    on_row=on_row,
                )
            candidates.append(
                Candidate(seed, result, _measure(env_id, result, resources))
            )
        yield _ship(env_id, candidates, output, resources)


def changed_recipes(
    env_ids: Sequence[str], changes: Mapping[str, Any] | None
) -> dict[str, Hyperparameters]:
    """Return how each environment is learned; what is wrong shows before the work.

    Args:
      env_ids: which environments.
      changes: what to use instead of their recipes', by name; None for nothing.

    Raises:
      KeyError: if there is no such environment, or hyperparameter.
    """
    changes = {} if changes is None else changes
    check_kind("changes", changes, Mapping, "a mapping, or None")
    for name in changes:
        look_up("hyperparameter", name, vars(Hyperparameters()))
    for env_id in env_ids:
        as_task(env_id)
    return {env_id: replace(recipe(env_id), **changes) for env_id in env_ids}


def _measure(env_id: str, result: Result, resources: Resources) -> dict[str, Report]:
    return {
        starts: evaluate(
            env_id,
            result.policy(),
            episodes=episodes,
            seed=_SEED,
            randomization=starts.partition(",")[0],
            delay=int(starts.endswith("late")),
            num_threads=resources.num_threads,
        )
        for starts, episodes in _EPISODES.items()
    }


def _ship(
    env_id: str, candidates: Sequence[Candidate], output: Path, resources: Resources
) -> Path:
    """Write the policy, the curve and the card of the best run; return the card."""
    best = max(
        candidates, key=lambda candidate: candidate.result.best["validation/return"]
    )
    for name, suffix in ((POLICY_FILE, ".safetensors"), (CURVE, ".png")):
        with replacing(output / f"{env_id}{suffix}") as partial:
            shutil.copyfile(best.result.folder / name, partial)
    card = output / f"{env_id}.md"
    write_text(card, write_card(env_id, candidates, best, resources))
    return card


def write_card(
    env_id: str, candidates: Sequence[Candidate], best: Candidate, resources: Resources
) -> str:
    """Return a baseline's card: what it is, how it was trained, and how well it does.

    Args:
      env_id: its environment.
      candidates: all runs.
      best: the one whose policy is shipped.
      resources: that they used.
    """
    settings = best.result.settings
    hyperparameters = settings.hyperparameters
    machine, robots = describe_machine(), ", ".join(settings.identity.robot_names)
    own = [
        f"{name} {_option(value)}" for name, value in changed(hyperparameters).items()
    ]
    steps = best.result.best["steps"]
    lines = [
        f"# {env_id}: baseline",
        "",
        f"A policy for each robot ({robots}), trained by PPO on the thesis's reward,"
        f" {_beginning(settings.start_from, settings.start)}; mode collaborative, no"
        f" shaping, {_curriculum(hyperparameters)}.",
        "",
        f"- environment: `{env_id}`, randomization `default`",
        f"- network: {' x '.join(map(str, hyperparameters.hidden_sizes))},"
        f" {hyperparameters.activation}; actions are the mean, without noise",
        f"- hyperparameters that are not the defaults: {', '.join(own) or 'none'}",
        f"- shipped: seed {best.seed} at {steps / 1e6:.2f} M steps, chosen by"
        f" {hyperparameters.validation_episodes} validation episodes that are not those"
        " below",
        f"- command: `{_command(env_id, settings, resources)}`",
        f"- machine: {machine['cpu']}, {machine['cores']} cores,"
        f" MuJoCo {machine['mujoco']}",
        "",
        f"Episodes of seed {_SEED} ({_episodes()}); means, 95 % bootstrap intervals."
        " Where starts are all the same there is one deterministic episode, and no"
        " interval. Where they are late, each action is done one control step late.",
        "",
        "| seed | steps | time | start | mean reward | median | completion |"
        " performance | time to success |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [row for each in candidates for row in _rows(each, each is best)]
    lines += ["", "The strain of the shipped one on `default`:", ""]
    lines += strain_rows([best.reports["default"]])
    return "\n".join(lines) + "\n"


def _episodes() -> str:
    return "; ".join(
        f"{starts}: {episodes:,}" for starts, episodes in _EPISODES.items()
    )


def _rows(candidate: Candidate, is_best: bool) -> Iterator[str]:
    """Yield the lines of a card's table that tell of a run."""
    for starts, report in candidate.reports.items():
        cells = [
            f"{candidate.seed} (shipped)" if is_best else f"{candidate.seed}",
            f"{candidate.result.steps / 1e6:.1f} M",
            f"{candidate.result.seconds / 60:.0f} min",
            starts,
            format_statistic(report.mean_reward),
            format_number(report.mean_reward.median),
            format_statistic(report.completion, percent=True),
            format_statistic(report.performance, percent=True),
            format_statistic(report.time_to_success, unit=" s"),
        ]
        yield f"| {' | '.join(cells)} |"


def _curriculum(hyperparameters: Hyperparameters) -> str:
    if not hyperparameters.assistance:
        return "no curriculum"
    return (
        f"and a curriculum: at first {100 * hyperparameters.assistance:g} % of the"
        " weight of what moves freely was carried, the less the more episodes were"
        " completed (none in what is reported)"
    )


def _beginning(start_from: str, start: Mapping[str, Any]) -> str:
    """Return with what a run began, and that with what, back to networks by chance."""
    if not start_from:
        return "from scratch, without demonstrations"
    own = start["metadata"]
    before = _beginning(own.get("start_from", ""), own.get("start", {}))
    return (
        f"beginning with the policy `{start_from}` of then (digest"
        f" {start['digest'][:12]}, seed {own['seed']}, {own['steps'] / 1e6:.2f} M"
        f" steps {before})"
    )


def _command(env_id: str, settings: Settings, resources: Resources) -> str:
    """Return the command that trains such a run again."""
    others = changed(settings.hyperparameters, recipe(env_id))
    if settings.start_from:
        others["start_from"] = settings.start_from
    if resources.torch_threads != Resources.torch_threads:
        # Another number may change the last bits.
        others["torch_threads"] = resources.torch_threads
    options = [
        f"--{name.replace('_', '-')} {_option(value)}" for name, value in others.items()
    ]
    return " ".join(
        [f"collaborative-gym train {env_id} --seed {settings.seed}", *options]
    )


def _option(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


@contextmanager
def _shown(
    displays: Displays | None, title: str, total_steps: int
) -> Iterator[OnRow | None]:
    """Yield what shows the rows of a run, if anything does."""
    if displays is None:
        yield None
        return
    with displays(title, total_steps) as display:
        yield display.show
