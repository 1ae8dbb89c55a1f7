"""A user's pull at a body."""

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv


class Spring:
    """The force of a user's pull on one of the worlds, beside all other forces.

    Attributes:
      strength: of the force in N, 0 without a pull.
    """

    def __init__(self, env: VectorEnv):
        self._sim, self._model = env.sim, env.model
        self._data = mujoco.MjData(env.model)
        self._scene = mujoco.MjvScene(env.model, 100)
        self._pulled: tuple[tuple[int, int], np.ndarray, np.ndarray] | None = None
        self.strength = 0.0

    def forget(self) -> None:
        """Leave the forces as they are, as after a reset, which clears them."""
        self._pulled, self.strength = None, 0.0

    def pull(self, perturb: mujoco.MjvPerturb | None, world: int = 0) -> None:
        """Let MuJoCo's spring, and no other, act from now on; None lets go.

        Where its `localmass` is 0 it is new, and gets the mass at which it pulls.
        """
        forces = self._sim.xfrc_applied
        if self._pulled is not None:
            at, before, written = self._pulled
            # If it differs, the task has set it since.
            is_ours = forces[at] == written
            forces[at] = np.where(is_ours, before, forces[at])
            self.forget()
        if perturb is None or not perturb.active or perturb.select <= 0:
            return
        at = world, perturb.select
        before = forces[at].copy()
        forces[at] += (force := self._force(perturb, world))
        self.strength = float(np.linalg.norm(force[:3]))
        self._pulled = at, before, forces[at].copy()

    def _force(self, perturb: mujoco.MjvPerturb, world: int) -> np.ndarray:
        """Return force and torque on the pulled body, (6,) in N and N m."""
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:] = self._sim.qpos[world], self._sim.qvel[world]
        mujoco.mj_forward(model, data)
        if perturb.localmass == 0:
            target = perturb.refselpos.copy()
            # MuJoCo looks at the scene's camera, which an update sets.
            options, camera = mujoco.MjvOption(), mujoco.MjvCamera()
            category = mujoco.mjtCatBit.mjCAT_DYNAMIC.value
            mujoco.mjv_updateScene(
                model, data, options, None, camera, category, self._scene
            )
            mujoco.mjv_initPerturb(model, data, self._scene, perturb)
            perturb.refselpos[:] = target
        data.xfrc_applied[:] = 0.0
        mujoco.mjv_applyPerturbForce(model, data, perturb)
        return data.xfrc_applied[perturb.select]
