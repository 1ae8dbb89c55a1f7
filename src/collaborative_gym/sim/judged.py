"""Physics steps that are judged, and taken again where one of them was wrong.

All steps are taken at once. Only the worlds in which one was wrong, because it broke a
constraint or was too long for what happened in it, go back to the first such step. It
is mended alone, and then all that follow are taken again.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np
from mujoco import batch

from collaborative_gym.math import Array
from collaborative_gym.sim.sim import Breaks, Refined, Refinement

CURRENT = mujoco.mjtStage.mjSTAGE_VEL.value
"""Up to where sensors of positions, velocities and contacts are current."""

JUDGED = "qpos", "qvel", "sensordata"
"""The parts of judged steps that must be recorded."""


class Worlds:
    """The rows of a batch, live as in `Sim`, and how they take physics steps."""

    def __init__(self, rows: batch.Batch):
        self._batch, self.expand = rows, rows.expand
        self.state = rows.state
        self.qpos, self.qvel = rows.bind("qpos"), rows.bind("qvel")
        self.eq_active = rows.bind("eq_active")
        self.sensordata = rows.bind("sensordata")

    def roll(
        self, rows: np.ndarray | None, controls: Array, records: Mapping[str, Array]
    ) -> np.ndarray:
        """Advance worlds as `Steps` says; return which of them MuJoCo gave up."""
        every = slice(None) if rows is None else rows
        before, out = self._warnings(every), dict(records)
        failed, steps = np.zeros(len(self.state), bool), controls.shape[1]
        try:
            self._batch.rollout(steps, controls, record=tuple(out), ids=rows, out=out)
        except batch.SimulationError as error:
            failed[error.ids] = True
        return failed[every] | (self._warnings(every) > before)

    def sense(self, rows: np.ndarray | None) -> np.ndarray:
        """Make sensors current; return in which worlds MuJoCo gave up, (rows,)."""
        failed = np.zeros(len(self.state), bool)
        try:
            self._batch.forward(rows, stage=CURRENT)
        except batch.SimulationError as error:
            failed[error.ids] = True
        return failed if rows is None else failed[rows]

    def _warnings(self, rows: Any) -> np.ndarray:
        return self._batch.warning[rows, :, 1].sum(axis=1)


class Steps:
    """Some physics steps of some worlds, and how they are judged.

    Args:
      worlds: all worlds.
      rows: ids of those that take the steps; None for all.
      controls: (rows, steps, nu).
      records: where to record what the steps find, (rows, steps, ...) by MuJoCo's
        names; those of `JUDGED` among them.
      breaks: as in `Sim.step`.
      refinement: as in `Sim`.

    Attributes:
      failed: which worlds MuJoCo gave up, (rows,) booleans.
      refined: the steps that were refined.
    """

    def __init__(
        self,
        worlds: Worlds,
        rows: np.ndarray | None,
        controls: Array,
        records: dict[str, Array],
        *,
        breaks: Breaks | None,
        refinement: Refinement | None,
    ):
        self._worlds, self._rows, self._controls = worlds, rows, controls
        self._breaks, self._refinement = breaks, refinement
        self.records = records
        self.failed = np.zeros(len(controls), bool)
        self.refined: list[Refined] = []

    def take(self) -> None:
        """Take all steps at once; where one is wrong, mend it and go on from there."""
        state, steps = self._worlds.state, np.arange(self._controls.shape[1])
        left, start = np.arange(len(self.failed)), np.zeros(len(self.failed), int)
        before = state[self._ids(slice(None))].copy()
        self.failed = self._worlds.roll(self._rows, self._controls, self.records)
        broken, rough = self._judge(slice(None))
        while True:
            # What is judged of earlier steps was mended before.
            wrong = (broken | rough) & (steps >= start[:, None])
            found = np.flatnonzero(wrong.any(axis=1))
            if not len(found):
                return
            left, start, at = left[found], start[found], wrong[found].argmax(axis=1)
            state[self._ids(left)] = before[found]
            self._roll(left, start, at, {})
            self.failed[left] = False
            self._mend(left, at, broken[found, at])
            start = np.where(self.failed[left], len(steps), at + 1)
            before = state[self._ids(left)]
            self._roll(left, start, len(steps), self.records)
            broken, rough = self._judge(left)

    def _ids(self, left: Any) -> Any:
        return left if self._rows is None else self._rows[left]

    def _roll(
        self, left: np.ndarray, start: np.ndarray, end: Any, records: dict[str, Array]
    ) -> None:
        """Take steps of some worlds, from one each and before another; record them."""
        ends = np.broadcast_to(end, start.shape)
        for first, last in sorted(set(zip(start.tolist(), ends.tolist(), strict=True))):
            if first == last:
                continue
            group = left[(start == first) & (ends == last)]
            size, given = (len(group), last - first), records.items()
            found = {n: np.zeros((*size, *x.shape[2:]), x.dtype) for n, x in given}
            parts = self._ids(group), self._controls[group, first:last], found
            self.failed[group] |= self._worlds.roll(*parts)
            for name, array in found.items():
                records[name][group, first:last] = array

    def _judge(self, left: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return which steps break a constraint, and which need refinement.

        Both are (worlds, steps). It makes the sensors of these worlds current.
        """
        worlds, every = self._worlds, self._rows is None and isinstance(left, slice)
        ids = self._ids(left)
        self.failed[left] |= worlds.sense(None if every else ids)
        broken = self._broken(left, ids)
        if self._refinement is None:
            return broken, np.zeros_like(broken)
        records, refinement = self.records, self._refinement
        rough = refinement.strays(records["qpos"][left], records["qvel"][left])
        # A step finds the contacts of the state before it.
        deep = refinement.too_deep(records["sensordata"][left, 1:])
        rough[:, :-1] |= deep
        rough[:, -1] |= refinement.too_deep(worlds.sensordata[ids])
        return broken, rough

    def _broken(self, left: Any, ids: Any) -> np.ndarray:
        active = self._worlds.eq_active[ids] > 0
        if self._breaks is None or not active.any():
            return np.zeros((len(active), self._controls.shape[1]), bool)
        sensed = self.records["sensordata"][left]
        return np.any(self._breaks(sensed, active[:, None]), axis=2)

    def _mend(self, left: np.ndarray, at: np.ndarray, broken: np.ndarray) -> None:
        """Take a step that is wrong, of each world its own.

        Where a constraint breaks, the step may be right when it is taken without it.
        Everything else is refined.
        """
        worlds, refinement = self._worlds, self._refinement
        rough = ~broken
        if broken.any():
            again, rows = left[broken], self._ids(left[broken])
            kept = worlds.state[rows]
            self._take_intact(again, at[broken])
            if refinement is not None:
                self.failed[again] |= worlds.sense(rows)
                rough[broken] = refinement.strays(
                    worlds.qpos[rows], worlds.qvel[rows]
                ) | refinement.too_deep(worlds.sensordata[rows])
                refined = rough[broken]
                worlds.state[rows[refined]] = kept[refined]
        if refinement is not None and rough.any():
            self._refine(refinement, left[rough], at[rough])

    def _take_intact(self, left: np.ndarray, at: np.ndarray) -> None:
        """Take a step of each world, and again where it breaks a constraint.

        The second time it is without that constraint, so none ever bears too much.
        """
        worlds = self._worlds
        while len(left):
            rows = self._ids(left)
            kept = worlds.state[rows]
            found = {n: each[left, at][:, None] for n, each in self.records.items()}
            self.failed[left] = worlds.roll(
                rows, self._controls[left, at][:, None], found
            )
            for name, array in found.items():
                self.records[name][left, at] = array[:, 0]
            if self._breaks is None:
                return
            active = worlds.eq_active[rows] > 0
            broken = self._breaks(self.records["sensordata"][left, at], active)
            again = broken.any(axis=1)
            left, at, rows = left[again], at[again], rows[again]
            worlds.state[rows] = kept[again]
            worlds.eq_active[rows] *= ~broken[again]

    def _refine(self, refinement: Refinement, left: np.ndarray, at: np.ndarray) -> None:
        rows, count = self._ids(left), refinement.steps
        records = {
            name: np.zeros((len(left), count, *array.shape[2:]), array.dtype)
            for name, array in self.records.items()
        }
        controls = np.repeat(self._controls[left, at][:, None], count, axis=1)
        how = {"breaks": self._breaks, "refinement": refinement}
        short = _ShortSteps(self._worlds, rows, controls, records, **how)
        with self._shortened(refinement, rows):
            short.take()
        self.failed[left] = short.failed
        self.refined.append(Refined(rows, at, records))

    @contextmanager
    def _shortened(self, refinement: Refinement, rows: np.ndarray) -> Iterator[None]:
        """Give these worlds the model's numbers of short steps for a while."""
        usual = {name: self._worlds.expand(name) for name in refinement.fields}
        kept = {name: array[rows] for name, array in usual.items()}
        try:
            for name, short in refinement.fields.items():
                usual[name][rows] = short
            yield
        finally:
            for name, array in kept.items():
                usual[name][rows] = array


class _ShortSteps(Steps):
    """Short steps: one is wrong if it breaks a constraint or an arm gets too fast.

    An arm that is too fast once mostly is so again. So the worlds in which a step is
    wrong take all of them again, one after the other.
    """

    def take(self) -> None:
        worlds, records, refinement = self._worlds, self.records, self._refinement
        assert refinement is not None
        before = worlds.state[self._ids(slice(None))].copy()
        self.failed = worlds.roll(self._rows, self._controls, records)
        wrong = self._broken(slice(None), self._ids(slice(None)))
        wrong |= refinement.too_fast(records["qvel"])
        left = np.flatnonzero(wrong.any(axis=1))
        worlds.state[self._ids(left)] = before[left]
        for step in range(self._controls.shape[1]) if len(left) else ():
            rows = self._ids(left)
            start, self.failed[left] = worlds.qpos[rows], False
            self._take_intact(left, np.full(len(left), step))
            qpos, qvel = worlds.qpos[rows], worlds.qvel[rows]
            refinement.stop(start, qpos, qvel)
            worlds.qpos[rows], worlds.qvel[rows] = qpos, qvel
            records["qpos"][left, step], records["qvel"][left, step] = qpos, qvel
            left = left[~self.failed[left]]
