"""The CPU backend: `mujoco.batch` on a pool of threads."""

import ctypes
import os
from collections.abc import Mapping
from copy import copy
from weakref import WeakSet

import mujoco
import numpy as np
from array_api_compat import array_namespace
from mujoco import batch

from collaborative_gym.errors import SimulationDiverged, UnknownName, unknown
from collaborative_gym.math import Array
from collaborative_gym.sim.sim import Breaks, EnvIds

_CURRENT = mujoco.mjtStage.mjSTAGE_VEL.value
_NOTHING = mujoco.mjtStage.mjSTAGE_NONE.value
_NO_CONSTRAINTS = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


class CpuSim:
    """Worlds as rows of a `mujoco.batch.Batch`; see `Sim` for the contract.

    The result is the same to the bit for any number of worlds and threads.

    Args:
      model: the compiled world.
      num_envs: how many worlds to hold.
      num_threads: threads to step them with; 0 for one per CPU.
    """

    def __init__(self, model: mujoco.MjModel, num_envs: int, num_threads: int = 0):
        self.model = model
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
        self._switches = self.eq_active
        self._flags = self._batch.expand("opt.disableflags")
        self._sensors = self._named()

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
        before, records = self._warnings(), records or {}
        failed, active = np.zeros(self.num_envs, bool), self._switches > 0
        if breaks is None or not active.any():
            self._advance(controls, records, failed)
        else:
            # Constraints seldom break: all steps are taken at once, and again one by
            # one in the worlds where that was wrong.
            shape = *controls.shape[:2], self.model.nsensordata
            records = {"sensordata": np.zeros(shape)} | records
            state = self._batch.state.copy()
            self._advance(controls, records, failed)
            wrong = breaks(records["sensordata"], active[:, None])
            rows = np.flatnonzero(wrong.any(axis=(1, 2)))
            self._batch.state[rows] = state[rows]
            before[rows], failed[rows] = self._warnings()[rows], False
            for i in range(controls.shape[1]):
                now = slice(i, i + 1)
                one = {name: array[:, now] for name, array in records.items()}
                self._advance_one(controls[:, now], one, failed, rows, breaks)
        self.forward()
        failed |= self._warnings() > before
        if failed.any():
            raise SimulationDiverged(np.flatnonzero(failed))

    def _advance_one(
        self,
        control: Array,
        records: dict[str, Array],
        failed: np.ndarray,
        rows: np.ndarray,
        breaks: Breaks,
    ) -> None:
        """Take a physics step in these worlds, and again where it breaks a constraint.

        The second time it is without that constraint, so none ever bears too much.
        """
        state, switches = self._batch.state, self._switches
        while len(rows):
            kept = state[rows]
            found = {
                name: np.zeros_like(array[rows]) for name, array in records.items()
            }
            self._advance(control[rows], found, failed, rows)
            for name, array in found.items():
                records[name][rows] = array
            broken = breaks(found["sensordata"][:, 0], switches[rows] > 0)
            again = broken.any(axis=1)
            rows = rows[again]
            state[rows] = kept[again]
            switches[rows] *= ~broken[again]

    def _advance(
        self,
        controls: Array,
        records: dict[str, Array],
        failed: np.ndarray,
        rows: np.ndarray | None = None,
    ) -> None:
        """Advance these worlds, None for all, and mark those that MuJoCo gives up."""
        names = tuple(records)
        try:
            self._batch.rollout(
                controls.shape[1], controls, record=names, ids=rows, out=records
            )
        except batch.SimulationError as error:
            failed[error.ids] = True

    def _warnings(self) -> np.ndarray:
        """Return how often MuJoCo has warned of each world, (num_envs,).

        It warns of a state that is huge or not finite, for example. A rollout stops at
        any warning.
        """
        return self._batch.warning[:, :, 1].sum(axis=1)

    def forward(self, env_ids: EnvIds = None) -> None:
        # Sensors of places and speeds need no contacts, which are the slowest part.
        self._flags |= _NO_CONSTRAINTS
        try:
            self._batch.forward(env_ids, stage=_CURRENT)
        finally:
            self._flags &= ~_NO_CONSTRAINTS

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
