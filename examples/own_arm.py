"""An arm of your own, in a task beside another one.

    python examples/own_arm.py
    python examples/own_arm.py --env Lift --other jaco --picture own_arm.png
    collaborative-gym record Pass --module examples/own_arm.py --robots own panda \
        --output own_arm.mp4

The arm is a generic one with six joints. Its model is written twice, as MJCF and as
URDF, which most makers offer. The script prints what the expert achieves, in seconds.
"""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import tyro

import collaborative_gym as cg

OWN = cg.Robot(
    name="own",
    model_file=Path(__file__).with_name("own_arm.xml"),
    joints=tuple(f"joint_{i}" for i in range(1, 7)),
    home=(0.0, -0.3, 1.9, 0.0, -1.57, 0.0),
    velocity_limits=(1.8, 1.6, 2.2, 3.0, 3.0, 3.0),
    payload=5.0,
    reach=0.9,
    gripper=cg.Gripper(
        joints=("left_finger", "right_finger"),
        open_position=0.039,
        closed_position=0.0,
        open_gap=0.078,
        closed_gap=0.0,
        force=60.0,
    ),
)

cg.register_robot(OWN)


def main(
    env: str = "Pass",
    other: str = "panda",
    model: Literal["xml", "urdf"] = "xml",
    episodes: int = 20,
    picture: Path | None = None,
) -> None:
    """Let the task's expert move the arm, as robot_1.

    Args:
      env: a task's name.
      other: the arm beside it: own, sawyer, panda or jaco.
      model: which of the two model files to use.
      episodes: how many to play.
      picture: where to write a picture, .png; takes the extra `video`.
    """
    arm = replace(OWN, model_file=OWN.model_file.with_suffix(f".{model}"))
    robots = (arm, arm if other == arm.name else other)
    report = cg.evaluate(cg.task(env, robots), "expert", episodes=episodes)
    print(f"{env} with {arm.name} and {other}: {report.completion.mean:.0%} completed")
    print(f"after {report.time_to_success.mean:.1f} s on average")
    if picture is not None:
        import imageio.v3 as imageio

        from collaborative_gym.pictures.recording import picture as draw
        from collaborative_gym.tasks.registry import make_task

        imageio.imwrite(picture, draw(make_task(env, robots)))
        print(f"wrote {picture}")


if __name__ == "__main__":
    tyro.cli(main)
