"""How well policies of several seeds do, as a table: one recipe, many seeds.

    python benchmarks/seeds.py RUN...

RUN is a training run's folder, or a policy file. Its row replaces that of the same
environment and seed in docs/tables/seeds.md, which is written anew after each; the
numbers are in seeds.json beside it. The files that are shipped have rows of their own,
and so have seeds that learned with the expert's advice.
All policies of an environment play the same starts of `default`, which no run was
trained on or chosen by, and some of them with all actions one control step late.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import collaborative_gym as cg
from collaborative_gym.evaluation.intervals import wilson
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.policy import SHIPPED
from kept import keep

COMPLETION, PERFORMANCE = 0.98, 0.95
"""What a seed has to reach."""

ADVISED = ", advised"
"""What follows a seed that learned with the expert's advice."""


def main() -> None:
    """Measure, and bring the table up to that."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", nargs="+", metavar="RUN", type=Path)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--late-episodes", type=int, default=200)
    options = parser.parse_args()
    for run in options.runs:
        policy = cg.load_policy(run)
        env, seed = policy.identity.name, str(policy.metadata["seed"])
        runs = list(runs_of(policy.metadata))
        if run.resolve().parent == SHIPPED["baseline"]:
            seed = "baseline"
        elif any(run["hyperparameters"].get("imitation") for run in runs):
            seed += ADVISED
        row = measured(env, policy, options.episodes, options.late_episodes)
        row["steps"] = [run["steps"] for run in runs[::-1]]
        keep("seeds", (env, seed), row, table)


COLUMNS = ("environment", "seed", "steps of its runs, M", "completion")
COLUMNS += ("performance", "return", "late", "at torque limits", "energy")


LEGEND = """\
One recipe, many seeds (`python benchmarks/seeds.py RUN...`). Each row has one policy.
"baseline" is the shipped one, and "advised" marks a seed that learned with the expert's
advice.

- **steps of its runs, M**: millions of environment steps; a sum where a run began with
  the policy of another.
- **completion**, **performance**, **return**, **energy**: means over {episodes:,}
  held-out starts of `default`. If all {episodes:,} episodes are completed, the 95 %
  interval of the completion is {least:.1f} to 100 % (Wilson).
- **late**: completion of {late:,} episodes in which every action comes one control step
  late.
- **at torque limits**: the share of the time at or above 99 % of a joint's torque
  limit, mean over joints (`torque_limit_share`).
"""
"""What is above the table."""


def measured(env: str, policy: NetworkPolicy, episodes: int, late: int) -> dict:
    """Return a row's numbers."""
    report = cg.evaluate(env, policy, episodes=episodes, num_threads=1)
    delayed = cg.evaluate(env, policy, episodes=late, delay=1, num_threads=1)
    return {
        "episodes": [episodes, late],
        "completion": report.completion.mean,
        "performance": report.performance.mean,
        "mean_reward": report.mean_reward.mean,
        "late": delayed.completion.mean,
        "torque_limit_share": report.strain["torque_limit_share"].mean,
        "energy": report.strain["energy"].mean,
    }


def runs_of(metadata: dict) -> Iterator[dict]:
    """Yield what a policy's file says of its run, and of those that it began with."""
    yield metadata
    if "metadata" in metadata.get("start", {}):
        yield from runs_of(metadata["start"]["metadata"])


def table(rows: dict[str, dict[str, dict]]) -> str:
    """Return the page."""
    return "\n".join(lines(rows)) + "\n"


def lines(rows: dict[str, dict[str, dict]]) -> Iterator[str]:
    """Yield the lines of the page, in the order of the environments."""
    table, counts = [], []
    for env in sorted(rows, key=cg.list_envs().index):
        for seed in sorted(rows[env], key=order):
            table.append(line(env, seed, rows[env][seed]))
        reached = sum(is_enough(row) for row in rows[env].values())
        counts.append(f"{env}: {reached} of {len(rows[env])}")
    episodes, late = next(iter(next(iter(rows.values())).values()))["episodes"]
    least = 100 * wilson(1.0, episodes)[0]
    yield LEGEND.format(episodes=episodes, late=late, least=least)
    yield markdown_table(COLUMNS, table, words=2)
    yield ""
    yield (
        f"Seeds that reach {100 * COMPLETION:.0f} % completion and"
        f" {100 * PERFORMANCE:.0f} % performance: " + "; ".join(counts) + "."
    )


def order(seed: str) -> tuple[int, int]:
    """Return where a seed stands: after the baseline, and those with advice last."""
    if seed == "baseline":
        return 0, 0
    return 1 + seed.endswith(ADVISED), int(seed.removesuffix(ADVISED))


def is_enough(row: dict) -> bool:
    """Return whether a seed reached what it has to."""
    return row["completion"] >= COMPLETION and row["performance"] >= PERFORMANCE


def line(env: str, seed: str, row: dict) -> list[str]:
    """Return the cells of a seed's line."""
    return [
        env,
        seed,
        " + ".join(f"{length / 1e6:.2f}" for length in row["steps"]),
        f"{100 * row['completion']:.1f} %",
        f"{100 * row['performance']:.1f} %",
        f"{row['mean_reward']:.1f}",
        f"{100 * row['late']:.1f} %",
        f"{100 * row['torque_limit_share']:.1f} %",
        f"{row['energy']:.0f} J",
    ]


if __name__ == "__main__":
    main()
