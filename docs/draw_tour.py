"""Draws the README's moving picture, `docs/media/tour.gif`: python docs/draw_tour.py.

Six tasks play side by side. A second after a success each goes on to its next start.
"""

from pathlib import Path

import numpy as np
from draw_films import AGAINST
from PIL import Image, ImageDraw, ImageFont

import collaborative_gym as cg

SIZE = 384, 216
BAND = 44
STEPS, HOLD = 78, 10
"""Pictures, which are control steps, and how long a success is shown."""

TOUR = {
    "PokeTaskPandaSawyer-v0": (1.3, 0.42),
    "LiftPandas4-v0": (1.7, 0.52),
    "PassTaskJacoSawyer-v0": (1.05, 0.5),
    "BalancePathPandas4-v0": (1.35, 0.42),
    "AssemblePandas3-v0": (1.8, 0.42),
    "HockeyPandas-v0": (1.3, 0.52),
}
"""What the baselines play, in games against the expert, by environment: how much larger
than the whole picture its part is drawn, whose middle is so far down."""
COLUMNS = 3
MET = {"HockeyPandas-v0": "goal"}
"""What is said of a met goal, if not `success`."""


def film(env_id: str, part: tuple[float, float]) -> list[np.ndarray]:
    """Return the pictures of some starts, (height, width, 3) uint8 each.

    They begin late enough in the first one for its success to be seen.
    """
    env = cg.make_vec(env_id, 1, num_threads=1)
    alone = len(env.sides) == 1
    policy = cg.load_policy("baseline" if alone else AGAINST, env)
    width, height = (round(part[0] * side) for side in SIZE)
    right = (width - SIZE[0]) // 2
    down = min(max(0, round(part[1] * height) - SIZE[1] // 2), height - SIZE[1])

    def is_met() -> bool:
        sides = [infos["success"]] if alone else infos["success"].values()
        return any(side[0] for side in sides)

    observations, infos = env.reset(seed=1)
    first = 0
    while not is_met() and not infos["ended"][0]:
        observations, _, _, _, infos = env.step(policy(observations))
        first += 1
    observations, infos = env.reset(seed=1)
    for _ in range(first + HOLD - STEPS):
        observations, _, _, _, infos = env.step(policy(observations))
    frames, left, met = [], HOLD, False
    for _ in range(STEPS):
        met = met or is_met()
        pixels = env.render(width=width, height=height)
        pixels = pixels[down : down + SIZE[1], right : right + SIZE[0]]
        end = MET.get(env_id, "success") if met else ""
        many = f", {len(env.agents)} arms" * (len(env.agents) > 2)
        frames.append(captioned(pixels, type(env.task).__name__ + many, end))
        left -= met
        if left < 0:
            (observations, infos), left, met = env.reset(), HOLD, False
        else:
            observations, _, _, _, infos = env.step(policy(observations))
    env.close()
    return frames


def captioned(pixels: np.ndarray, name: str, said: str) -> np.ndarray:
    """Return a picture below a task's name, and what is said of its goal."""
    picture = Image.new("RGB", (SIZE[0], SIZE[1] + BAND), "white")
    picture.paste(Image.fromarray(pixels), (0, BAND))
    pen, load = ImageDraw.Draw(picture), ImageFont.load_default
    middle = BAND // 2
    pen.text((6, middle), name, "black", load(size=30), anchor="lm")
    pen.text((SIZE[0] - 6, middle), said, "#0a7a2f", load(size=26), anchor="rm")
    return np.asarray(picture)


def palette(pictures: list[Image.Image]) -> Image.Image:
    """Return colours for all pictures, because palettes of their own would flicker.

    Most are those that cover the largest areas. Some are far from all others, such as
    the green of the targets.
    """
    sample = Image.fromarray(np.concatenate([np.asarray(each) for each in pictures]))
    colours: list[int] = []
    for count, method in (
        (128, Image.Quantize.MEDIANCUT),
        (128, Image.Quantize.MAXCOVERAGE),
    ):
        colours += (sample.quantize(count, method).getpalette() or [])[: 3 * count]
    made = Image.new("P", (1, 1))
    made.putpalette(colours)
    return made


if __name__ == "__main__":
    films = [film(env_id, part) for env_id, part in TOUR.items()]
    pictures = [
        Image.fromarray(
            np.concatenate(
                [
                    np.concatenate(frames[i : i + COLUMNS], axis=1)
                    for i in range(0, len(frames), COLUMNS)
                ]
            )
        )
        for frames in zip(*films, strict=True)
    ]
    plain, colours = Image.Dither.NONE, palette(pictures[::6])
    flat = [each.quantize(palette=colours, dither=plain) for each in pictures]
    path = Path(__file__).parent / "media" / "tour.gif"
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=100, loop=0)
