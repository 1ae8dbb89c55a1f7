"""Draws the pictures of tasks without a baseline: python docs/draw_tasks.py.

They go into `docs/media/`, two beside each other in each, under the task's name.
"""

from pathlib import Path

import numpy as np
from PIL import Image

import collaborative_gym as cg

SIZE = 480, 360

PICTURES = {
    "hockey": (("HockeyPandas-v0", 14), ("HockeyDoubles-v0", 14)),
    "tug": (("TugPandas-v0", 12), ("TugPandaSawyer-v0", 30)),
    "balancepath": (("BalancePathSawyers-v0", 20), ("BalancePathJacoSawyer-v0", 60)),
}
"""By name: the environments, and after how many control steps of the expert."""


def picture(env_id: str, steps: int) -> np.ndarray:
    """Return what the scripted player does then, (height, width, 3) uint8."""
    env = cg.make_vec(env_id, 1, seed=1, num_threads=1)
    env.reset()
    for _ in range(steps):
        env.step(env.expert())
    pixels = env.render(0, width=SIZE[0], height=SIZE[1])
    env.close()
    return pixels


if __name__ == "__main__":
    for name, pair in PICTURES.items():
        pixels = np.concatenate([picture(*each) for each in pair], axis=1)
        path = Path(__file__).parent / "media" / f"{name}.jpg"
        Image.fromarray(pixels).save(path, quality=88)
