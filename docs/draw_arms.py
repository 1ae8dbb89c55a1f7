"""Draws the pictures of the arms, `docs/media/robots/`: python docs/draw_arms.py."""

from pathlib import Path

import numpy as np
from PIL import Image

import collaborative_gym as cg
from collaborative_gym.pictures.rendering import CAMERA, Camera

FOLDER = Path(__file__).parent / "media" / "robots"
SIZE = 640, 480


def picture(robot: cg.Robot) -> np.ndarray:
    """Return an arm at home on its stand, (height, width, 3) uint8."""
    scene = cg.Scene()
    scene.add_robot(
        "robot_1", robot, placement=cg.Placement((0.0, 0.0, robot.base_height))
    )
    middle = robot.base_height + 0.25
    scene.spec.worldbody.add_camera(
        name=CAMERA,
        pos=(2.2, -1.3, middle + 0.25),
        xyaxes=(0.51, 0.86, 0, -0.05, 0.03, 1),
        fovy=33,
    )
    scene.compile()
    model = scene.compile_to_draw()
    qpos = np.array(model.qpos0)
    for joint, angle in zip(robot.joints, robot.home, strict=True):
        qpos[model.joint(f"robot_1/{joint}").qposadr] = angle
    camera = Camera(model, *SIZE)
    pixels = camera.picture(qpos, np.zeros((model.nmocap, 3)))
    camera.close()
    return pixels


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in cg.list_robots():
        drawn = Image.fromarray(picture(cg.get_robot(name)))
        drawn.save(FOLDER / f"{name}.jpg", quality=88)
