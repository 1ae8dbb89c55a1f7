"""How well a policy does under disturbances, one at a time and all together."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields

from collaborative_gym.evaluation.play import evaluate, part_of
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
"""The fields that each disturbance takes from `hard`, by its name; the others are those
of `default`."""


def measure_robustness(
    env: str | Task,
    policy: AnyPolicy = "expert",
    *,
    episodes: int = 100,
    seed: int = 0,
    num_envs: int | None = None,
    num_threads: int = 0,
    any_env: bool = False,
    on_progress: Callable[[float], object] | None = None,
) -> dict[str, Report]:
    """Return what evaluations with each of `DISTURBANCES` found, by its name.

    What disturbs an episode is the same alone and among all.

    Args:
      env: an environment id, a task's name, or a task, of which the `default` of the
        randomization is taken.
      policy: as `evaluate` takes it.
      episodes: how many with each disturbance.
      seed: which.
      num_envs: as in `evaluate`.
      num_threads: as in `evaluate`.
      any_env: as in `evaluate`.
      on_progress: called after each step with the share that is done, 0 to 1.

    Raises:
      Exception: as `evaluate` does.
    """
    task, hard = as_task(env), RANDOMIZATIONS["hard"]
    reports = {}
    for i, (name, own) in enumerate(DISTURBANCES.items()):
        changes = {field: getattr(hard, field) for field in own}
        reports[name] = evaluate(
            disturbed(task, **changes),
            policy,
            episodes=episodes,
            seed=seed,
            num_envs=num_envs,
            num_threads=num_threads,
            any_env=any_env,
            on_progress=part_of(on_progress, i, len(DISTURBANCES)),
        )
    return reports
