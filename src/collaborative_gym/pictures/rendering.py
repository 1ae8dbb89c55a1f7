"""Off-screen pictures of a world."""

import warnings

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from collaborative_gym.scene.surroundings import CAMERA


class Camera:
    """An off-screen renderer that looks through a world's `overview` camera.

    Args:
      model: the world, from `Scene.compile_to_draw`.
      width: of the pictures, in pixels.
      height: of the pictures, in pixels.

    Raises:
      ValueError: if the picture is larger than the model's off-screen buffer.
      RuntimeError: if no renderer can start.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        limit = model.vis.global_.offwidth, model.vis.global_.offheight
        if not (0 < width <= limit[0] and 0 < height <= limit[1]):
            raise ValueError(
                f"a picture of {width} x {height} pixels cannot be drawn; its sides are"
                f" at least 1 and at most {limit[0]} x {limit[1]}"
            )
        self.size = (width, height)
        self._model = model
        self._data = mujoco.MjData(model)
        try:
            with warnings.catch_warnings(action="ignore"):  # The error says it all.
                self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:
            raise RuntimeError(
                "no off-screen renderer can start here; on Debian or Ubuntu install one"
                " with 'apt-get install libegl1 libgl1-mesa-dri' and set MUJOCO_GL=egl"
                f" (MuJoCo says: {error})"
            ) from error
        # Group 2 is what is seen, group 3 what collides.
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = (1, 1, 1, 0, 0, 0)
        self._options.sitegroup[:] = 0

    def picture(self, qpos: ArrayLike, mocap_pos: ArrayLike) -> np.ndarray:
        """Return a world as a (height, width, 3) uint8 picture.

        Args:
          qpos: its positions.
          mocap_pos: the places of its targets.
        """
        self._data.qpos[:], self._data.mocap_pos[:] = qpos, mocap_pos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, CAMERA, self._options)
        return self._renderer.render().copy()

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


def check_renderer() -> None:
    """Raise if no pictures can be drawn here.

    Raises:
      RuntimeError: if no renderer can start; says what to install.
    """
    Camera(mujoco.MjSpec().compile(), 64, 64).close()
