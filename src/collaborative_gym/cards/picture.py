"""The picture of a report card: when episodes succeed, and what disturbs them."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym.cards.card import ReportCard
from collaborative_gym.evaluation.figure import make_figure, open_axes, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PLOT = 4.2, 3.2
"""Width and height of a panel, in inches."""


def draw_card(card: ReportCard, path: str | Path) -> None:
    """Draw when episodes succeed, and how many of them disturbed, into a PNG or SVG.

    Args:
      card: what to draw.
      path: the file.

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
    """Draw which share of the episodes has succeeded by which time."""
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
    """Draw the completion with each disturbance, and its interval."""
    height = 0.8 / len(card.robustness)
    for i, (policy, own) in enumerate(card.robustness.items()):
        scores = [next(iter(report.sides.values())) for report in own.values()]
        means = 100 * np.array([score.completion.mean for score in scores])
        ends = [(each.completion.low, each.completion.high) for each in scores]
        reach = np.abs(100 * np.array(ends).T - means)
        places = np.arange(len(own)) + height * (i - (len(card.robustness) - 1) / 2)
        axes.barh(places, means, height, xerr=np.nan_to_num(reach), label=policy)
    names = list(next(iter(card.robustness.values())))
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel("completion in %, by what disturbs")
