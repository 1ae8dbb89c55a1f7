"""How well a policy does under disturbances, one at a time and all together."""

from collections.abc import Mapping, Sequence
from dataclasses import fields

from collaborative_gym.evaluation.play import OnProgress, evaluate, parts_of
from collaborative_gym.evaluation.report import Report
from collaborative_gym.policies import AnyPolicy
from collaborative_gym.tasks.registry import as_task, disturbed
from collaborative_gym.tasks.task import RANDOMIZATIONS, Task

DISTURBANCES: Mapping[str, Sequence[str]] = {
    "none": (),
    "starts": ("joint_noise", "object_position", "object_yaw", "target_position"),
    "link mass": ("link_mass",),
    "payload": ("payload",),
    "friction": ("friction",),
    "torque": ("lost_torque",),
    "delay": ("delay", "delayed"),
    "lost actions": ("lost_actions",),
    "noise": ("position_noise", "angle_noise"),
    "all": tuple(field.name for field in fields(RANDOMIZATIONS["hard"])),
}
"""Fields of the randomization `hard` by the name of a disturbance, which leaves the
others as in `default`."""


def measure_robustness(
    env: str | Task,
    policy: AnyPolicy = "expert",
    *,
    episodes: int = 100,
    seed: int = 0,
    num_envs: int | None = None,
    num_threads: int = 0,
    any_env: bool = False,
    on_progress: OnProgress = None,
) -> dict[str, Report]:
    """Return the report of an evaluation with each of `DISTURBANCES`, by its name.

    All arguments are those of `evaluate`; `episodes` are played with each disturbance.
    Each of them disturbs an episode in the same way alone and together with the others.

    Raises:
      Exception: as `evaluate` does.
    """
    task, hard = as_task(env), RANDOMIZATIONS["hard"]
    parts = parts_of(on_progress, [1] * len(DISTURBANCES))
    reports = {}
    for (name, changed), part in zip(DISTURBANCES.items(), parts, strict=True):
        reports[name] = evaluate(
            disturbed(task, **{field: getattr(hard, field) for field in changed}),
            policy,
            episodes=episodes,
            seed=seed,
            num_envs=num_envs,
            num_threads=num_threads,
            any_env=any_env,
            on_progress=part,
        )
    return reports
