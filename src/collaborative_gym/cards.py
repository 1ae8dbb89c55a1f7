"""The report card of policies: how they do, how gently, disturbed and with others."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from collaborative_gym.errors import check_callback, check_count
from collaborative_gym.evaluation import Report
from collaborative_gym.evaluation.figure import make_figure, open_axes, save_figure
from collaborative_gym.evaluation.play import (
    DISTURBANCES,
    OnProgress,
    evaluate,
    measure_robustness,
    parts_of,
)
from collaborative_gym.evaluation.report import format_statistic, markdown_tables
from collaborative_gym.evaluation.table import escaped, markdown_table, to_json
from collaborative_gym.policies import AnyPolicy
from collaborative_gym.policies.policy import named_policies
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task
from collaborative_gym.tournaments.play import tournament
from collaborative_gym.tournaments.result import Tournament, format_estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PLOT = 4.2, 3.2  # width and height of a panel, in inches


@dataclass(frozen=True)
class ReportCard:
    """A report card of policies in one environment.

    Attributes:
      environment: the environment's id or the task's name.
      reports: of each policy alone, by its name.
      robustness: by policy, its reports with each disturbance, or empty.
      cross_play: the policies and the expert with one another; None if that was not
        asked for, or there is nobody else to play with.
    """

    environment: str
    reports: Mapping[str, Report]
    robustness: Mapping[str, Mapping[str, Report]]
    cross_play: Tournament | None

    def to_json(self) -> str:
        """Return all numbers as JSON, with null for NaN."""
        return to_json(self.plain())

    def plain(self) -> dict[str, Any]:
        """Return all numbers except those of single episodes, as plain dictionaries."""
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
          pictures: files to show on it, by their paths from the page.
        """
        first = next(iter(self.reports.values()))
        parts = [f"# {escaped(first.title)}"]
        parts += [f"![{name}]({name})" for name in pictures]
        for name, report in self.reports.items():
            settings = report.settings
            parts += [
                f"## {escaped(name)}",
                f"{settings['episodes']} episodes of seed {settings['seed']}, in which"
                " nothing is trained. Intervals are of 95 %.",
                markdown_tables(report).strip(),
            ]
        if self.robustness:
            parts += ["## Robustness", *self._robustness()]
        if self.cross_play:
            parts += ["## Cross-play", *_matrices(self.cross_play)]
        versions = first.settings["identity"]["versions"].items()
        listed = ", ".join(f"{name} {version}" for name, version in versions)
        return "\n\n".join([*parts, f"Versions: {listed}."]) + "\n"

    def _robustness(self) -> list[str]:
        heads, lines = ["disturbance"], {name: [name] for name in DISTURBANCES}
        count = 0
        for policy, own in self.robustness.items():
            for measure in ("completion", "performance"):
                heads.append(f"{measure} of {policy}")
                for name, report in own.items():
                    count = len(report.episodes)
                    of_sides = (getattr(s, measure) for s in report.sides.values())
                    texts = (format_statistic(each, percent=True) for each in of_sides)
                    lines[name].append(", ".join(texts))
        note = f"{count} episodes with each, drawn as `hard` draws them."
        return [markdown_table(heads, lines.values()), note]


