"""How fast other libraries' contracts are beside `VectorEnv`.

    python benchmarks/clients.py --seconds 2

All step the same worlds with the same actions in one thread, taking turns. Time is that
of the processor, which other work on the machine changes little. Prints each one's
speed as a share of that of `VectorEnv`, the median of the rounds. Libraries that are
not installed are left out.
"""

import time
from collections.abc import Callable, Iterator

import gymnasium
import numpy as np
import tyro
from gymnasium.wrappers.vector import (
    NormalizeObservation,
    NormalizeReward,
    RecordEpisodeStatistics,
)

import collaborative_gym as cg
from collaborative_gym.evaluation.table import markdown_table

Step = Callable[[], object]
SINGLES = 4
"""Environments that SuperSuit steps one by one; more are not faster."""


def clients(env_id: str, num_envs: int) -> Iterator[tuple[str, int, Step]]:
    """Yield names, steps of worlds in a call, and what does such a call."""
    worlds = cg.make_vec(env_id, num_envs, num_threads=1)
    spaces = worlds.single_action_spaces
    rng = np.random.default_rng(0)
    actions = {
        agent: rng.uniform(-1, 1, (num_envs, *space.shape)).astype(np.float32)
        for agent, space in spaces.items()
    }
    joined = np.concatenate([*actions.values()], axis=1)
    worlds.reset()
    yield "VectorEnv", num_envs, lambda: worlds.step(actions)

    batch = gymnasium.make_vec(env_id, num_envs=num_envs, num_threads=1)
    batch.reset(seed=0)
    yield "gymnasium.make_vec", num_envs, lambda: batch.step(joined)

    mode = {"autoreset_mode": "NextStep", "num_threads": 1}
    wrapped = gymnasium.make_vec(env_id, num_envs=num_envs, **mode)
    for wrapper in (RecordEpisodeStatistics, NormalizeObservation, NormalizeReward):
        wrapped = wrapper(wrapped)
    wrapped.reset(seed=0)
    yield "with three wrappers", num_envs, lambda: wrapped.step(joined)

    single = cg.make(env_id)
    first = {agent: rows[0] for agent, rows in actions.items()}

    def step_single() -> None:
        if not single.agents:
            single.reset()
        single.step(first)

    yield "PettingZoo, one world", 1, step_single
    yield from supersuit_rows(env_id, [*actions.values()])
    try:
        from collaborative_gym.adapters.sb3 import SB3VecEnv
    except ImportError:
        return
    sb3 = SB3VecEnv(cg.make_vec(env_id, num_envs, num_threads=1))
    sb3.reset()
    yield "SB3VecEnv", num_envs, lambda: sb3.step(joined)
    yield from torch_clients(env_id, num_envs, actions)


def supersuit_rows(
    env_id: str, given: list[np.ndarray]
) -> Iterator[tuple[str, int, Step]]:
    """Yield SuperSuit's rows, one for each robot of single environments."""
    try:
        import supersuit
    except ImportError:
        return
    padded = supersuit.pad_observations_v0(cg.make(env_id))
    rows = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.pad_action_space_v0(padded))
    envs = supersuit.concat_vec_envs_v1(rows, SINGLES)
    envs.reset(seed=0)
    size = envs.action_space.shape[0]
    own = [np.pad(a[:SINGLES], ((0, 0), (0, size - a.shape[1]))) for a in given]
    by_robot = np.stack(own, axis=1).reshape(-1, size)
    yield "SuperSuit", SINGLES, lambda: envs.step(by_robot)


def torch_clients(
    env_id: str, num_envs: int, actions: dict[str, np.ndarray]
) -> Iterator[tuple[str, int, Step]]:
    """Yield those whose actions are tensors."""
    import torch

    torch.set_num_threads(1)
    tensors = {agent: torch.as_tensor(rows) for agent, rows in actions.items()}
    try:
        from collaborative_gym.adapters.skrl import SkrlEnv
    except ImportError:
        return
    skrl = SkrlEnv(cg.make_vec(env_id, num_envs, num_threads=1))
    skrl.reset()
    yield "SkrlEnv", num_envs, lambda: skrl.step(tensors)
    try:
        from collaborative_gym.adapters.torchrl import TorchRLEnv
    except ImportError:
        return
    torchrl = TorchRLEnv(cg.make_vec(env_id, num_envs, num_threads=1))
    state = {"now": torchrl.reset()}

    def step_torchrl() -> None:
        now = state["now"]
        for agent, rows in tensors.items():
            now[agent, "action"] = rows[:, None]
        _, state["now"] = torchrl.step_and_maybe_reset(now)

    yield "TorchRLEnv", num_envs, step_torchrl


def rate(step: Step, seconds: float) -> float:
    """Return calls per second of the processor's time."""
    calls, started = 0, time.process_time()
    while (spent := time.process_time() - started) < seconds:
        step()
        calls += 1
    return calls / spent


def main(
    env: str = "PokeTaskSawyers-v0",
    num_envs: int = 64,
    seconds: float = 1.0,
    rounds: int = 5,
) -> None:
    """Measure all that is installed.

    Args:
      env: an environment id.
      num_envs: worlds beside one another.
      seconds: for each client in a round.
      rounds: in each of which all take a turn.
    """
    steps = list(clients(env, num_envs))
    shares = {name: [] for name, *_ in steps}
    for _ in range(rounds):
        rates = {name: worlds * rate(step, seconds) for name, worlds, step in steps}
        for name, own in rates.items():
            shares[name].append(own / rates["VectorEnv"])
    lines = [[name, f"{100 * np.median(own):.0f} %"] for name, own in shares.items()]
    print(markdown_table(["client", "share of VectorEnv's speed"], lines, words=1))


if __name__ == "__main__":
    tyro.cli(main)
