"""MuJoCo's own window onto a world, in real time."""

import os
import sys
import time
from collections.abc import Sequence

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies import load_policy
from collaborative_gym.rendering import CAMERA
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Randomization

_SHOTS = 5
"""Pictures per control step."""


def view(
    env_id: str,
    policy: str = "random",
    seed: int = 0,
    robots: Sequence[str | Robot] | None = None,
    randomization: str | Randomization = "default",
) -> None:
    """Open a window in which a policy plays one episode after the other, until closed.

    Args:
      env_id: an environment id or a task's name.
      policy: a name for `load_policy`.
      seed: which episodes.
      robots: other arms than the environment's own, in the order of the agents.
      randomization: how starts are drawn.

    Raises:
      KeyError: if a name is unknown.
      RuntimeError: if there is no display.
    """
    task = make_task(env_id, robots, randomization)
    env = VectorEnv(task, 1, seed, num_threads=1)
    act = load_policy(policy, env)
    check_display()
    # Imported here because it opens the windowing system.
    from mujoco import viewer

    observations, _ = env.reset()
    model = env.scene.compile_to_draw()
    model.vis.global_.fovy = model.camera(CAMERA).fovy[0]
    data = mujoco.MjData(model)
    with viewer.launch_passive(
        model, data, show_left_ui=False, show_right_ui=False
    ) as window:
        _look_from_overview(model, data, window.cam)
        window.opt.sitegroup[:] = 0
        due = time.perf_counter()

        def show() -> None:
            nonlocal due
            with window.lock():
                data.qpos[:], data.mocap_pos[:] = env.sim.qpos[0], env.sim.mocap_pos[0]
                mujoco.mj_forward(model, data)
            window.sync()
            due = max(due + env.control_dt / _SHOTS, time.perf_counter())
            time.sleep(max(0.0, due - time.perf_counter()))

        env.watch(show, _SHOTS)
        while window.is_running():
            observations, *_ = env.step(act(observations))


def _look_from_overview(
    model: mujoco.MjModel, data: mujoco.MjData, camera: mujoco.MjvCamera
) -> None:
    """Put a free camera where the task's own stands, so that the mouse can turn it."""
    mujoco.mj_forward(model, data)
    overview = data.camera(CAMERA)
    forward = -overview.xmat.reshape(3, 3)[:, 2]
    distance = float(np.dot(model.stat.center - overview.xpos, forward))
    camera.lookat[:] = overview.xpos + distance * forward
    camera.distance = distance
    camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
    camera.elevation = np.degrees(np.arcsin(forward[2]))


def check_display() -> None:
    """Raise if no window can be opened.

    Raises:
      RuntimeError: says what to do instead.
    """
    variables = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(map(os.environ.get, variables)):
        raise RuntimeError(
            "there is no display to open a window on; make a video instead:"
            " collaborative-gym record ENV --output video.mp4"
        )
