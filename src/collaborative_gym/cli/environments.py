"""The table of environments. It imports little, so that `list` is quick."""

from rich.table import Table

from collaborative_gym.cli.terminal import new_table
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import counted
from collaborative_gym.policies.policy import shipped_kinds
from collaborative_gym.tasks.registry import get_env, list_envs, make_task


def environments_table(with_sizes: bool) -> Table:
    """Return ids and robots of all environments, one line each.

    Args:
      with_sizes: whether each line has the sizes instead of the task and the shipped
        policies, since a terminal has no room for all.
    """
    rows, heads = [], ["task", "robots", "shipped"]
    if with_sizes:
        heads = ["robots", "observation", "action"]
    for env_id in list_envs():
        spec = get_env(env_id)
        robots = counted(spec.robots)
        if with_sizes:
            env = VectorEnv(make_task(env_id), 1, num_threads=1)
            spaces = env.single_observation_spaces, env.single_action_spaces
            sizes = (", ".join(str(x.shape[0]) for x in s.values()) for s in spaces)
            rows.append([env_id, robots, *sizes])
        else:
            shipped = ", ".join(shipped_kinds(env_id)) or "-"
            rows.append([env_id, spec.task.__name__, robots, shipped])
    return new_table(["environment", *heads], rows, words=2 if with_sizes else 4)
