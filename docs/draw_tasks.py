"""Draws the pictures of tasks that have no film: python docs/draw_tasks.py [NAME ...].

They go into `docs/media/`, under the names of `PICTURES`; those that are named, or all.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import collaborative_gym as cg

DOCS = Path(__file__).parent
SIZE = 480, 360

PICTURES = {
    "hockey": (("HockeyPandas-v0", None, 14), ("HockeyDoubles-v0", None, 14)),
    "tug": (("TugPandas-v0", None, 12), ("TugPandaSawyer-v0", None, 30)),
    "balancepath": (
        ("BalancePathSawyers-v0", None, 20),
        ("BalancePathJacoSawyer-v0", None, 60),
    ),
    "simple_pick": (("SimplePick-v0", None, 8), ("SimplePick-v0", None, 20)),
    "own_arm": (("Pass", ("own", "panda"), 16), ("Lift", ("own", "panda"), 20)),
}
"""By name: the worlds side by side, each with its arms, and the expert's steps."""


def picture(env_id: str, robots: tuple[str, ...] | None, steps: int) -> np.ndarray:
    """Return what the scripted player does then, (height, width, 3) uint8."""
    env = cg.make_vec(env_id, 1, robots=robots, seed=1, num_threads=1)
    env.reset()
    for _ in range(steps):
        env.step(env.expert())
    pixels = env.render(0, width=SIZE[0], height=SIZE[1])
    env.close()
    return pixels


if __name__ == "__main__":
    for example in ("simple_pick", "own_arm"):
        cg.load_module(str(DOCS.parent / "examples" / f"{example}.py"))
    for name in sys.argv[1:] or PICTURES:
        pixels = np.concatenate([picture(*each) for each in PICTURES[name]], axis=1)
        Image.fromarray(pixels).save(DOCS / "media" / f"{name}.jpg", quality=88)
