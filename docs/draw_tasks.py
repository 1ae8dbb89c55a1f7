"""Draws the pictures of what has no film: python docs/draw_tasks.py [NAME ...].

They go into `docs/media/`, under the names of `PICTURES`; those that are named, or all.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import collaborative_gym as cg
from collaborative_gym.pictures.recording import contact_sheet

DOCS = Path(__file__).parent
SIZE = 640, 360


@dataclass(frozen=True)
class World:
    """A picture of one world.

    Attributes:
      env_id: the environment, or a task.
      steps: after how many control steps it is taken.
      robots: other arms than the environment's own.
      policy: who plays.
      expert_steps: how long the expert plays first.
    """

    env_id: str
    steps: int
    robots: tuple[str, ...] | None = None
    policy: str | dict[str, str] = "expert"
    expert_steps: int = 0


def beside(policy: str) -> dict[str, str]:
    """Return an expert beside an arm that is still."""
    return {"robot_1": "expert", "robot_2": policy}


PICTURES = {
    "poke": (World("PokeTaskSawyers-v0", 20), World("PokeTaskPandaSawyer-v0", 20)),
    "lift": (World("LiftTaskSawyers-v0", 32), World("LiftMixed4-v0", 25)),
    "balance": (World("BalanceTaskSawyers-v0", 8), World("Balance", 8, ("panda",) * 3)),
    "pass": (World("PassTaskSawyers-v0", 20), World("PassMixed3-v0", 26)),
    "reach": (World("ReachMixed3-v0", 15), World("ReachPandas8-v0", 30)),
    "hockey": (World("HockeyPandas-v0", 14), World("HockeyDoubles-v0", 14)),
    "tug": (World("TugPandas-v0", 12), World("TugPandaSawyer-v0", 30)),
    "balancepath": (
        World("BalancePathSawyers-v0", 20),
        World("BalancePathJacoSawyer-v0", 60),
    ),
    "simple_pick": (World("SimplePick-v0", 8), World("SimplePick-v0", 20)),
    "own_arm": (
        World("Pass", 16, robots=("own", "panda")),
        World("Lift", 20, robots=("own", "panda")),
    ),
    "certify": (
        World("PassTaskSawyers-v0", 40, policy=beside("idle")),
        World("LiftTaskSawyers-v0", 60, policy=beside("gripping")),
        World("PassTaskSawyers-v0", 40, policy=beside("frozen"), expert_steps=20),
    ),
    "strangers": (
        World("PassTaskSawyers-v0", 40, policy="baseline"),
        World(
            "PassTaskSawyers-v0",
            40,
            policy={"robot_1": "expert:nearer", "robot_2": "expert:farther"},
        ),
    ),
    "teams": (
        World("LiftPandas4-v0", 20),
        World("LiftMixed3-v0", 20),
        World("ReachPandas8-v0", 30),
    ),
    "relay": (World("PassMixed3-v0", 19), World("PassPandas4-v0", 52)),
    "assemble": (World("AssemblePandas3-v0", 36), World("AssembleMixed3-v0", 70)),
    "sort": (World("SortMixed3-v0", 45), World("SortPandas4-v0", 30)),
    "teamwork": (
        World("BalanceTaskSawyers-v0", 20, policy=beside("idle")),
        World("BalancePathSawyers-v0", 60, policy=beside("idle")),
    ),
}
"""By name: the worlds side by side."""

SHEET = "contact_sheet"
"""Name of the picture of all tasks."""

GUTTER = 8
"""Pixels between two worlds."""


def picture(world: World) -> np.ndarray:
    """Return what a world looks like then, (height, width, 3) uint8."""
    env = cg.make_vec(world.env_id, 1, robots=world.robots, seed=1, num_threads=1)
    observations, _ = env.reset()
    for step in range(world.steps):
        name = "expert" if step < world.expert_steps else world.policy
        observations, *_ = env.step(cg.load_policy(name, env)(observations))
    pixels = env.render(0, width=SIZE[0], height=SIZE[1])
    env.close()
    return pixels


def draw(name: str) -> None:
    """Draw worlds side by side, or one of each task for the page of all tasks."""
    if name == SHEET:
        tasks = cg.list_tasks()
        pictures = [picture(PICTURES[task.lower()][0]) for task in tasks]
        contact_sheet(pictures, tasks, DOCS / "media" / f"{SHEET}.png", columns=2)
        return
    worlds = [picture(each) for each in PICTURES[name]]
    wide = len(worlds) * (SIZE[0] + GUTTER) - GUTTER
    sheet = Image.new("RGB", (wide, SIZE[1]), "white")
    for i, pixels in enumerate(worlds):
        sheet.paste(Image.fromarray(pixels), (i * (SIZE[0] + GUTTER), 0))
    sheet.save(DOCS / "media" / f"{name}.jpg", quality=88)


if __name__ == "__main__":
    for example in ("simple_pick", "own_arm"):
        cg.load_module(str(DOCS.parent / "examples" / f"{example}.py"))
    for name in sys.argv[1:] or [*PICTURES, SHEET]:
        draw(name)
