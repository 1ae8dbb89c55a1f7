"""The table of environments. It imports little, so that `list` is quick."""

from rich.table import Table

from collaborative_gym.cli.terminal import new_table
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import UnknownName, counted, unknown
from collaborative_gym.policies.policy import shipped_kinds
from collaborative_gym.tasks.registry import get_env, list_envs, list_tasks, make_task


def environments_table(part: str, with_sizes: bool) -> Table:
    """Return ids and robots of environments that have a part in their name or task.

    Sizes are instead of the task and the shipped policies: a terminal has no room for
    all. There must be such an environment, or a KeyError says which are like it.
    """
    rows, heads = [], ["task", "robots", "shipped"]
    if with_sizes:
        heads = ["robots", "observation", "action"]
    for env_id in list_envs():
        spec = get_env(env_id)
        robots, task = counted(spec.robots), spec.task.__name__
        if part.lower() not in f"{env_id} {task}".lower():
            continue
        if with_sizes:
            env = VectorEnv(make_task(env_id), 1, num_threads=1)
            spaces = env.single_observation_spaces, env.single_action_spaces
            sizes = (", ".join(str(x.shape[0]) for x in s.values()) for s in spaces)
            rows.append([env_id, robots, *sizes])
        else:
            shipped = ", ".join(shipped_kinds(env_id)) or "-"
            rows.append([env_id, task, robots, shipped])
    if not rows:
        raise UnknownName(unknown("environment", part, list_envs() + list_tasks()))
    return new_table(["environment", *heads], rows, words=2 if with_sizes else 4)
