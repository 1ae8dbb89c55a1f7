"""Draws the README's moving picture, `docs/media/tour.gif`: python docs/draw_tour.py.

All ten tasks play side by side. A second after a success each goes on to its next
start.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import collaborative_gym as cg

SIZE = 288, 162
BAND = 34
STEPS, HOLD = 78, 10
"""Pictures, which are control steps, and how long a success is shown."""

TOUR = {
    "PokeTaskPandaSawyer-v0": ("Poke: a stick, a ring", "baseline", (1.1, 0.42)),
    "LiftTaskSawyers-v0": ("Lift: too heavy for one", "baseline", (1.35, 0.42)),
    "PassTaskJacoSawyer-v0": ("Pass: hand to hand", "baseline", (1.0, 0.5)),
    "BalanceTaskJacoSawyer-v0": ("Balance: keep the ball", "baseline", (1.3, 0.36)),
    "BalancePathPandas4-v0": ("BalancePath: roll along", "baseline", (1.1, 0.48)),
    "ReachPandas4-v0": ("Reach: ways that cross", "baseline", (1.0, 0.5)),
    "SortPandas4-v0": ("Sort: by colour", "baseline", (1.2, 0.5)),
    "AssemblePandas3-v0": ("Assemble: three parts", "baseline", (1.15, 0.5)),
    "HockeyPandas-v0": ("Hockey: one on one", "baseline", (1.3, 0.4)),
    "TugPandas-v0": ("Tug: who is stronger?", "baseline", (1.3, 0.4)),
}
"""What is played, by environment: the caption, who plays, and how much larger than the
whole picture its part is drawn, whose middle is so far down."""

WHO = {"baseline": "trained", "expert": "scripted"}


def film(
    env_id: str, caption: str, player: str, part: tuple[float, float]
) -> list[np.ndarray]:
    """Return the pictures of some starts, (height, width, 3) uint8 each."""
    env = cg.make_vec(env_id, 1, seed=1, num_threads=1)
    policy = cg.load_policy(player, env)
    observations, infos = env.reset()
    frames, left = [], HOLD
    width, height = (round(part[0] * side) for side in SIZE)
    right = (width - SIZE[0]) // 2
    down = min(max(0, round(part[1] * height) - SIZE[1] // 2), height - SIZE[1])
    for _ in range(STEPS):
        pixels = env.render(width=width, height=height)
        pixels = pixels[down : down + SIZE[1], right : right + SIZE[0]]
        is_met = len(env.sides) == 1 and bool(infos["metrics"]["completion"][0])
        frames.append(captioned(pixels, caption, "success" if is_met else WHO[player]))
        left -= is_met
        if left < 0:
            (observations, infos), left = env.reset(), HOLD
        else:
            observations, _, _, _, infos = env.step(policy(observations))
    env.close()
    return frames


def captioned(pixels: np.ndarray, caption: str, state: str) -> np.ndarray:
    """Return a picture below a line of text."""
    picture = Image.new("RGB", (SIZE[0], SIZE[1] + BAND), "white")
    picture.paste(Image.fromarray(pixels), (0, BAND))
    pen, load = ImageDraw.Draw(picture), ImageFont.load_default
    middle = BAND // 2
    pen.text((6, middle), caption, "black", load(size=20), anchor="lm")
    ink = "#0a7a2f" if state == "success" else "#777777"
    pen.text((SIZE[0] - 6, middle), state, ink, load(size=15), anchor="rm")
    return np.asarray(picture)


def palette(pictures: list[Image.Image]) -> Image.Image:
    """Return colours for all pictures, because palettes of their own would flicker.

    Most are those that cover the largest areas. Some are far from all others, such as
    the green of the targets.
    """
    sample = Image.fromarray(np.concatenate([np.asarray(each) for each in pictures]))
    colours: list[int] = []
    for count, method in (
        (160, Image.Quantize.MEDIANCUT),
        (96, Image.Quantize.MAXCOVERAGE),
    ):
        colours += (sample.quantize(count, method).getpalette() or [])[: 3 * count]
    made = Image.new("P", (1, 1))
    made.putpalette(colours)
    return made


if __name__ == "__main__":
    films = [film(env_id, *what) for env_id, what in TOUR.items()]
    pictures = [
        Image.fromarray(
            np.concatenate([np.concatenate(frames[i : i + 5], axis=1) for i in (0, 5)])
        )
        for frames in zip(*films, strict=True)
    ]
    plain, colours = Image.Dither.NONE, palette(pictures[::16])
    flat = [each.quantize(palette=colours, dither=plain) for each in pictures]
    path = Path(__file__).parent / "media" / "tour.gif"
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=100, loop=0)
