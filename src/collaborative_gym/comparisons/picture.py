"""The picture of a comparison, in the size of a two-column paper."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from string import ascii_lowercase
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from collaborative_gym.comparisons.result import Comparison
from collaborative_gym.evaluation.figure import (
    COLOURS,
    GRID,
    looking,
    make_figure,
    save_figure,
)
from collaborative_gym.evaluation.intervals import Estimate
from collaborative_gym.evaluation.report import is_share

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT, _COLUMNS = 7.16, 2.2, 3
"""Width and height of a line of panels, in inches, across both columns of an IEEE
paper, and the number of its panels."""

_LETTER, _MARK, _LEGEND_LINE = 0.065, 0.5, 0.15
"""Widths of a letter and of the mark before a name in the legend, and height of a line
of it, in inches, nearly."""

_MOST_LETTERS = 36  # letters in a line of a panel

_STYLES = ("solid", "dashed", "dashdot", "dotted")
"""Styles of lines, for eyes and printers without colours."""

_LOOK: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "lines.linewidth": 1.2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "pdf.fonttype": 42,  # Fonts whole, which publishers ask for.
    "svg.hashsalt": "collaborative-gym",  # The same bytes every time.
}


def draw_comparison(comparison: Comparison, *paths: str | Path) -> None:
    """Draw `comparison_figure` into .svg, .pdf or .png, each whole or not at all."""
    figure = comparison_figure(comparison)
    for path in map(Path, paths):
        # The same comparison is the same file, whenever it is drawn.
        dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
        with looking(_LOOK):
            save_figure(figure, path, dpi=300, metadata=dates.get(path.suffix))


def comparison_figure(comparison: Comparison) -> "Figure":
    """Return the panels of a comparison, 7.16 in wide, that belong to no window.

    First come the learning curves, interquartile means of validations with their 95 %
    intervals: a panel for each environment, or one where only environments differ. Then
    come the performance profile, the share of runs that score at least so much; and the
    probabilities of improvement. Long names are numbered.

    Raises:
      ImportError: if the extra `train` is not installed.
    """
    with looking(_LOOK):
        many = len(comparison.methods) > 1
        places = comparison.environments if many else ("",)
        names = comparison.methods if many else comparison.environments
        looks = zip(cycle(COLOURS), cycle(_STYLES), strict=False)
        styles = {
            name: {"color": colour, "linestyle": style}
            for name, (colour, style) in zip(names, looks, strict=False)
        }
        drawings: list[Any] = [(_draw_curves, place, styles) for place in places]
        if comparison.contestants:
            drawings.append((_draw_profiles, styles))
        numbers = _numbers(names, comparison)
        if comparison.improvements:
            drawings.append((_draw_improvements, numbers))
        columns = min(len(drawings), _COLUMNS)
        lines = math.ceil(len(drawings) / columns)
        size = _WIDTH * columns / _COLUMNS, _HEIGHT * lines
        figure, axes = make_figure(lines, columns, size)
        for letter, own, drawing in zip(ascii_lowercase, axes, drawings, strict=False):
            draw, *how = drawing
            draw(own, comparison, *how)
            # A paper's text calls panels by letters.
            mark = f"({letter}) " if len(drawings) > 1 else ""
            own.set_title(fill(mark + own.get_title(), _MOST_LETTERS))
        for unused in axes[len(drawings) :]:
            unused.remove()
        if len(names) > 1:
            labels = [f"{numbers[n]}: {n}" if n in numbers else n for n in names]
            _name(figure, labels, styles)
        return figure


def _numbers(names: Sequence[str], comparison: Comparison) -> dict[str, str]:
    longest = max((len(_over(*both)) for both in comparison.improvements), default=0)
    if longest <= _MOST_LETTERS:
        return {}
    return {name: str(i + 1) for i, name in enumerate(names)}


def _over(one: str, other: str) -> str:
    return f"{one} over {other}"


def _name(figure: "Figure", labels: Sequence[str], styles: Mapping[str, Any]) -> None:
    """Name the lines above all panels, and make the figure as much higher."""
    from matplotlib.lines import Line2D

    width, height = figure.get_size_inches()
    labels = [fill(label, int((width - _MARK) / _LETTER)) for label in labels]
    widest = _MARK + _LETTER * max(len(s) for text in labels for s in text.splitlines())
    columns = max(1, int(width / widest))
    lines = max(len(label.splitlines()) for label in labels)
    lines *= math.ceil(len(labels) / columns)
    figure.set_figheight(height + (1 + lines) * _LEGEND_LINE)
    marks = [Line2D([], [], **each) for each in styles.values()]
    plain = {"ncols": columns, "frameon": False}
    figure.legend(marks, labels, loc="outside upper left", **plain)


def _draw_curves(
    axes: "Axes", comparison: Comparison, place: str, styles: Mapping[str, Any]
) -> None:
    """Draw the learning curves of an environment, or of all where none is named."""
    measure = comparison.measure
    for group in comparison.groups:
        if place in ("", group.environment):
            name = group.method if place else group.environment
            curve = comparison.curve(group, measure)
            steps = group.steps / 1e6
            _draw_band(axes, steps, curve, measure, styles[name], name)
    axes.set_xlabel("environment steps (millions)")
    axes.set_ylabel(_label(measure))
    axes.set_xlim(left=0.0)
    if is_share(measure):
        axes.set_ylim(-2, 102)
    only = comparison.environments[0] if len(comparison.environments) == 1 else ""
    axes.set_title(place or only or "learning curves")


def _draw_band(
    axes: "Axes",
    places: np.ndarray,
    estimates: Sequence[Estimate],
    measure: str,
    style: Mapping[str, Any],
    name: str,
) -> None:
    values, low, high = (
        _factor(measure)
        * np.array([(each.value, each.low, each.high) for each in estimates]).T
    )
    marker = "o" if len(values) == 1 else None  # A single point makes no line.
    axes.plot(places, values, label=name, marker=marker, **style)
    axes.fill_between(places, low, high, color=style["color"], alpha=0.2, linewidth=0)


def _draw_profiles(
    axes: "Axes", comparison: Comparison, styles: Mapping[str, Any]
) -> None:
    levels = _factor(comparison.measure) * comparison.levels
    for name, profile in comparison.profiles.items():
        _draw_band(axes, levels, profile, "completion", styles[name], name)
    axes.set_ylim(-2, 102)
    axes.set_xlabel(f"at least this {_label(comparison.measure)}")
    axes.set_ylabel("share of runs (%)")
    axes.set_title(_of("profile", comparison))


def _draw_improvements(
    axes: "Axes", comparison: Comparison, numbers: Mapping[str, str]
) -> None:
    for i, (both, chance) in enumerate(comparison.improvements.items()):
        ends = 100 * np.array([chance.low, chance.high])
        axes.plot(ends, [i, i], color=COLOURS[0], linewidth=2.0)
        axes.plot(100 * chance.value, i, "o", color=COLOURS[0], markersize=4)
        title = _over(*(numbers.get(name, name) for name in both))
        axes.text(0, i - 0.15, title, fontsize=7, va="bottom")
    axes.axvline(50, color="#7f7f7f", linewidth=0.8, linestyle="dashed", zorder=1)
    axes.set_yticks([])
    axes.set_ylim(len(comparison.improvements) - 0.6, -0.8)
    axes.set_xlim(-4, 104)
    axes.set_xlabel("probability (%)")
    axes.set_title(_of("improvement", comparison))


def _of(what: str, comparison: Comparison) -> str:
    count = len(next(iter(comparison.contestants.values())).groups)
    return f"{what}, {count} environments" if count > 1 else what


def _label(measure: str) -> str:
    name = measure.replace("/", " ")
    return f"{name} (%)" if is_share(measure) else name


def _factor(measure: str) -> float:
    return 100.0 if is_share(measure) else 1.0
