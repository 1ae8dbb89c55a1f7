"""The CPU backend: `mujoco.batch` on a pool of threads."""

import ctypes
import os
from collections.abc import Collection, Mapping
from copy import copy
from weakref import WeakSet

import mujoco
import numpy as np
from mujoco import batch

from collaborative_gym.errors import SimulationDiverged, UnknownName, unknown
from collaborative_gym.math import Array, array_namespace
from collaborative_gym.quiet import quiet
from collaborative_gym.sim.judged import CURRENT, JUDGED, Steps, Worlds
from collaborative_gym.sim.sim import Breaks, EnvIds, Refined, Refinement

_NOTHING = mujoco.mjtStage.mjSTAGE_NONE.value


class CpuSim:
    """Worlds as rows of a `mujoco.batch.Batch`; see `Sim` for the contract.

    Bits are the same for any number of worlds and threads; with 0, one per CPU.
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
        bind = self._batch.bind
        self.time, self.qpos, self.qvel = bind("time"), bind("qpos"), bind("qvel")
        self.act, self.ctrl, self.userdata = bind("act"), bind("ctrl"), bind("userdata")
        self.eq_active, self.mocap_pos = bind("eq_active"), bind("mocap_pos")
        self.xfrc_applied, self.sensordata = bind("xfrc_applied"), bind("sensordata")
        self.xp = array_namespace(self.qpos)
        self._worlds = Worlds(self._batch)
        self._find_sensors()
        self.memory: dict[str, Array] = {}
        self.refined: list[Refined] = []
        # What judged steps find, which every call writes anew.
        self._records = {name: np.empty((0, 0, 0)) for name in JUDGED}
        self._own_model: mujoco.MjModel | None = None

    def _find_sensors(self) -> None:
        """Find the columns of `sensordata` that `pose` and `velocity` read."""
        columns = {
            self.model.sensor(i).name: self.sensordata[:, start : start + size]
            for i, (start, size) in enumerate(
                zip(self.model.sensor_adr, self.model.sensor_dim, strict=True)
            )
        }

        def pairs(first: str, second: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
            names = [n.removesuffix(first) for n in columns if n.endswith(first)]
            return {n: (columns[n + first], columns[n + second]) for n in names}

        self._poses = pairs(".position", ".quat")
        self._velocities = pairs(".linear", ".angular")

    @quiet()
    def step(
        self,
        controls: Array,
        records: dict[str, Array] | None = None,
        breaks: Breaks | None = None,
        env_ids: EnvIds = None,
    ) -> None:
        rows = None if env_ids is None else np.arange(self.num_envs)[env_ids]
        found, given = self._records, records or {}
        if found["qpos"].shape[:2] != controls.shape[:2]:
            sizes = {name: self._batch.bind(name).shape[1] for name in JUDGED}
            found = {n: np.empty((*controls.shape[:2], k)) for n, k in sizes.items()}
            self._records = found
        if rows is None:
            found = found | given
        else:
            found = {name: each[rows] for name, each in (found | given).items()}
            controls = controls[rows]
        how = {"breaks": breaks, "refinement": self.refinement}
        steps = Steps(self._worlds, rows, controls, found, **how)
        steps.take()
        self.refined = steps.refined
        if rows is not None:
            for name, each in given.items():
                each[rows] = found[name]
        if steps.failed.any():
            ids = np.flatnonzero(steps.failed)
            raise SimulationDiverged(ids if rows is None else rows[ids])

    @quiet()
    def roll(self, controls: Array) -> None:
        """Take physics steps and nothing else, which leaves sensors stale.

        Args:
          controls: as in `step`, of all worlds.
        """
        self._batch.rollout(controls.shape[1], controls, record=())

    @quiet()
    def forward(self, env_ids: EnvIds = None) -> None:
        self._batch.forward(env_ids, stage=CURRENT)

    @quiet()
    def feel(self) -> None:
        kept = self._batch.state.copy()
        self._batch.forward()
        # Nothing of what the solver found may change the steps to come.
        self._batch.state[:] = kept

    def reset(self, env_ids: EnvIds = None) -> None:
        self._batch.reset(env_ids, stage=_NOTHING)

    def get_state(self, env_ids: EnvIds = None) -> np.ndarray:
        rows = slice(None) if env_ids is None else env_ids
        return self._batch.state[rows].copy()

    def set_state(self, state: Array, env_ids: EnvIds = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self._batch.state[rows] = state
        self.forward(env_ids)

    @quiet()
    def vary(self, env_ids: EnvIds, factors: Mapping[str, np.ndarray]) -> None:
        for name, factor in factors.items():
            varied = self._batch.expand(name)
            varied[env_ids] = getattr(self.model, name) * factor
        self._batch.set_const(env_ids)

    def expand(self, name: str) -> np.ndarray:
        return self._batch.expand(name)

    def limits(self, servos: slice | np.ndarray) -> np.ndarray:
        varied = self._batch.expanded("actuator_forcerange")
        every = self.model.actuator_forcerange[None] if varied is None else varied
        return every[:, servos, 1]

    def seen(self, qpos: np.ndarray, sensordata: np.ndarray) -> "CpuSim":
        view = copy(self)
        view.qpos, view.sensordata = qpos, sensordata
        view.memory = dict(self.memory)
        view._find_sensors()
        return view

    def pose(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        try:
            position, quat = self._poses[name]
        except KeyError:
            raise _unread("pose", name, self._poses) from None
        return position.copy(), quat.copy()

    def velocity(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        try:
            linear, angular = self._velocities[name]
        except KeyError:
            raise _unread("velocity", name, self._velocities) from None
        return linear.copy(), angular.copy()

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

    def own_model(self, env_id: int) -> mujoco.MjModel:
        places = self._batch.expanded("site_pos")
        if places is None:
            return self.model
        model = self._own_model = self._own_model or copy(self.model)
        model.site_pos[:] = places[env_id]
        model.site_quat[:] = self._batch.expand("site_quat")[env_id]
        return model

    def data(self, env_id: int) -> mujoco.MjData:
        data = self._batch.get_data(env_id)
        with quiet():
            mujoco.mj_forward(self.model, data)
        return data


def _unread(kind: str, name: str, names: Collection[str]) -> UnknownName:
    return UnknownName(
        f"{unknown(kind, name, names)}; in build(), add_{kind}_sensor() lets another"
        " site be read"
    )


_living: WeakSet[CpuSim] = WeakSet()


def _keep_inherited() -> None:
    """Keep a forked process from freeing what it inherited, even as it ends.

    A batch that is freed waits for its threads, which only the first process has.
    """
    for sim in _living:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(sim._batch))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_inherited)
