"""How well the shipped policies and the experts stand disturbances, as a table.

    python benchmarks/robustness.py [--policies POLICY ...] [--episodes N] [ENV_ID ...]

Each environment's rows replace those of the same policies in docs/tables/robustness.md,
which is written anew after each; the numbers are in robustness.json beside it.
"""

import argparse

import collaborative_gym as cg
from collaborative_gym.evaluation.intervals import wilson
from collaborative_gym.evaluation.play import DISTURBANCES, measure_robustness
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.policies.policy import is_shipped
from kept import keep

ENVS = [each for each in cg.list_envs() if is_shipped("baseline", each)]


def main() -> None:
    """Measure, and bring the table up to that."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("envs", nargs="*", metavar="ENV_ID")
    parser.add_argument("--policies", nargs="+", default=["baseline", "expert"])
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for env_id in options.envs or ENVS:
        for policy in options.policies:
            reports = measure_robustness(
                env_id,
                policy,
                episodes=options.episodes,
                seed=options.seed,
                num_threads=1,
            )
            row: dict[str, object] = {"episodes": options.episodes}
            for name, report in reports.items():
                row[name] = [report.completion.mean, report.performance.mean]
            keep("robustness", [f"{env_id} {policy}"], row, table)


def table(rows: dict[str, dict]) -> str:
    """Return the rows as Markdown, in the order of the environments."""
    cells = []
    for name in sorted(rows, key=lambda each: cg.list_envs().index(each.split()[0])):
        shares = (rows[name][each] for each in DISTURBANCES)
        told = (" / ".join(f"{100 * share:.0f}" for share in pair) for pair in shares)
        cells.append([*name.split(), *told])
    heads = ["environment", "policy", *DISTURBANCES]
    counts = sorted({row["episodes"] for row in rows.values()})
    low = 100 * wilson(1.0, counts[0])[0]
    told = " to ".join(str(count) for count in dict.fromkeys([counts[0], counts[-1]]))
    note = (
        f"Completion / performance in %, over {told} episodes of each cell. For 100 %"
        f" of {counts[0]} episodes, the 95 % interval is {low:.0f} to 100 % (Wilson)."
    )
    return f"{note}\n\n{markdown_table(heads, cells, words=2)}\n"


if __name__ == "__main__":
    main()
