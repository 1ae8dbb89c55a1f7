"""How fast RLlib collects with our runner, with its own, and with two of ours.

    python benchmarks/rllib.py [--env ID] [--seconds S] [--json FILE]

Every number is environment steps per second of wall time, the median of five turns;
a step is one control step of one world. All run in turn on the same machine with one
torch thread per process and networks of 2 x 256, in mode `independent`, which is what
RLlib's own runner does too, without the critics that ours has. The physics of a process
runs on one thread, or on all CPUs where it says so; RLlib's runner steps its worlds one
by one and has no use for a second. "Physics" is the simulation alone, which no runner
can exceed. "Training" has the updates too.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from rich.console import Console
from rich.table import Table

import collaborative_gym as cg
from collaborative_gym.envs.rllib import register_envs
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.rllib_backend import RLlibBackend, connect
from collaborative_gym.learning.team import Sizes, make_learners
from collaborative_gym.tasks.registry import make_task

TURNS = 5


def rate(turn: Callable[[], int], seconds: float) -> float:
    """Return steps per second, from a function that returns how many steps it did."""
    turn()
    rates = []
    for _ in range(TURNS):
        steps, started = 0, time.perf_counter()
        while time.perf_counter() - started < seconds / TURNS:
            steps += turn()
        rates.append(steps / (time.perf_counter() - started))
    return statistics.median(rates)


def own_runner(env_id: str, num_envs: int, seconds: float) -> float:
    """Return the rate of RLlib's own runner."""
    config = (
        PPOConfig()
        .environment(env_id)
        .env_runners(num_envs_per_env_runner=num_envs)
        .multi_agent(
            policies={"robot_1", "robot_2"}, policy_mapping_fn=lambda agent, *_: agent
        )
        .rl_module(
            model_config=DefaultModelConfig(
                fcnet_hiddens=[256, 256], fcnet_activation="relu"
            )
        )
    )
    runner = MultiAgentEnvRunner(config=config)

    def turn() -> int:
        episodes = runner.sample(num_timesteps=8 * num_envs)
        return sum(len(episode) for episode in episodes)

    try:
        return rate(turn, seconds)
    finally:
        runner.stop()


def physics(env_id: str, num_threads: int, seconds: float) -> float:
    """Return the rate of the simulation alone, in the worlds' first episodes."""
    env = cg.make_vec(env_id, num_envs=256, seed=0, num_threads=num_threads)
    env.reset()
    controls = np.repeat(env.sim.ctrl[:, None], env.substeps, axis=1)

    def turn() -> int:
        env.sim.step(controls)
        return 256

    return rate(turn, seconds)


def our_runners(
    env_id: str, num_runners: int, num_threads: int, seconds: float
) -> tuple[float, float]:
    """Return the rates of collecting alone, and of training."""
    task = make_task(env_id)
    env = cg.VectorEnv(task, 1)
    sizes = Sizes(
        *(
            {agent: space.shape[0] for agent, space in spaces.items()}
            for spaces in (env.single_observation_spaces, env.single_action_spaces)
        ),
        task.gripping,
    )
    backend = RLlibBackend(
        task,
        make_learners("independent", sizes),
        sizes,
        seed=0,
        hyperparameters=Hyperparameters(),
        num_threads=num_threads,
        num_runners=num_runners,
    )

    def advance() -> int:
        before = backend.steps
        backend.advance()
        return backend.steps - before

    try:
        return rate(backend.collect, seconds), rate(advance, seconds)
    finally:
        backend.close()


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--env", default="LiftTaskSawyers-v0")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    register_envs()
    connect(None, num_runners=2)
    rows: dict[str, tuple[float, float | None]] = {}
    for worlds in (1, 16, 256):
        name = f"RLlib's runner, {worlds} worlds"
        rows[name] = own_runner(options.env, worlds, options.seconds), None
    for threads, cpus in ((1, "one thread"), (0, "all CPUs")):
        name = f"physics, 256 worlds, {cpus}"
        rows[name] = physics(options.env, threads, options.seconds), None
        name = f"our runner, 256 worlds, {cpus}"
        rows[name] = our_runners(options.env, 0, threads, options.seconds)
    for runners in (1, 2):
        name = f"our runners, 256 worlds, processes: {runners}"
        rows[name] = our_runners(options.env, runners, 1, options.seconds)
    ray.shutdown()
    show(options.env, rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def show(env_id: str, rows: dict[str, tuple[float, float | None]]) -> None:
    """Print the rates and what they are in comparison."""
    own = [each for name, (each, _) in rows.items() if name.startswith("RLlib")]
    table = Table(title=f"{env_id}, environment steps per second")
    table.add_column("")
    for head in ("collecting", "of RLlib's 1", "of RLlib's best", "training"):
        table.add_column(head, justify="right")
    for name, (collecting, training) in rows.items():
        ratios = f"{collecting / own[0]:.1f} x", f"{collecting / max(own):.1f} x"
        last = "" if training is None else f"{training:,.0f}"
        table.add_row(name, f"{collecting:,.0f}", *ratios, last)
    *_, one, two = rows.values()
    table.caption = (
        f"From 1 to 2 processes: collecting {two[0] / one[0]:.2f} x, training"
        f" {(two[1] or 0) / (one[1] or 1):.2f} x"
    )
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
