"""The call that compares training runs."""

from collections.abc import Sequence
from pathlib import Path

from collaborative_gym.comparisons.grouping import Grouping, group_runs
from collaborative_gym.comparisons.result import Comparison, is_share
from collaborative_gym.comparisons.runs import TrainedRun, find_runs
from collaborative_gym.errors import check_kind, look_up


def compare(
    runs: str | Path | Sequence[str | Path], *, measure: str | None = None
) -> Comparison:
    """Return how training runs did, grouped by the settings in which they differ.

    Runs with the same settings and different seeds are a group, and intervals are over
    their seeds. The differences are those of the settings with which the runs started.

    Args:
      runs: the folder of a run, or one that has runs in it at any depth, or several.
      measure: measure of the validations for performance profiles and probabilities of
        improvement; None for "completion", or the first that the runs have.

    Raises:
      FileNotFoundError: if there is no run in one of the folders.
      KeyError: if the validations have no such measure.
      OSError: if a file cannot be read.
      TypeError: if a folder is not a path.
      ValueError: if there is nothing to compare, a file is damaged, or a run is there
        twice.
    """
    a = "a folder's name, or several"
    check_kind("runs", runs, (str, Path, Sequence), a)
    found = find_runs([runs] if isinstance(runs, str | Path) else runs)
    validated = [run for run in found if run.rows]
    if not validated:
        raise ValueError(
            f"there is no validation yet in {len(found)} of {len(found)} runs; let them"
            " train for longer: there is one every --validation-interval steps"
        )
    grouping = group_runs(validated)
    measures = _measures(grouping)
    if measure is None:
        measure = next(filter(is_share, measures), measures[0])
    else:
        look_up("measure", measure, dict.fromkeys(measures))
    return Comparison(grouping, measures, measure, _notes(found))


def _measures(grouping: Grouping) -> tuple[str, ...]:
    """Return what all validations measured, shares first."""
    first, *others = (group.measures for group in grouping.groups)
    shared = [name for name in first if all(name in each for each in others)]
    if not shared:
        raise ValueError(
            "the runs' validations have no measure in common; compare those of tasks"
            " with one side and those of opponents apart"
        )
    return tuple(sorted(shared, key=lambda name: not is_share(name)))


def _notes(runs: Sequence[TrainedRun]) -> tuple[str, ...]:
    """Return what readers must know of runs that have not come to their end."""
    notes = []
    for run in runs:
        last = int(run.rows[-1]["steps"]) if run.rows else 0
        if not last:
            notes.append(f"{run.folder} is left out: it has no validation yet.")
        elif last < run.total_steps:
            notes.append(
                f"{run.folder} is not finished: its last validation is after"
                f" {last:,} of {run.total_steps:,} steps."
            )
    return tuple(notes)
