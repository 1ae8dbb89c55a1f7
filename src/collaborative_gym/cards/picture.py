"""The pictures of a report card: what is done, when, and what disturbs it."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from collaborative_gym.cards.card import ReportCard
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import how_to_install
from collaborative_gym.files import replacing
from collaborative_gym.policies import AnyPolicy, as_policy
from collaborative_gym.tasks.task import Task

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FRAMES = 4
_SIZE = 320, 240
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
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError(
            "pictures of report cards need matplotlib, which is not installed;"
            f" {how_to_install('train')}"
        ) from None
    panels = [_draw_times, _draw_robustness] if card.robustness else [_draw_times]
    size = _PLOT[0] * len(panels), _PLOT[1]
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, draw in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        draw(axes, card)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#dddddd", linewidth=0.6)
        axes.set_axisbelow(True)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=120)


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


def draw_strip(task: Task, policy: AnyPolicy, path: str | Path, seed: int = 0) -> None:
    """Draw the first episode of a seed, from its start to success, into a PNG.

    If it never succeeds, the strip goes to its end.

    Args:
      task: what to do.
      policy: who plays.
      path: the file.
      seed: which episode.

    Raises:
      ImportError: if the extra `train` is not installed.
      OSError: if the file cannot be written.
      RuntimeError: if no off-screen renderer can start.
    """
    try:
        from matplotlib.image import imsave
    except ImportError:
        raise ImportError("pictures of report cards need matplotlib") from None
    env = VectorEnv(task, 1, seed=seed, num_threads=1, auto_reset=False)
    with closing(env):
        act = as_policy(policy, env, any_env=True)
        observations, infos = env.reset()
        states = [env.get_state()]
        while not infos["ended"][0]:
            observations, *_, infos = env.step(act(observations))
            states.append(env.get_state())
            if np.any(infos["metrics"]["completion"]):
                break
        width, height = _SIZE
        frames = []
        for i in np.linspace(0, len(states) - 1, _FRAMES).astype(int):
            env.set_state(states[i])
            frames.append(env.render(width=width, height=height))
    with replacing(path) as partial:
        imsave(partial, np.concatenate(frames, axis=1), format="png")
