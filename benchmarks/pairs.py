"""How experts and baselines of pairs do from other starts, late and with each other.

    python benchmarks/pairs.py [ENV_ID ...] [--episodes N]

It writes docs/tables/pairs.md: completion in %, on `default` starts, with every action
one control step late, from `lost` and from `hard` starts; and of the baseline in either
seat beside the expert. With names it prints the rows alone.
"""

import argparse
from pathlib import Path

import collaborative_gym as cg
from collaborative_gym.evaluation.table import markdown_table

TABLE = Path(__file__).parents[1] / "docs" / "tables" / "pairs.md"
STARTS = {
    "default": {},
    "late": {"delay": 1},
    "`lost`": {"randomization": "lost"},
    "`hard`": {"randomization": "hard"},
}
SEATS = {
    "baseline, expert": {"robot_1": "baseline", "robot_2": "expert"},
    "expert, baseline": {"robot_1": "expert", "robot_2": "baseline"},
}


def completion(
    env_id: str, policy, episodes: int, *, delay: int = 0, **settings
) -> str:
    """Return a cell."""
    task = cg.task(env_id, **settings)
    report = cg.evaluate(task, policy, episodes=episodes, delay=delay)
    return f"{100 * report.completion.mean:.3g}"


def main() -> None:
    """Print each row as soon as it is measured; write the page of all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    cooperative = "Task", "BalancePathSawyers", "BalancePathJaco"
    pairs = [each for each in cg.list_envs() if any(n in each for n in cooperative)]
    parser.add_argument("envs", nargs="*", metavar="ENV_ID")
    parser.add_argument("--episodes", type=int, default=200)
    options = parser.parse_args()
    rows = []
    for env_id in options.envs or pairs:
        cells = [
            " / ".join(
                completion(env_id, policy, options.episodes, **given)
                for policy in ("expert", "baseline")
            )
            for given in STARTS.values()
        ]
        cells += [completion(env_id, cast, options.episodes) for cast in SEATS.values()]
        rows.append([env_id, *cells])
        print(*rows[-1], sep="; ", flush=True)
    if not options.envs:
        heads = ["environment", *STARTS, *SEATS]
        TABLE.write_text(
            "# Pairs from other starts, late, and with the expert\n\n"
            f"Completion in % of {options.episodes} episodes, expert / baseline; then"
            " of the baseline as robot_1 and as robot_2 beside the expert."
            " `python benchmarks/pairs.py` measures it.\n\n"
            f"{markdown_table(heads, rows)}"
        )


if __name__ == "__main__":
    main()
