"""The picture of a tournament: matrices of results, and ratings."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym.evaluation.figure import (
    COLOURS,
    make_figure,
    open_axes,
    save_figure,
)
from collaborative_gym.evaluation.report import Statistic, is_share
from collaborative_gym.tournaments.result import Tournament, format_measure, short_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CELL = 0.62  # size of a matrix's cell, in inches
_MOST_NUMBERS = 16  # number of players up to which numbers in the cells are readable


def draw_tournament(tournament: Tournament, path: str | Path) -> None:
    """Draw `tournament_figure` into a PNG or SVG file, whole or not at all."""
    save_figure(tournament_figure(tournament), path)


def tournament_figure(tournament: Tournament) -> "Figure":
    """Return a heat map for each measure, and of opponents their ratings beside it.

    Raises:
      ImportError: if the extra `train` is not installed.
    """
    players = list(tournament.players)
    measures = tournament.measures
    if tournament.is_divided:
        players.sort(key=lambda name: -tournament.ratings[name].mean)
        measures = measures[:1]
    side = _CELL * max(4, len(players)) + 1.6
    panels = len(measures) + tournament.is_divided
    figure, axes = make_figure(1, panels, (side * panels, side))
    for own, measure in zip(axes, measures, strict=False):
        _draw_matrix(own, tournament, measure, players)
    if tournament.is_divided:
        _draw_ratings(axes[-1], tournament, players)
    episodes = tournament.settings["episodes"]
    title = f"{tournament.title}, {episodes} episodes for each pairing"
    figure.suptitle(title, x=0.01, horizontalalignment="left")
    return figure


def _draw_matrix(
    axes: "Axes", tournament: Tournament, measure: str, players: list[str]
) -> None:
    matrix, is_first = tournament.matrices[measure], measure == tournament.measures[0]
    means = np.array([[matrix[row][col].mean for col in players] for row in players])
    ends = (0.0, 1.0) if is_share(measure) else (None, None)
    drawn = axes.imshow(means, cmap="cividis", vmin=ends[0], vmax=ends[1])
    labels = [short_names(tournament.players)[player] for player in players]
    axes.set_xticks(range(len(players)), labels, rotation=45, ha="right")
    axes.set_yticks(range(len(players)), labels if is_first else [])
    rows, columns = "in one seat", "all others"
    if len(tournament.seats) == 2:
        rows, columns = tournament.seats
    axes.set_xlabel(columns)
    if is_first:
        axes.set_ylabel(rows)
    axes.set_title(f"{measure} (%)" if is_share(measure) else measure)
    # White on what is dark: cividis grows lighter.
    is_dark = np.asarray(drawn.norm(means)) < 0.5
    for place, mean in np.ndenumerate(means):
        if len(players) <= _MOST_NUMBERS and not np.isnan(mean):
            colour = "white" if is_dark[place] else "black"
            number = format_measure(measure, mean).removesuffix(" %")
            how = {"ha": "center", "va": "center", "fontsize": 8}
            axes.text(place[1], place[0], number, color=colour, **how)


def _draw_ratings(axes: "Axes", tournament: Tournament, players: list[str]) -> None:
    ratings: list[Statistic] = [tournament.ratings[player] for player in players]
    for i, rating in enumerate(ratings):
        axes.plot([rating.low, rating.high], [i, i], color=COLOURS[0], linewidth=2.0)
        axes.plot(rating.mean, i, "o", color=COLOURS[0])
    axes.set_ylim(len(players) - 0.5, -0.5)
    axes.set_yticks([])
    open_axes(axes)
    axes.spines["left"].set_visible(False)
    axes.set_title("rating, with 95 % intervals")
