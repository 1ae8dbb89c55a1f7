"""Charts of an episode so far: the terms of the reward, and the measures."""

import time
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import viser

from collaborative_gym.viewer.session import Frame

_PAUSE = 0.5
"""Time between two pictures of a chart, in s of the user's time."""

_COLORS = "#c92a2a", "#1971c2", "#2f9e44", "#e8590c", "#6741d9", "#0c8599", "#a61e4d"

_HEIGHT = 200
"""Height of a chart, in pixels."""

_MEASURED = "measured"
"""Title of the chart of measures."""


class Plots:
    """Charts over an episode's time, one of each agent's reward and one of measures."""

    def __init__(self, gui: viser.GuiApi, tab: viser.GuiTabHandle):
        self._gui, self._tab = gui, tab
        self._charts: dict[tuple[str, ...], viser.GuiUplotHandle] = {}
        self._drawn: Frame | None = None
        self._next = 0.0

    def refresh(self, film: Sequence[Frame]) -> None:
        """Draw an episode so far, unless it was drawn just now."""
        now = time.monotonic()
        if film[-1] is self._drawn or now < self._next:
            return
        self._drawn, self._next = film[-1], now + _PAUSE
        rows = [_curves(frame) for frame in film]
        titles = {(title, *curves): title for title, curves in rows[0].items()}
        if titles.keys() != self._charts.keys():
            for chart in self._charts.values():
                chart.remove()
            self._charts = {key: self._add(*key) for key in titles}
        times = np.array([frame.reading.time for frame in film])
        for key, title in titles.items():
            # A start has no reward yet.
            first = int(title != _MEASURED and len(rows) > 1)
            curves = np.array([list(row[title].values()) for row in rows[first:]])
            self._charts[key].data = (times[first:], *np.ascontiguousarray(curves.T))

    def _add(self, title: str, *names: str) -> viser.GuiUplotHandle:
        series: list[Any] = [
            {"label": name, "stroke": color, "width": 2}
            for name, color in zip(names, cycle(_COLORS), strict=False)
        ]
        with self._tab:
            return self._gui.add_uplot(
                (np.zeros(1),) * (1 + len(names)),
                ({"label": "time, s"}, *series),
                title=title,
                scales={"x": {"time": False}},
                height=_HEIGHT,
            )


def _curves(frame: Frame) -> Mapping[str, Mapping[str, float]]:
    """Return what to draw of a control step, by chart and by name."""
    reading = frame.reading
    charts = {f"reward of {agent}": own for agent, own in reading.rewards.items()}
    units = {name: f", {unit}" for name, unit in reading.units.items()}
    charts[_MEASURED] = {
        f"{name}{units.get(name, '')}": value
        for name, value in reading.measures.items()
        if not isinstance(value, bool)
    }
    return {title: curves for title, curves in charts.items() if curves}
