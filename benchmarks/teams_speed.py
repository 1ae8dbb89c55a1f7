"""How fast environments of two to eight arms are, beside the bare physics of the same.

    python benchmarks/teams_speed.py [--tasks Lift Reach] [--sizes 2 3 4 6 8]
    python benchmarks/teams_speed.py --output docs/tables/teams_speed.md

Each team of Pandas is measured in a process of its own, on one thread. Times are the
processor's, which other work on the machine does not add to. `bare` takes the same
physics steps alone, in the same worlds, from the same states with the same controls;
both take turns, and ratios are medians of pairs. `growth` is how much more an arm's
step costs than one of the smallest team, beyond what it does in bare physics. Calls are
those of our own functions in a control step. The first `make` of a process searches for
postures, and the second finds them.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import collaborative_gym as cg
from collaborative_gym.evaluation.speed import compare_rates, resident_kb
from collaborative_gym.evaluation.table import markdown_table

OURS = str(Path(cg.__file__).parent)
TASKS = ["Lift", "Reach", "Pass", "Sort", "Assemble"]
COLUMNS = (
    "task",
    "arms",
    "env-steps/s",
    "arm-steps/s",
    "bare",
    "`VectorEnv` / bare",
    "growth",
    "with strain / without",
    "calls",
    "kB a world",
    "first make, s",
    "second, s",
    "reset, ms",
)
ROUNDS, STEPS, MEMORY_ENVS = 9, 4, 256


def main() -> None:
    """Measure each team, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tasks", nargs="+", default=TASKS)
    parser.add_argument("--sizes", type=int, nargs="+", default=[2, 3, 4, 6, 8])
    parser.add_argument("--num-envs", type=int, default=32)
    parser.add_argument("--output", type=Path, help="file for the table")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        name, size = options.one
        print(json.dumps(measure(name, int(size), options.num_envs)))
        return
    lines = []
    for task in options.tasks:
        first = None
        for size in sorted({*options.sizes} & {*cg.task(task).robot_counts}):
            found = in_fresh_process(task, size, options.num_envs)
            first = first or found
            lines.append(line(task, size, found, first))
            print(*lines[-1], sep="; ", flush=True)
    table = markdown_table(COLUMNS, lines, words=1)
    if options.output:
        about = (
            f"The table has control steps per second in {options.num_envs} worlds of"
            " Pandas, with the expert, on one thread (`python"
            " benchmarks/teams_speed.py`). Arm-steps are env-steps times arms. The"
            " ratios are medians of pairs measured in turn. `with strain / without`"
            " divides the speed with strain by that without."
            " `growth` is the cost of an arm's step beyond bare physics, divided by"
            " that in the smallest team. Calls are those of our own functions in a"
            " control step."
        )
        options.output.write_text(f"# Speed of teams\n\n{about}\n\n{table}\n")
    print(table)


def line(task: str, size: int, found: dict, first: dict) -> list[str]:
    """Return the cells of a team; `first` is what was found of the smallest."""
    return [
        task,
        f"{size}",
        f"{found['env']:,.0f}",
        f"{size * found['env']:,.0f}",
        f"{found['bare']:,.0f}",
        f"{100 * found['ratio']:.0f} %",
        f"{first['ratio'] / found['ratio']:.2f}",
        f"{100 * found['strain']:.0f} %",
        f"{found['calls']}",
        f"{found['kb']:.0f}",
        f"{found['first']:.2f}",
        f"{found['second']:.2f}",
        f"{found['reset']:.1f}",
    ]


def in_fresh_process(task: str, size: int, num_envs: int) -> dict:
    """Return what `measure` finds in a process that has made nothing else."""
    words = [__file__, "--one", task, str(size), "--num-envs", str(num_envs)]
    run = subprocess.run([sys.executable, *words], stdout=subprocess.PIPE, check=True)
    return json.loads(run.stdout)


def measure(task: str, size: int, num_envs: int) -> dict:
    """Return the numbers of one team, by name."""
    makes = []
    for _ in range(2):
        started = time.process_time()
        single = made(task, size, 1)
        makes.append(time.process_time() - started)
    resets = [timed(single.reset) for _ in range(20)]
    before = resident_kb()
    many = made(task, size, MEMORY_ENVS)
    many.reset(seed=0)
    many.step(many.idle())
    grown = resident_kb() - before
    env = made(task, size, num_envs)
    rates = compare_rates(env, lambda _: env.expert(), time.process_time)
    return {
        "env": rates.env,
        "bare": rates.bare,
        "ratio": rates.ratio,
        "strain": with_strain(env, made(task, size, num_envs, strain=True)),
        "calls": calls(env),
        "kb": grown / MEMORY_ENVS,
        "first": makes[0],
        "second": makes[1],
        "reset": 1e3 * median(resets),
    }


def made(task: str, size: int, num_envs: int, **options: bool) -> cg.VectorEnv:
    """Return worlds of a team of Pandas."""
    team = cg.task(task, "panda", num_robots=size)
    return cg.VectorEnv(team, num_envs, num_threads=1, **options)


def with_strain(env: cg.VectorEnv, other: cg.VectorEnv) -> float:
    """Return the speed of worlds with strain over that of the same without."""
    ratios = []
    for each in (env, other):
        each.reset(seed=0, stagger=True)
    for _ in range(ROUNDS):
        times = [0.0, 0.0]
        for _ in range(STEPS):
            actions = env.expert()
            for i, each in enumerate((env, other)):
                times[i] += timed(lambda own=each, now=actions: own.step(now))
        ratios.append(times[0] / times[1])
    return median(ratios)


def calls(env: cg.VectorEnv) -> int:
    """Return how many of our functions a control step calls, at the least."""
    least = []
    for _ in range(5):
        actions, count = env.expert(), [0]

        def look(frame, event, _, count=count):
            code = frame.f_code
            if event == "call" and code.co_filename.startswith(OURS):
                # Comprehensions and generators belong to their functions.
                count[0] += not code.co_name.startswith("<")

        sys.setprofile(look)
        try:
            env.step(actions)
        finally:
            sys.setprofile(None)
        least.append(count[0])
    return min(least)


def timed(call) -> float:
    """Return how much time of the processor a call takes, in s."""
    started = time.process_time()
    call()
    return time.process_time() - started


if __name__ == "__main__":
    main()
