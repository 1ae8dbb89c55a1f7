"""Figures without a window, and their common look."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from collaborative_gym.errors import how_to_install
from collaborative_gym.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
COLOURS += ("#56b4e9", "#e69f00", "#8c6bb1", "#7f7f7f")
"""Colours of lines, in order: Okabe and Ito's, for all eyes, and two more."""

GRID = "#dddddd"
"""Colour of the grid."""


def looking(settings: Mapping[Any, Any]) -> AbstractContextManager[None]:
    """Return a context in which Matplotlib draws by these settings.

    Raises:
      ImportError: if the extra `train` is not installed.
    """
    try:
        from matplotlib import rc_context
    except ImportError:
        raise ImportError(
            "pictures need matplotlib, which is not installed;"
            f" {how_to_install('train')}"
        ) from None
    return rc_context({**settings})


def make_figure(
    rows: int, columns: int, size: Sequence[float], **options: Any
) -> tuple["Figure", list["Axes"]]:
    """Return a figure of a size in inches, and its axes, line by line.

    Further options are those of Matplotlib's `subplots`.

    Raises:
      ImportError: if the extra `train` is not installed.
    """
    looking({})
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size[0], size[1]), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, list(axes.flat)


def save_figure(figure: "Figure", path: str | Path, **options: Any) -> None:
    """Write a figure into a file, whole or not at all; the suffix says the kind."""
    with replacing(path) as partial:
        figure.savefig(partial, **options)


def open_axes(axes: "Axes") -> None:
    """Give axes a pale grid behind the lines, and no frame above and at the right."""
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
