"""Draws the films of the gallery: python docs/draw_films.py [ENV_ID ...].

Those of baselines go into `docs/media/baselines/`, those of experts of teams into
`docs/media/experts/`, each with a picture that stands for it; `docs/media/ego.gif`,
which the name `ego` draws alone; and Lift beside an idle arm, which `idle` draws.
"""

import sys
from pathlib import Path

import collaborative_gym as cg
from collaborative_gym.pictures.recording import record
from collaborative_gym.policies.policy import is_shipped

MEDIA = Path(__file__).parent / "media"
SIZE = 640, 400
SIZES = {
    "HockeyPandas-v0": (800, 500),
    "PassPandas3-v0": (1120, 420),
    "PassPandas4-v0": (1280, 400),
    "ReachPandas4-v0": (800, 500),
    "SortPandas4-v0": (960, 600),
    "TugPandas-v0": (800, 500),
}
"""Sizes of films, of long rows with less height, and of two with small goals."""
SPEEDS = {"Hockey": 2.0, "Sort": 2.0, "BalancePath": 1.5, "Tug": 0.25}
"""Speeds of tasks in which much is alike, and of one that is over in a second."""
STARTS = {"Balance": "lost"}
"""Starts of films of Balance, whose ball would soon lie still: it already rolls."""
SLOW = "Poke", "Pass", "Assemble", "Hockey"
"""Tasks in which single moments decide."""
BESIDE = (400, 254)
"""Size of each of two pictures side by side in a GIF, which pages show."""
LEAST = 6.0
"""Length of a film, in s, at which no further start begins."""
CLOSE_UPS = {
    "Poke": "robot_2/donut/donut",
    "Lift": "pot/pot",
    "Balance": "ball/ball",
    "BalancePath": "ball/ball",
    "Pass": "cube/cube",
    "PassPandas4-v0": ("cube/cube", "cube_2/cube"),
    "SortPandas4-v0": tuple(f"cube_{i + 1}/cube" for i in range(7)),
    "Assemble": "block/block",
}
"""What the films of a task or an environment show from nearby."""
TEAMS = ("PassPandas4-v0",)
"""Teams without a baseline, whose experts are filmed."""
AGAINST = {"robot_1": "baseline", "robot_2": "expert"}
"""Who plays where robots play against each other."""
EPISODES = {
    "BalanceTaskJacoSawyer-v0": [40, 45],
    "BalanceTaskSawyers-v0": [45, 40],
    "HockeyPandas-v0": [20],
    "TugPandas-v0": [27, 24],
}
"""Starts of Balance from which the ball rolls far, and games in which the lead changes:
of the first 16 of Hockey, the baseline won 13, and lost 2; it won all of 256 of Tug, of
which these two are among the longest."""


def film(env_id: str) -> None:
    """Film who plays best, and leave out the picture that stood for the last film."""
    player = "baseline" if is_shipped("baseline", env_id) else "expert"
    path = MEDIA / f"{player}s" / f"{env_id}.mp4"
    task, policy = cg.task(env_id), AGAINST
    kind = type(task).__name__
    if kind in STARTS:
        task = cg.task(env_id, randomization=STARTS[kind])
    more = {
        "size": SIZES.get(env_id, SIZE),
        "speed": SPEEDS.get(kind, 1.0),
        "slow_motion": kind in SLOW,
    }
    if env_id in EPISODES:
        more["only_episodes"] = EPISODES[env_id]
    else:
        more["seconds"] = LEAST
    if len(task.sides) == 1:
        near = CLOSE_UPS.get(env_id, CLOSE_UPS.get(kind, ()))
        policy, more = player, more | {"close_up": near}
    record(task, path, policy=policy, **more)
    path.with_suffix(".jpg").unlink(missing_ok=True)


if __name__ == "__main__":
    shipped = [each for each in cg.list_envs() if is_shipped("baseline", each)]
    for name in sys.argv[1:] or [*shipped, *TEAMS, "ego", "idle"]:
        if name == "ego":
            nearer, higher = (
                {"robot_1": f"expert:{place}", "robot_2": "ego"}
                for place in ("nearer", "higher")
            )
            record(
                "PassTaskSawyers-v0",
                MEDIA / "ego.gif",
                policy=[nearer, higher],
                size=BESIDE,
            )
        elif name == "idle":
            path = MEDIA / "experts" / "idle.mp4"
            record(
                "LiftTaskSawyers-v0",
                path,
                policy=["expert", {"robot_1": "expert", "robot_2": "idle"}],
                only_episodes=[0],
                size=SIZE,
            )
            path.with_suffix(".jpg").unlink(missing_ok=True)
        else:
            film(name)
        print(name)
