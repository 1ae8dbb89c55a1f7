"""How much of each environment a team does that observes nothing.

    python benchmarks/blind.py [ENV_ID ...] [--candidates N] [--rounds N]

It is the last row of `collaborative-gym certify`, alone: the best of 24 recorded
episodes of the expert and the baseline, and one motion of all arms, which the
cross-entropy method finds from there on 32 starts. Both are judged on 500 held-out
starts of `default`. A search has converged, or its rounds were spent.
"""

import argparse
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import collaborative_gym as cg
from collaborative_gym.certificate.certify import Work
from collaborative_gym.certificate.report import upper_bound
from collaborative_gym.evaluation.table import markdown_table

COLUMNS = "environment", "one motion", "search", "a recorded episode", "up to"


def main() -> None:
    """Print a line for each environment as soon as it is measured, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    cooperative = [each for each in cg.list_envs() if "Task" in each or "Path" in each]
    parser.add_argument("envs", nargs="*", default=cooperative, metavar="ENV_ID")
    parser.add_argument("--candidates", type=int, default=48)
    parser.add_argument("--rounds", type=int, default=12)
    options = parser.parse_args()
    effort = {"candidates": options.candidates, "rounds": options.rounds}
    budget = cg.Budget(**effort, fractions=(0.5,), ppo_steps=0)
    table = []
    for env_id in options.envs:
        with TemporaryDirectory() as folder:
            given = {"seed": 0, "folder": Path(folder), "num_threads": 0}
            with closing(Work(cg.task(env_id), budget, **given)) as work:
                motion, record = work.blind_team()
        counts = [int(found.completed.sum()) for found in (motion, record)]
        bound = max(upper_bound(count, budget.episodes) for count in counts)
        one, other = (f"{count} of {budget.episodes}" for count in counts)
        search = "converged" if motion.converged else "spent"
        table.append((env_id, one, search, other, f"{100 * bound:.1f} %"))
        print(*table[-1], sep="; ", flush=True)
    print(markdown_table(COLUMNS, table))


if __name__ == "__main__":
    main()
