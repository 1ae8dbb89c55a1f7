"""Draws the pictures of the arms, `docs/media/robots/`: python docs/draw_arms.py."""

from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

import collaborative_gym as cg
from collaborative_gym.pictures.rendering import CAMERA, Camera

FOLDER = Path(__file__).parent / "media" / "robots"
SIZE = 640, 480
RIGHT, UP = np.array([0.51, 0.86, 0.0]), np.array([-0.258, 0.153, 0.954])
"""Axes of the camera, which looks down from a side."""
FOV, MARGIN = 30, 0.45
"""Its field of view, in degrees, and the margin around the middles of parts, in m."""


def picture(robot: cg.Robot) -> np.ndarray:
    """Return an arm at home on its stand, (height, width, 3) uint8."""
    scene = cg.Scene()
    scene.add_robot(
        "robot_1", robot, placement=cg.Placement((0.0, 0.0, robot.base_height))
    )
    scene.spec.worldbody.add_camera(name=CAMERA, xyaxes=(*RIGHT, *UP), fovy=FOV)
    scene.compile()
    model = scene.compile_to_draw()
    data = mujoco.MjData(model)
    for joint, angle in zip(robot.joints, robot.home, strict=True):
        data.joint(f"robot_1/{joint}").qpos = angle
    mujoco.mj_kinematics(model, data)
    # What is above the stand fills the picture.
    parts = data.xpos[data.xpos[:, 2] > robot.base_height - 0.01]
    low, high = parts.min(axis=0), parts.max(axis=0)
    size = max(high[2] - low[2], np.ptp(parts @ RIGHT) / SIZE[0] * SIZE[1]) + MARGIN
    far = size / 2 / np.tan(np.radians(FOV / 2))
    model.cam_pos[0] = (low + high) / 2 + far * np.cross(RIGHT, UP)
    camera = Camera(model, *SIZE)
    pixels = camera.picture(data.qpos, np.zeros((model.nmocap, 3)))
    camera.close()
    return pixels


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in cg.list_robots():
        drawn = Image.fromarray(picture(cg.get_robot(name)))
        drawn.save(FOLDER / f"{name}.jpg", quality=88)
