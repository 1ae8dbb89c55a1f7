"""The table of environments. It imports little, so that `list` is quick."""

from rich.table import Table

from collaborative_gym.cli.terminal import new_table
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies.policy import shipped_kinds
from collaborative_gym.tasks.registry import get_env, list_envs, make_task


def environments_table(with_sizes: bool) -> Table:
    """Return ids and robots of all environments, one line each.

    Args:
      with_sizes: whether each line has the sizes instead of the task and the shipped
        policies, since a terminal has no room for all.
    """
    if with_sizes:
        table = new_table("environment", "robots", "observation", "action")
        table.columns[1].justify = "left"
    else:
        table = new_table("environment", "task", "robots", "shipped")
        for column in table.columns:
            column.justify = "left"
    for env_id in list_envs():
        spec = get_env(env_id)
        robots = ", ".join(spec.robots)
        if with_sizes:
            table.add_row(env_id, robots, *_sizes(env_id))
        else:
            shipped = ", ".join(shipped_kinds(env_id)) or "-"
            table.add_row(env_id, spec.task.__name__, robots, shipped)
    return table


def _sizes(env_id: str) -> list[str]:
    """Return the sizes of each agent's observation and action; it needs a world."""
    env = VectorEnv(make_task(env_id), 1, num_threads=1)
    return [
        ", ".join(str(space.shape[0]) for space in spaces.values())
        for spaces in (env.single_observation_spaces, env.single_action_spaces)
    ]
