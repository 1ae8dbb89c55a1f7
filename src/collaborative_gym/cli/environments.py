"""The table of environments. It imports little, so that `list` is quick."""

from rich.table import Table

from collaborative_gym.cli.terminal import new_table
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.policies.policy import has_baseline
from collaborative_gym.tasks.registry import get_env, list_envs, make_task


def environments_table(with_sizes: bool) -> Table:
    """Return ids, tasks and robots of all environments, one line each."""
    sizes = ["observation", "action"] if with_sizes else []
    table = new_table("environment", "task", "robots", "baseline", *sizes)
    for column in table.columns[1:4]:
        column.justify = "left"
    for env_id in list_envs():
        spec = get_env(env_id)
        table.add_row(
            env_id,
            spec.task.__name__,
            ", ".join(spec.robots),
            "yes" if has_baseline(env_id) else "-",
            *(_sizes(env_id) if with_sizes else ()),
        )
    return table


def _sizes(env_id: str) -> list[str]:
    """Return the sizes of each agent's observation and action; it needs a world."""
    env = VectorEnv(make_task(env_id), 1, num_threads=1)
    return [
        ", ".join(str(space.shape[0]) for space in spaces.values())
        for spaces in (env.single_observation_spaces, env.single_action_spaces)
    ]
