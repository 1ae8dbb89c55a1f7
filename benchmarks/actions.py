"""What the experts do in each action mode, and how fast the worlds are then.

    python benchmarks/actions.py --output docs/tables/actions.md

Completion and time are of 64 episodes of seed 0 with `default` starts. The speed is
that of a control step of 256 worlds in one thread with the expert's actions, as a share
of the speed with joint changes, by the time of the processor: the modes take turns, and
each number is a median.
"""

import argparse
import time
from pathlib import Path
from statistics import median

import collaborative_gym as cg
from collaborative_gym.cli.terminal import show
from collaborative_gym.control import list_modes

WORLDS, ROUNDS, STEPS = 256, 7, 4


def main() -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, help="file to write the table to")
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--envs", nargs="*", default=cooperative())
    options = parser.parse_args()
    modes = list_modes()
    heads = [f"{mode}: completed" for mode in modes]
    heads += [f"{mode}: time" for mode in modes]
    heads += [f"{mode}: speed" for mode in modes[1:]]
    rows = [["environment", *heads], ["---"] + ["--:"] * len(heads)]
    for env_id in options.envs:
        rows.append([env_id, *completions(env_id, options.episodes), *speeds(env_id)])
        show(" | ".join(rows[-1]))
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    show(table)
    if options.output:
        options.output.write_text(table + "\n")


def cooperative() -> list[str]:
    """Return the ids whose arms share one goal."""
    return [each for each in cg.list_envs() if len(cg.task(each).sides) == 1]


def completions(env_id: str, episodes: int) -> list[str]:
    """Return how often the expert completes episodes in each mode, and how soon."""
    shares, times = [], []
    for mode in list_modes():
        task = cg.task(env_id, action=mode)
        report = cg.evaluate(task, "expert", episodes=episodes, num_threads=1)
        shares.append(f"{100 * report.completion.mean:.0f} %")
        soon = report.time_to_success.mean
        times.append("-" if soon != soon else f"{soon:.1f} s")
    return shares + times


def speeds(env_id: str) -> list[str]:
    """Return the speed of a control step in each mode but the first, as a share."""
    envs = [
        cg.make_vec(env_id, WORLDS, seed=0, num_threads=1, action=mode)
        for mode in list_modes()
    ]
    for env in envs:
        env.reset()
    times: list[list[float]] = []
    for _ in range(ROUNDS):
        times.append([_time(env) for env in envs])
    ratios = zip(*([row[0] / each for each in row[1:]] for row in times), strict=True)
    return [f"{100 * median(each):.0f} %" for each in ratios]


def _time(env: cg.VectorEnv) -> float:
    """Return the time of some control steps, without that of the expert."""
    spent = 0.0
    for _ in range(STEPS):
        actions = env.expert()
        started = time.process_time()
        env.step(actions)
        spent += time.process_time() - started
    return spent


if __name__ == "__main__":
    main()
