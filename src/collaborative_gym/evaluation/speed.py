"""Speed of the environments, beside the bare physics they run on."""

import math
import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import numpy as np

from collaborative_gym.envs.pettingzoo import PettingZooEnv
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import T, check_callback
from collaborative_gym.evaluation.machine import cores, describe_machine
from collaborative_gym.evaluation.play import OnProgress
from collaborative_gym.evaluation.table import to_json
from collaborative_gym.math import Array
from collaborative_gym.plugins import load_modules, loaded_files
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Task

Actions = dict[str, np.ndarray]
_Clock = Callable[[], float]

_ROUNDS = 11
"""Rounds in which bare physics and environment take turns; their median counts."""

_STEPS = 8  # control steps of a round
_MEMORY_ENVS = 1024  # worlds whose memory is measured


@dataclass(frozen=True)
class Rates:
    """Control steps of one world per second, with one kind of actions."""

    bare: float  # of `mujoco.batch` alone, from the same states with the same controls
    env: float  # of `VectorEnv.step`, with its resets
    ratio: float  # median of the rounds' env / bare


@dataclass(frozen=True)
class Speed:
    """Speed of one environment."""

    environment: str  # its id
    expert: Rates  # with the expert; where there is none, with robots that hold still
    random: Rates  # with random actions, under which arms crash
    single_rate: float  # steps per second of a PettingZoo environment, with resets
    reset_ms: float  # time of one world's reset
    make_s: tuple[float, float]  # to make a process's first PettingZoo env, and another
    kb_per_env: float  # memory per world


@dataclass(frozen=True)
class Benchmark:
    """Speeds measured in one run."""

    machine: dict[str, str | int]  # processor and versions
    num_envs: int  # worlds that were stepped together
    num_threads: int  # physics threads
    environments: tuple[Speed, ...]

    def to_json(self) -> str:
        """Return everything as JSON."""
        return to_json(self)


def benchmark(
    env_ids: Sequence[str],
    num_envs: int = 256,
    *,
    num_threads: int = 0,
    on_progress: OnProgress = None,
) -> Benchmark:
    """Return how fast environments are here and now.

    Args:
      env_ids: their ids, or tasks' names.
      num_envs: worlds to step together.
      num_threads: physics threads, 0 for one per CPU.
      on_progress: called after each environment with the share that is done, 0 to 1.

    Raises:
      KeyError: if there is no such environment.
      ValueError: if a number is out of range.
    """
    check_callback("on_progress", on_progress)
    for env_id in env_ids:
        make_task(env_id)  # Unknown names show before the work.
    num_threads = num_threads or cores()
    speeds = []
    for env_id in env_ids:
        speeds.append(_measure(env_id, num_envs, num_threads))
        if on_progress is not None:
            on_progress(len(speeds) / len(env_ids))
    return Benchmark(describe_machine(), num_envs, num_threads, tuple(speeds))


def _measure(env_id: str, num_envs: int, num_threads: int) -> Speed:
    env = VectorEnv(make_task(env_id), num_envs, num_threads=num_threads)
    single = PettingZooEnv(make_task(env_id))
    has_expert = type(env.task).expert is not Task.expert
    usual = env.expert if has_expert else env.idle
    return Speed(
        environment=env_id,
        expert=compare_rates(env, lambda _: usual()),
        random=compare_rates(env, lambda rng: _random(env, rng, num_envs)),
        single_rate=_single_rate(single),
        reset_ms=1e3 * median(_time(single.reset) for _ in range(50)),
        make_s=_in_fresh_process(_times_to_make, env_id),
        kb_per_env=_in_fresh_process(_memory_per_env, env_id),
    )


def compare_rates(
    env: VectorEnv,
    act: Callable[[np.random.Generator], Actions],
    clock: _Clock = time.perf_counter,
) -> Rates:
    """Return the rates of the bare physics and of an environment, and their ratio.

    In each round both do the same control steps, from states that are spread over whole
    episodes. They take turns, so that another program's load slows both alike.
    """
    rng = np.random.default_rng(0)
    env.reset(seed=0, stagger=True)
    for _ in range(_STEPS):
        env.step(act(rng))
    bare_times, env_times = [], []
    for _ in range(_ROUNDS):
        start, actions, rounds = env.get_state(), [], []
        for _ in range(_STEPS):
            actions.append(act(rng))
            commands = env.action_mode.commands(env.action_mode.check(actions[-1]))
            before = env.sim.get_state()
            controls = env.action_mode.prepare(commands)
            rounds.append((env.sim.get_state(), controls))
            env.sim.set_state(before)
            env.step(actions[-1])
        # In its own worlds, because where hands took things differs among them.
        bare_times.append(sum(_roll(env, *each, clock=clock) for each in rounds))
        env.set_state(start)
        started = clock()
        for each in actions:
            env.step(each)
        env_times.append(clock() - started)
    steps = env.num_envs * _STEPS
    ratios = [alone / full for alone, full in zip(bare_times, env_times, strict=True)]
    return Rates(
        bare=steps / median(bare_times),
        env=steps / median(env_times),
        ratio=median(ratios),
    )


def _random(env: VectorEnv, rng: np.random.Generator, *num_envs: int) -> Actions:
    return {
        agent: rng.uniform(-1, 1, (*num_envs, *space.shape))
        for agent, space in env.single_action_spaces.items()
    }


def _roll(env: VectorEnv, state: Array, controls: Array, *, clock: _Clock) -> float:
    env.sim.set_state(state)
    return _time(lambda: env.sim.roll(controls), clock)


def _single_rate(env: PettingZooEnv) -> float:
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    count = min(100, env.vector_env.task.config.max_episode_steps)
    actions = [_random(env.vector_env, rng) for _ in range(count)]
    started = time.perf_counter()
    for action in actions:
        if not env.agents:  # A side has won, which ends the episode early.
            env.reset()
        env.step(action)
    return count / (time.perf_counter() - started)


def _time(call: Callable[[], object], clock: _Clock = time.perf_counter) -> float:
    started = clock()
    call()
    return clock() - started


def _times_to_make(env_id: str) -> tuple[float, float]:
    first, second = (_time(lambda: PettingZooEnv(make_task(env_id))) for _ in range(2))
    return first, second


def _memory_per_env(env_id: str) -> float:
    """Return how much this process grows per world of a large batch, in kB."""
    VectorEnv(make_task(env_id), 1, num_threads=1).reset(seed=0)
    before = resident_kb()
    env = VectorEnv(make_task(env_id), _MEMORY_ENVS, num_threads=1)
    env.reset(seed=0)
    env.step(env.idle())
    return (resident_kb() - before) / _MEMORY_ENVS


def resident_kb() -> float:
    """Return the memory of this process; NaN where the system does not say."""
    status = Path("/proc/self/status")
    found = re.search(r"VmRSS:\s*(\d+)", status.read_text() if status.exists() else "")
    return float(found[1]) if found else math.nan


def _in_fresh_process(function: Callable[[str], T], argument: str) -> T:
    # A process that made environments before would reuse their memory and start poses.
    with ProcessPoolExecutor(
        1, get_context("spawn"), initializer=load_modules, initargs=(loaded_files(),)
    ) as pool:
        return pool.submit(function, argument).result()
