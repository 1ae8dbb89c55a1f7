"""The pictures of a training run: its learning curve, and a league's ratings."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from collaborative_gym.evaluation.figure import (
    COLOURS,
    make_figure,
    open_axes,
    save_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WINDOW = 0.02  # share of the run that the moving mean takes in
_SIZE = 8.0, 6.0  # width and height of a picture, in inches

_INK = "#222222"
"""Colour of text."""

_INKS = (_INK, "#999999")
"""Colours of all robots together, or of the sides."""

_Rows = Sequence[Mapping[str, float]]


def robots_of(columns: Iterable[str]) -> list[str]:
    """Return the agents whose own returns are among the columns, in order."""
    return _owners(columns, "robot_")


def sides_of(columns: Iterable[str]) -> list[str]:
    """Return the prefix of each side's results, such as "side_1/".

    It is one empty prefix if all robots are on one side.
    """
    return [f"{side}/" for side in _owners(columns, "side_")] or [""]


def _owners(columns: Iterable[str], prefix: str) -> list[str]:
    names = (name.removeprefix("validation/") for name in columns)
    return [
        name.removesuffix("/return")
        for name in dict.fromkeys(names)
        if name.startswith(prefix) and name.endswith("/return")
    ]


def draw_curve(rows: _Rows, title: str, path: str | Path) -> None:
    """Draw a run's learning curve into a PNG file, whole or not at all.

    Args:
      rows: the run's, as `monitor.summarize` returns them.
      title: heads the picture.
      path: the file.

    Raises:
      ImportError: if the extra `train` is not installed.
      OSError: if the file cannot be written.
    """
    save_figure(learning_curve(rows, title), path)


def learning_curve(rows: _Rows, title: str) -> "Figure":
    """Return a run's learning curve, 8 x 6 in, that belongs to no window.

    Above are the returns over environment steps, of all robots together (or of each
    side, where there are several) and of each robot: those of the episodes pale, their
    moving mean over 2 % of the run strong, and validations as dots. Below are
    completion and performance.

    Args:
      rows: the run's, as `monitor.summarize` returns them.
      title: heads the picture.

    Raises:
      ImportError: if the extra `train` is not installed.
    """
    figure, (above, below) = make_figure(2, 1, _SIZE, sharex=True, height_ratios=(5, 2))
    columns = dict.fromkeys(name for row in rows for name in row)
    _draw_returns(above, rows, columns)
    _draw_shares(below, rows, columns)
    _finish(figure, (above, below), title)
    above.set_ylabel("mean reward per episode")
    below.set_ylabel("share (%)")
    below.set_ylim(-4, 104)
    below.set_yticks((0, 50, 100))
    below.set_xlabel("environment steps (millions)")
    if rows:
        below.set_xlim(0.0, 1.01 * rows[-1]["steps"] / 1e6)
    return figure


def draw_ratings(
    lines: Mapping[str, Sequence[tuple[float, float]]], title: str, path: str | Path
) -> None:
    """Draw how strong the players of a league are, whole or not at all.

    Args:
      lines: by name, steps and ratings.
      title: heads the picture.
      path: the file, a PNG.

    Raises:
      ImportError: if the extra `train` is not installed.
      OSError: if the file cannot be written.
    """
    figure, (axes,) = make_figure(1, 1, _SIZE)
    for (name, points), colour in zip(lines.items(), cycle(COLOURS), strict=False):
        steps, ratings = np.array(sorted(points), float).reshape(-1, 2).T
        axes.plot(steps / 1e6, ratings, color=colour, marker="o", label=name)
    _finish(figure, [axes], title)
    axes.set_ylabel("rating (Elo's scale)")
    axes.set_xlabel("environment steps (millions)")
    save_figure(figure, path)


def _finish(figure: "Figure", all_axes: Sequence["Axes"], title: str) -> None:
    for axes in all_axes:
        open_axes(axes)
        if axes.get_legend_handles_labels()[0]:
            # Above the axes, where no curve can run into the names.
            where = {
                "loc": "lower left",
                "bbox_to_anchor": (0, 1),
                "borderaxespad": 0.2,
            }
            axes.legend(ncols=5, frameon=False, fontsize="small", **where)
    figure.suptitle(title, x=0.01, horizontalalignment="left", color=_INK)


def _draw_returns(axes: "Axes", rows: _Rows, columns: Iterable[str]) -> None:
    # Drawn on top of the robots' curves, but named before them.
    for side, ink in zip(sides_of(columns), cycle(_INKS), strict=False):
        label = side.removesuffix("/") or "all robots"
        _draw_line(axes, rows, f"{side}return", label, color=ink, linewidth=2.4)
        _draw_dots(axes, rows, f"{side}return", label, ink)
    for i, robot in enumerate(robots_of(columns)):
        colour = COLOURS[i % len(COLOURS)]
        # Every other one is dashed: robots that earn the same lie on one another.
        style: Any = {"color": colour, "linestyle": "dashed" if i % 2 else "solid"}
        _draw_line(axes, rows, f"{robot}/return", robot, linewidth=1.5, **style)


def _draw_shares(axes: "Axes", rows: _Rows, columns: Iterable[str]) -> None:
    shares = [{n: 100.0 * x if n != "steps" else x for n, x in r.items()} for r in rows]
    for i, side in enumerate(sides_of(columns)):
        of = f" of {side.removesuffix('/')}" if side else ""
        for name, colour in (("completion", "#0072b2"), ("performance", "#d55e00")):
            column, label = f"{side}{name}", f"{name}{of}"
            style: Any = {"color": colour, "linestyle": "dashed" if i % 2 else "solid"}
            _draw_line(axes, shares, column, label, linewidth=1.8, **style)
            _draw_dots(axes, shares, column, label, colour)
    _draw_dots(axes, shares, "points", "points against opponents", "#009e73")


def _draw_line(
    axes: "Axes", rows: _Rows, column: str, label: str, **style: Any
) -> None:
    steps, values = _points(rows, column)
    if not len(steps):
        return
    axes.plot(steps, values, color=style["color"], alpha=0.3, linewidth=0.8)
    axes.plot(
        steps,
        _moving_mean(values, round(_WINDOW * len(rows))),
        # A single point makes no line.
        marker="o" if len(steps) == 1 else None,
        label=label,
        zorder=2.0 + style["linewidth"] / 10,
        **style,
    )


def _draw_dots(axes: "Axes", rows: _Rows, column: str, label: str, colour: str) -> None:
    steps, values = _points(rows, f"validation/{column}")
    if len(steps):
        axes.plot(
            steps,
            values,
            linestyle="none",
            marker="o",
            markersize=4.5,
            markerfacecolor="white",
            markeredgecolor=colour,
            label=f"{label}, validation",
            zorder=3,
        )


def _points(rows: _Rows, column: str) -> tuple[np.ndarray, np.ndarray]:
    known = [(row["steps"] / 1e6, row[column]) for row in rows if column in row]
    steps, values = np.array(known, float).reshape(-1, 2).T
    is_finite = np.isfinite(values)
    return steps[is_finite], values[is_finite]


def _moving_mean(values: np.ndarray, window: int) -> np.ndarray:
    half = window // 2
    sums = np.concatenate([[0.0], np.cumsum(values)])
    low = np.maximum(np.arange(len(values)) - half, 0)
    high = np.minimum(np.arange(len(values)) + half + 1, len(values))
    return (sums[high] - sums[low]) / (high - low)
