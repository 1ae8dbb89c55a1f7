"""The CPU backend: `mujoco.batch` on a pool of threads."""

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from typing import Any
from weakref import WeakSet

import mujoco
import numpy as np
from array_api_compat import array_namespace
from mujoco import batch

from collaborative_gym.errors import SimulationDiverged, UnknownName, unknown
from collaborative_gym.math import Array
from collaborative_gym.sim.sim import Breaks, EnvIds, Refined, Refinement

_CURRENT = mujoco.mjtStage.mjSTAGE_VEL.value
_NOTHING = mujoco.mjtStage.mjSTAGE_NONE.value
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class CpuSim:
    """Worlds as rows of a `mujoco.batch.Batch`; see `Sim` for the contract.

    The result is the same to the bit for any number of worlds and threads.

    Args:
      model: the compiled world.
      num_envs: how many worlds to hold.
      num_threads: threads to step them with; 0 for one per CPU.
      refinement: how physics steps are refined; None if they never are.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        num_threads: int = 0,
        refinement: Refinement | None = None,
    ):
        self.model, self.refinement = model, refinement
        self.num_envs = num_envs
        self._batch = batch.Batch(model, num_envs, num_threads)
        _living.add(self)
        self.qpos = self._batch.bind("qpos")
        self.xp = array_namespace(self.qpos)
        self.time = self._batch.bind("time")
        self.qvel = self._batch.bind("qvel")
        self.act = self._batch.bind("act")
        self.ctrl = self._batch.bind("ctrl")
        self.eq_active = self._batch.bind("eq_active")
        self.userdata = self._batch.bind("userdata")
        self.mocap_pos = self._batch.bind("mocap_pos")
        self.xfrc_applied = self._batch.bind("xfrc_applied")
        self.sensordata = self._batch.bind("sensordata")
        self._qpos, self._qvel, self._sensed = self.qpos, self.qvel, self.sensordata
        self._switches = self.eq_active
        self._sensors = self._named()
        self.refined: list[Refined] = []

    def _named(self) -> dict[str, np.ndarray]:
        """Return the columns of `sensordata` by the sensors' names."""
        sensors, model = {}, self.model
        for i in range(model.nsensor):
            start, size = model.sensor_adr[i], model.sensor_dim[i]
            sensors[model.sensor(i).name] = self.sensordata[:, start : start + size]
        return sensors

    def step(
        self,
        controls: Array,
        records: dict[str, Array] | None = None,
        breaks: Breaks | None = None,
    ) -> None:
        records, failed = records or {}, np.zeros(self.num_envs, bool)
        self.refined = []
        if breaks is None and self.refinement is None:
            self._advance(controls, records, failed)
            self.forward()
        else:
            self._step_judged(controls, records, failed, breaks)
        if failed.any():
            raise SimulationDiverged(np.flatnonzero(failed))

    def _step_judged(
        self,
        controls: Array,
        records: dict[str, Array],
        failed: np.ndarray,
        breaks: Breaks | None,
    ) -> None:
        """Take steps, in some worlds in a way of their own.

        Steps seldom break a constraint or need refinement: all are taken at once. Where
        one of them was wrong, it is taken alone, and then all that are left.
        """
        model, shape = self.model, controls.shape[:2]
        sizes = {"qpos": model.nq, "qvel": model.nv, "sensordata": model.nsensordata}
        blank = {name: np.zeros((*shape, size)) for name, size in sizes.items()}
        records = blank | records
        rows, start = np.arange(self.num_envs), np.zeros(self.num_envs, int)
        is_redone = np.zeros(self.num_envs, bool)
        while len(rows):
            before, active = self._batch.state[rows], self._switches[rows] > 0
            states = self._advance_from(start, controls, records, failed, rows)
            broken, rough = self._judge(records, active, failed, rows, breaks)
            # What is judged of earlier steps was mended before.
            wrong = (broken | rough) & (np.arange(shape[1]) >= start[:, None])
            at = wrong.argmax(axis=1)
            mended = np.flatnonzero(wrong.any(axis=1))
            rows, at = rows[mended], at[mended]
            is_first = (at == start[mended])[:, None]
            before = np.where(is_first, before[mended], states[mended, at - 1])
            self._batch.state[rows], failed[rows] = before, False
            whole = np.flatnonzero(broken[mended, at])
            self._advance_one(controls, records, failed, rows, at, whole, breaks)
            is_redone[rows] = True
            left = (at + 1 < shape[1]) & ~failed[rows]
            rows, start = rows[left], at[left] + 1
        if is_redone.any():
            self.forward(np.flatnonzero(is_redone))

    def _advance_from(
        self,
        start: np.ndarray,
        controls: Array,
        records: dict[str, Array],
        failed: np.ndarray,
        rows: np.ndarray,
    ) -> np.ndarray:
        """Take all physics steps of these worlds from one on, each world from its own.

        Returns:
          The state after each step, (worlds, steps, nstate), of steps before as it
          comes.
        """
        states = np.zeros((len(rows), controls.shape[1], self._batch.nstate))
        if len(rows) == self.num_envs and not start.any():
            self._advance(controls, records | {_STATE: states}, failed)
            return states
        for first in np.unique(start):
            group = np.flatnonzero(start == first)
            now = rows[group]
            found = {name: array[now, first:] for name, array in records.items()}
            own = found | {_STATE: states[group, first:]}
            self._advance(controls[now, first:], own, failed, now)
            states[group, first:] = own[_STATE]
            for name, array in found.items():
                records[name][now, first:] = array
        return states

    def _judge(
        self,
        records: dict[str, Array],
        active: np.ndarray,
        failed: np.ndarray,
        rows: np.ndarray,
        breaks: Breaks | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return which steps break a constraint, and which need refinement.

        Both are (worlds, steps). It makes the sensors of these worlds current.
        """
        sensed, refinement = records["sensordata"][rows], self.refinement
        broken, rough = np.zeros((2, *sensed.shape[:2]), bool)
        if breaks is not None and active.any():
            broken |= breaks(sensed, active[:, None]).any(axis=2)
        if refinement is None:
            self.forward(rows)
        else:
            # A step finds the contacts of the state before it.
            last = self._sense(rows, failed)
            after = np.concatenate([sensed[:, 1:], last[:, None]], axis=1)
            qpos, qvel = records["qpos"][rows], records["qvel"][rows]
            rough |= refinement.asks(qpos, qvel, after)
        return broken, rough

    def _sense(self, rows: np.ndarray, failed: np.ndarray) -> np.ndarray:
        """Return `sensordata` of these worlds, depths of contacts included."""
        try:
            self.forward(rows)
        except batch.SimulationError as error:
            failed[error.ids] = True
        return self._sensed[rows]

    def _advance_one(
        self,
        controls: Array,
        records: dict[str, Array],
        failed: np.ndarray,
        rows: np.ndarray,
        at: np.ndarray,
        whole: np.ndarray,
        breaks: Breaks | None,
    ) -> None:
        """Take a physics step that is wrong as it was taken, of each world its own.

        Args:
          controls: as in `step`.
          records: likewise.
          failed: (num_envs,), where worlds are marked that MuJoCo gives up.
          rows: the worlds.
          at: the index of each world's step.
          whole: where among these worlds a constraint breaks, so that the step may be
            right when it is taken whole and without it; all others are refined.
          breaks: as in `step`.
        """
        state, refinement = self._batch.state, self.refinement
        control = controls[rows, at]
        # The shapes of what one step finds.
        blank = {name: array[:, 0] for name, array in records.items()}
        rough = np.ones(len(rows), bool)
        if len(whole):
            now = rows[whole]
            kept = state[now]
            parts = control[whole], blank, failed, now, breaks
            for name, array in self._advance_intact(*parts).items():
                records[name][now, at[whole]] = array
            rough[whole] = False
            if refinement is not None:
                sensed = self._sense(now, failed)
                rough[whole] = refinement.asks(self._qpos[now], self._qvel[now], sensed)
            again = rough[whole]
            state[now[again]], failed[now[again]] = kept[again], False
        if refinement is not None and rough.any():
            parts = control[rough], blank, failed, rows[rough], breaks
            found = self._advance_refined(refinement, *parts)
            self.refined.append(Refined(rows[rough], at[rough], found))

    def _advance_refined(
        self,
        refinement: Refinement,
        control: Array,
        blank: dict[str, Array],
        failed: np.ndarray,
        rows: np.ndarray,
        breaks: Breaks | None,
    ) -> dict[str, np.ndarray]:
        """Take a step in these worlds as short ones, and return what those found."""
        shorts = []
        with self._shortened(refinement, rows):
            for _ in range(refinement.steps):
                before = self._qpos[rows]
                short = self._advance_intact(control, blank, failed, rows, breaks)
                qpos, qvel = self._qpos[rows], self._qvel[rows]
                refinement.stop(before, qpos, qvel)
                self._qpos[rows], self._qvel[rows] = qpos, qvel
                shorts.append(short | {"qpos": qpos, "qvel": qvel})
        return {
            name: np.stack([short[name] for short in shorts], axis=1) for name in blank
        }

    @contextmanager
    def _shortened(self, refinement: Refinement, rows: np.ndarray) -> Iterator[None]:
        """Give these worlds the model's numbers of short steps for a while."""
        usual = {name: self._batch.expand(name) for name in refinement.fields}
        kept = {name: array[rows] for name, array in usual.items()}
        try:
            for name, short in refinement.fields.items():
                usual[name][rows] = short
            yield
        finally:
            for name, array in kept.items():
                usual[name][rows] = array

    def _advance_intact(
        self,
        control: Array,
        blank: dict[str, Array],
        failed: np.ndarray,
        rows: np.ndarray,
        breaks: Breaks | None,
    ) -> dict[str, np.ndarray]:
        """Take a step in these worlds, and again where it breaks a constraint.

        The second time it is without that constraint, so none ever bears too much.

        Args:
          control: (worlds, nu).
          blank: arrays of all worlds, of the kinds of what is to be recorded.
          failed: (num_envs,), where worlds are marked that MuJoCo gives up.
          rows: the worlds.
          breaks: as in `step`.

        Returns:
          What the step found, (worlds, ...) by MuJoCo's names.
        """
        state, switches = self._batch.state, self._switches
        found = {name: np.zeros_like(array[rows]) for name, array in blank.items()}
        left = np.arange(len(rows))
        while len(left):
            now = rows[left]
            kept, was = state[now], failed[now]
            new = {name: array[left, None] for name, array in found.items()}
            self._advance(control[left, None], new, failed, now)
            for name, array in new.items():
                found[name][left] = array[:, 0]
            if breaks is None:
                break
            broken = breaks(found["sensordata"][left], switches[now] > 0)
            again = broken.any(axis=1)
            left, now = left[again], now[again]
            state[now], failed[now] = kept[again], was[again]
            switches[now] *= ~broken[again]
        return found

    def _advance(
        self,
        controls: Array,
        records: Mapping[Any, Array],
        failed: np.ndarray,
        rows: np.ndarray | None = None,
    ) -> None:
        """Advance these worlds, None for all, and mark those that MuJoCo gives up."""
        names, every = tuple(records), slice(None) if rows is None else rows
        before = self._warnings()[every]
        try:
            self._batch.rollout(
                controls.shape[1], controls, record=names, ids=rows, out=dict(records)
            )
        except batch.SimulationError as error:
            failed[error.ids] = True
        failed[every] |= self._warnings()[every] > before

    def _warnings(self) -> np.ndarray:
        """Return how often MuJoCo has warned of each world, (num_envs,).

        It warns of a state that is huge or not finite, for example. A rollout stops at
        any warning.
        """
        return self._batch.warning[:, :, 1].sum(axis=1)

    def forward(self, env_ids: EnvIds = None) -> None:
        self._batch.forward(env_ids, stage=_CURRENT)

    def reset(self, env_ids: EnvIds = None) -> None:
        self._batch.reset(env_ids, stage=_NOTHING)

    def get_state(self, env_ids: EnvIds = None) -> np.ndarray:
        rows = slice(None) if env_ids is None else env_ids
        return self._batch.state[rows].copy()

    def set_state(self, state: Array, env_ids: EnvIds = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self._batch.state[rows] = state
        self.forward(env_ids)

    def vary(self, env_ids: EnvIds, factors: Mapping[str, np.ndarray]) -> None:
        for name, factor in factors.items():
            varied = self._batch.expand(name)
            varied[env_ids] = getattr(self.model, name) * factor
        self._batch.set_const(env_ids)

    def limits(self, servos: slice | np.ndarray) -> np.ndarray:
        varied = self._batch.expanded("actuator_forcerange")
        every = self.model.actuator_forcerange[None] if varied is None else varied
        return every[:, servos, 1]

    def seen(self, qpos: np.ndarray, sensordata: np.ndarray) -> "CpuSim":
        view = copy(self)
        view.qpos, view.sensordata = qpos, sensordata
        view._sensors = view._named()
        return view

    def pose(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        return self._pair("pose", name, "position", "quat")

    def velocity(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        return self._pair("velocity", name, "linear", "angular")

    def _pair(
        self, kind: str, name: str, first: str, second: str
    ) -> tuple[np.ndarray, np.ndarray]:
        if f"{name}.{first}" not in self._sensors:
            read = [key.rpartition(".") for key in self._sensors]
            names = [own for own, _, part in read if part == first]
            raise UnknownName(
                f"{unknown(kind, name, names)}; in build(), add_{kind}_sensor() lets"
                " another site be read"
            )
        pair = self._sensors[f"{name}.{first}"], self._sensors[f"{name}.{second}"]
        return pair[0].copy(), pair[1].copy()

    def jacobian(
        self, body: int, point: Array, env_ids: EnvIds = None
    ) -> tuple[np.ndarray, np.ndarray]:
        return self._batch.jac(body, point, env_ids)

    @property
    def site_xpos(self) -> np.ndarray:
        """Positions of all sites, (num_envs, nsite, 3); copied out from now on."""
        return self._batch.bind("site_xpos")

    @property
    def site_xmat(self) -> np.ndarray:
        """Their rotation matrices, (num_envs, nsite, 9)."""
        return self._batch.bind("site_xmat")

    @property
    def geom_xpos(self) -> np.ndarray:
        """Positions of all geoms, (num_envs, ngeom, 3); copied out from now on."""
        return self._batch.bind("geom_xpos")

    def data(self, env_id: int) -> mujoco.MjData:
        data = self._batch.get_data(env_id)
        mujoco.mj_forward(self.model, data)
        return data


_living: WeakSet[CpuSim] = WeakSet()


def _keep_inherited() -> None:
    """Keep a forked process from freeing what it inherited, even as it ends.

    A batch that is freed waits for its threads, which only the first process has.
    """
    for sim in _living:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(sim._batch))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_inherited)
