"""The report card of policies: how they do, how gently, disturbed and with others."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from collaborative_gym.errors import check_callback, check_count, check_kind
from collaborative_gym.evaluation.play import evaluate
from collaborative_gym.evaluation.report import (
    Report,
    format_statistic,
    markdown_tables,
    plain_to_json,
)
from collaborative_gym.evaluation.robustness import DISTURBANCES, measure_robustness
from collaborative_gym.evaluation.table import escaped, markdown_table
from collaborative_gym.policies import AnyPolicy, name_policy
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task
from collaborative_gym.tournaments.play import tournament
from collaborative_gym.tournaments.result import Tournament, format_estimate

_PERCENT = ("completion", "performance")


@dataclass(frozen=True)
class ReportCard:
    """What there is to say about some policies in one environment.

    Attributes:
      environment: the environment's id or the task's name.
      reports: of each policy alone, by its name.
      robustness: by policy, its reports with each of the disturbances; empty if that
        was not asked for.
      cross_play: the policies and the expert with one another; None if that was not
        asked for, or there is nobody else to play with.
    """

    environment: str
    reports: Mapping[str, Report]
    robustness: Mapping[str, Mapping[str, Report]]
    cross_play: Tournament | None

    def to_json(self) -> str:
        """Return all numbers as JSON, with null for NaN."""
        return plain_to_json(self.plain())

    def plain(self) -> dict[str, Any]:
        """Return all numbers, but those of single episodes, as plain dictionaries."""
        return {
            "environment": self.environment,
            "policies": {name: each.summary() for name, each in self.reports.items()},
            "robustness": {
                name: {disturbance: each.summary() for disturbance, each in own.items()}
                for name, own in self.robustness.items()
            },
            "cross_play": self.cross_play and json.loads(self.cross_play.to_json()),
        }

    def to_markdown(self, pictures: Sequence[str] = ()) -> str:
        """Return the card as a page of Markdown.

        Args:
          pictures: files to show on it, as they are called from the page.
        """
        reports = list(self.reports.values())
        parts = [f"# {escaped(reports[0].title)}"]
        parts += [f"![{name}]({name})" for name in pictures]
        for name, report in self.reports.items():
            settings = report.settings
            parts.append(f"## {escaped(name)}")
            parts.append(
                f"{settings['episodes']} episodes of seed {settings['seed']}, in which"
                " nothing is trained. Intervals are of 95 %."
            )
            parts.append(markdown_tables(report).strip())
        if self.robustness:
            parts += ["## Robustness", self._robustness()]
        if self.cross_play:
            parts += ["## Cross-play", *self._matrices(self.cross_play)]
        versions = reports[0].settings["identity"]["versions"]
        told = ", ".join(f"{name} {version}" for name, version in versions.items())
        parts.append(f"Versions: {told}.")
        return "\n\n".join(parts) + "\n"

    def _robustness(self) -> str:
        heads, lines = ["disturbance"], {name: [name] for name in DISTURBANCES}
        count = 0
        for policy, own in self.robustness.items():
            for measure in _PERCENT:
                heads.append(f"{measure} of {policy}")
                for name, report in own.items():
                    count = len(report.episodes)
                    told = [
                        format_statistic(getattr(score, measure), percent=True)
                        for score in report.sides.values()
                    ]
                    lines[name].append(", ".join(told))
        text = markdown_table(heads, lines.values())
        return f"{text}\n\n{count} episodes with each, drawn as `hard` draws them."

    def _matrices(self, played: Tournament) -> list[str]:
        parts = []
        for measure in played.measures:
            first, *others = played.seats
            head = f"{first} / {others[0]}" if len(others) == 1 else "one / all others"
            lines = [
                [row, *(format_estimate(measure, each) for each in cells.values())]
                for row, cells in played.matrices[measure].items()
            ]
            table = markdown_table([head, *played.players], lines)
            parts.append(f"**{measure}**\n\n{table}")
        count = played.settings["episodes"]
        parts.append(f"{count} episodes of each pairing, of the same starts.")
        left_out = played.left_out.items()
        parts += [escaped(f"{title} left out: {why}") for title, why in left_out]
        return parts


def report_card(
    env: str | Task,
    policies: Sequence[AnyPolicy] | Mapping[str, AnyPolicy] = ("expert",),
    *,
    episodes: int = 1000,
    disturbed: int = 100,
    paired: int = 100,
    seed: int = 0,
    num_envs: int | None = None,
    num_threads: int = 0,
    any_env: bool = False,
    on_progress: Callable[[float], object] | None = None,
) -> ReportCard:
    """Return a report card of policies in an environment.

    Args:
      env: an environment id, a task's name, or a task.
      policies: whatever `load_policy` takes, each under the name that the command line
        has for it; or a dictionary of policies by names of your own.
      episodes: how many each policy plays by itself; no training sees their starts.
      disturbed: how many with each of the disturbances of `hard`, alone and together;
        0 for no table of robustness.
      paired: how many of each pairing of the policies and the expert; 0 for none.
      seed: which episodes.
      num_envs: worlds to play in beside one another; None for at most 64.
      num_threads: physics threads, 0 for one per CPU.
      any_env: whether trained policies may play another environment than their own.
      on_progress: called after each step with the share that is done, 0 to 1.

    Raises:
      Exception: as `evaluate` and `tournament` do.
    """
    episodes = check_count("episodes", episodes, at_least=1)
    disturbed = check_count("disturbed", disturbed, at_least=0)
    paired = check_count("paired", paired, at_least=0)
    check_callback("on_progress", on_progress)
    task = as_task(env)
    named = _named(policies)
    players = dict(named)
    if type(task).expert is not Task.expert:
        players.setdefault("expert", "expert")
    is_paired = paired > 0 and len(players) > 1 and len(task.agents) > 1
    sizes = [episodes, disturbed * len(DISTURBANCES)] * len(named)
    parts = iter(_parts(on_progress, [*sizes, is_paired * paired * len(players) ** 2]))
    how: dict[str, Any] = dict(
        seed=seed, num_envs=num_envs, num_threads=num_threads, any_env=any_env
    )
    reports, robustness = {}, {}
    for name, policy in named.items():
        reports[name] = evaluate(
            task, policy, episodes=episodes, on_progress=next(parts), **how
        )
        part = next(parts)
        if disturbed:
            robustness[name] = measure_robustness(
                task, policy, episodes=disturbed, on_progress=part, **how
            )
    played = None
    if is_paired:
        played = tournament(
            task, players, episodes=paired, on_progress=next(parts), **how
        )
    return ReportCard(task.name, reports, robustness, played)


def _named(
    policies: Sequence[AnyPolicy] | Mapping[str, AnyPolicy],
) -> dict[str, AnyPolicy]:
    """Return the policies by their names, at least one.

    Raises:
      TypeError: if they are neither a list nor a dictionary.
      ValueError: if there is none, or there are two of one name.
    """
    if isinstance(policies, Mapping):
        named = {str(name): policy for name, policy in policies.items()}
    else:
        check_kind("policies", policies, (list, tuple), "a list of policies")
        named = {name_policy(policy): policy for policy in policies}
    if not named or len(named) < len(policies):
        raise ValueError(
            f"got {len(policies)} policies of {len(named)} names; give one or more,"
            " each once, or in Python a dictionary with a name for each"
        )
    return named


def _parts(
    on_progress: Callable[[float], object] | None, sizes: Sequence[int]
) -> list[Callable[[float], object] | None]:
    """Return callbacks for the progress of the parts, which tell that of all."""
    if on_progress is None:
        return [None] * len(sizes)

    def part(i: int) -> Callable[[float], object]:
        done = sum(sizes[:i])
        return lambda share: on_progress((done + share * sizes[i]) / sum(sizes))

    return [part(i) for i in range(len(sizes))]
