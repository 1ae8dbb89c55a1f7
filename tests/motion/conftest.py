import runpy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from collaborative_gym import robots
from collaborative_gym.robots import get_robot, list_robots
from collaborative_gym.scene import Placement, Scene

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_arm.py"


@pytest.fixture(params=list_robots())
def scene(request):
    scene = Scene()
    robot = get_robot(request.param)
    scene.add_robot("robot_1", robot, placement=Placement((0.3, -0.2, 1.0), 0.7))
    return scene


@pytest.fixture
def tcp_pose():
    """Return a function that says where MuJoCo puts an arm's tcp."""

    def pose(model, arm, angles):
        data = mujoco.MjData(model)
        data.qpos[arm.qpos] = angles
        mujoco.mj_forward(model, data)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[arm.tcp])
        return data.site_xpos[arm.tcp].copy(), quat

    return pose


@pytest.fixture
def pair(monkeypatch):
    """Return a world of two arms, one with seven joints and one with six."""
    monkeypatch.setattr(robots, "_ROBOTS", dict(robots._ROBOTS))
    six = runpy.run_path(str(EXAMPLE))["OWN"]
    scene = Scene()
    scene.add_robot("robot_1", get_robot("jaco"), placement=Placement((0.0, -1.0, 0.7)))
    scene.add_robot("robot_2", six, placement=Placement((0.1, 1.0, 1.0), 2.0))
    return scene