def _matrices(played: Tournament) -> list[str]:
    parts = []
    first, *others = played.seats
    head = f"{first} / {others[0]}" if len(others) == 1 else "one / all others"
    for measure in played.measures:
        lines = [
            [row, *(format_estimate(measure, each) for each in cells.values())]
            for row, cells in played.matrices[measure].items()
        ]
        parts += [f"**{measure}**", markdown_table([head, *played.players], lines)]
    count = played.settings["episodes"]
    parts.append(f"{count} episodes of each pairing, of the same starts.")
    left_out = played.left_out.items()
    return parts + [escaped(f"{title} left out: {why}") for title, why in left_out]


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
    on_progress: OnProgress = None,
) -> ReportCard:
    """Return a report card of policies in an environment.

    Args:
      env: an environment id, a task's name, or a task.
      policies: whatever `load_policy` takes, each under the name that the command line
        has for it; or a dictionary of policies by names of your own.
      episodes: number that each policy plays by itself; no training sees their starts.
      disturbed: number with each of the disturbances of `hard`, alone and together;
        0 for no table of robustness.
      paired: number of each pairing of the policies and the expert; 0 for none.
      seed: the episodes' seed.
      num_envs: worlds that play at the same time; None for at most 64.
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
    named = named_policies(policies)
    if not named:
        raise ValueError("got no policies; give one or more")
    players = dict(named)
    if type(task).expert is not Task.expert:
        players.setdefault("expert", "expert")
    is_paired = paired > 0 and len(players) > 1 and len(task.agents) > 1
    sizes = [episodes, disturbed * len(DISTURBANCES)] * len(named)
    sizes.append(is_paired * paired * len(players) ** 2)
    parts = iter(parts_of(on_progress, sizes))
    how: dict[str, Any] = dict(
        seed=seed, num_envs=num_envs, num_threads=num_threads, any_env=any_env
    )
    reports, robustness, played = {}, {}, None
    for name, policy in named.items():
        part, later = next(parts), next(parts)
        how |= {"episodes": episodes, "on_progress": part}
        reports[name] = evaluate(task, policy, **how)
        if disturbed:
            how |= {"episodes": disturbed, "on_progress": later}
            robustness[name] = measure_robustness(task, policy, **how)
    if is_paired:
        how |= {"episodes": paired, "on_progress": next(parts)}
        played = tournament(task, players, **how)
    return ReportCard(task.name, reports, robustness, played)


def draw_card(card: ReportCard, path: str | Path) -> None:
    """Draw when episodes succeed, and how many of them disturbed, into a PNG or SVG.

    Raises:
      ImportError: if the extra `train` is not installed.
      OSError: if the file cannot be written.
    """
    panels = [_draw_times, _draw_robustness] if card.robustness else [_draw_times]
    size = _PLOT[0] * len(panels), _PLOT[1]
    figure, all_axes = make_figure(1, len(panels), size)
    for axes, draw in zip(all_axes, panels, strict=True):
        draw(axes, card)
        open_axes(axes)
    save_figure(figure, path)


def _draw_times(axes: "Axes", card: ReportCard) -> None:
    for name, report in card.reports.items():
        for side in report.sides:
            column, label = "time_to_success", name
            if len(report.sides) > 1:
                column, label = f"{side}/{column}", f"{name}, {side}"
            times = np.array([row[column] for row in report.episodes])
            reached = np.sort(times[~np.isnan(times)])
            shares = 100 * np.arange(len(reached) + 1) / len(times)
            axes.step([0.0, *reached], shares, where="post", label=label)
    axes.set_xlabel("time in s")
    axes.set_ylabel("episodes that have succeeded, in %")
    axes.set_ylim(0, 103)
    axes.set_xlim(left=0)
    axes.legend(frameon=False, fontsize=8)


def _draw_robustness(axes: "Axes", card: ReportCard) -> None:
    height = 0.8 / len(card.robustness)
    for i, (policy, own) in enumerate(card.robustness.items()):
        scores = [next(iter(report.sides.values())) for report in own.values()]
        means = 100 * np.array([score.completion.mean for score in scores])
        ends = [(each.completion.low, each.completion.high) for each in scores]
        reach = np.abs(100 * np.array(ends).T - means)
        places = np.arange(len(own)) + height * (i - (len(card.robustness) - 1) / 2)
        axes.barh(places, means, height, xerr=np.nan_to_num(reach), label=policy)
    axes.set_yticks(range(len(DISTURBANCES)), list(DISTURBANCES))
    axes.invert_yaxis()
    axes.set_xlabel("completion in %, by what disturbs")
