"""What arms do to one another, to objects and to themselves, as a table.

    python benchmarks/strain.py [--episodes N] [ENV_ID ...]
    python benchmarks/strain.py --cards LiftTaskSawyers-v0

Each environment's rows replace those of docs/tables/strain.md, which is written anew
after each; the numbers are in strain.json beside it. Each cell has the mean over
episodes and the worst of them, of the measures that `docs/concepts.md` explains. With
`--cards`, the tables of strain on baselines' cards are measured anew instead.
"""

import argparse

import collaborative_gym as cg
from collaborative_gym.evaluation.report import strain_table
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.policies.policy import SHIPPED, is_shipped
from kept import keep

ENVS = [each for each in cg.list_envs() if is_shipped("baseline", each)]
TOUCH = {
    "`contact_depth_objects`, mm": ("contact_depth_objects", 1e3, 1),
    "`contact_force_objects`, N": ("contact_force_objects", 1.0, 0),
    "`clearance`, mm": ("clearance", 1e3, 1),
    "`internal_force`, N": ("internal_force", 1.0, 0),
}
"""Columns: a measure, what it is multiplied by, and its number of digits."""

MOTORS = {
    "`torque_over_limit`": ("torque_over_limit", 1.0, 2),
    "`speed_over_limit`": ("speed_over_limit", 1.0, 2),
}
"""Columns of the second table."""

SHARE = {"`torque_limit_share`, %": ("torque_limit_share", 100.0, 1)}
"""The first table's column of means alone."""

ENERGIES = {
    "`energy`, J": ("energy", 1.0, 0),
    "`energy_commanded`, J": ("energy_commanded", 1.0, 0),
}
"""The second table's columns of means alone."""

TOUCHES = {"another arm": "contact_force_arms", "furniture": "contact_force_furniture"}
"""What is touched seldom, and the measure of how hard, in N."""


def main() -> None:
    """Measure, and bring the table or the cards up to that."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("envs", nargs="*", metavar="ENV_ID")
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--cards", action="store_true")
    options = parser.parse_args()
    for env_id in options.envs or ENVS:
        if options.cards:
            rewrite(env_id, options.threads)
            continue
        for policy in ("expert", "baseline"):
            report = cg.evaluate(
                env_id,
                policy,
                episodes=options.episodes,
                num_threads=options.threads,
            )
            row = {"episodes": options.episodes}
            every = TOUCH | MOTORS | SHARE | ENERGIES
            names = [name for name, *_ in every.values()]
            for name in [*names, *TOUCHES.values()]:
                row[name] = [report.strain[name].mean, report.strain[name].worst]
            keep("strain", (env_id, policy), row, table)


def rewrite(env_id: str, num_threads: int) -> None:
    """Write the strain of a baseline into its card, whose last table it is."""
    # The episodes that `write_baseline` measures.
    report = cg.evaluate(env_id, "baseline", episodes=1000, num_threads=num_threads)
    path = SHIPPED["baseline"] / f"{env_id}.md"
    above = path.read_text().partition("| strain |")[0]
    path.write_text(f"{above}{strain_table(report)}\n")
    print(path)


def table(numbers: dict[str, dict[str, dict]]) -> str:
    """Return the page of all rows."""
    rows = [
        ([env_id, policy], row)
        for env_id in ENVS
        for policy, row in numbers.get(env_id, {}).items()
    ]
    lengths = sorted({row["episodes"] for _, row in rows})
    torque, speed = (
        max(row[name][1] for _, row in rows)
        for name in ("torque_over_limit", "speed_over_limit")
    )
    played = " or ".join(map(str, lengths))
    return f"""The [strain](../concepts.md#strain) of experts and baselines in
{played} episodes of seed 0 on `default` (`python benchmarks/strain.py`). Each cell has
the mean over the episodes and, after the slash, the worst episode. The last column of
the first table and the last two of the second have only the mean.

## Contacts and forces

{columns(rows, TOUCH, SHARE)}

{touches(rows)}

## Motors

The greatest torque that a physics step applied is {torque:.2f} times a joint's limit,
and the greatest speed {speed:.2f} times.

{columns(rows, MOTORS, ENERGIES)}
"""


def touches(rows: list) -> str:
    """Return which rows touch what is not to be touched, and how hard at worst."""
    told = []
    for what, name in TOUCHES.items():
        hard = [
            f"{env_id}'s {policy} ({row[name][1]:.0f} N)"
            for (env_id, policy), row in rows
            if row[name][1] > 0.0
        ]
        told.append(
            f"An arm, or what it holds, touches {what} in:"
            f" {', '.join(hard) or 'no row'}."
        )
    return " ".join(told)


def columns(rows: list, both: dict, means: dict) -> str:
    """Return a table of measures of which the worst counts, too, and of means."""
    lines = [
        [
            *key,
            *(
                " / ".join(f"{factor * value:.{digits}f}" for value in row[name])
                for name, factor, digits in both.values()
            ),
            *(
                f"{factor * row[name][0]:.{digits}f}"
                for name, factor, digits in means.values()
            ),
        ]
        for key, row in rows
    ]
    return markdown_table(["environment", "policy", *both, *means], lines, 2)


if __name__ == "__main__":
    main()
