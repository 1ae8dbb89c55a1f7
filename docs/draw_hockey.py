"""Draws the picture of Hockey, `docs/media/hockey.jpg`: python docs/draw_hockey.py."""

from pathlib import Path

import numpy as np
from PIL import Image

import collaborative_gym as cg

SIZE = 480, 360


def picture(env_id: str, *, steps: int) -> np.ndarray:
    """Return what the scripted player does then, (height, width, 3) uint8."""
    env = cg.make_vec(env_id, 1, seed=1, num_threads=1)
    env.reset()
    for _ in range(steps):
        env.step(env.expert())
    pixels = env.render(0, width=SIZE[0], height=SIZE[1])
    env.close()
    return pixels


if __name__ == "__main__":
    pair, team = (
        picture(f"Hockey{arms}-v0", steps=14) for arms in ("Pandas", "Doubles")
    )
    path = Path(__file__).parent / "media" / "hockey.jpg"
    Image.fromarray(np.concatenate([pair, team], axis=1)).save(path, quality=88)
