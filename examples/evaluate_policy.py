"""A policy of your own: you can evaluate any function from observations to actions.

    python examples/evaluate_policy.py
    python examples/evaluate_policy.py --csv episodes.csv

Observations and actions are dictionaries by robot, of arrays with a row for each world.
Every policy plays the same episodes, so you can compare the numbers. The script prints
a Markdown table with 95 % intervals; the CSV has a line for each episode.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tyro

import collaborative_gym as cg

ENV = "PokeTaskSawyers-v0"
BASELINE = cg.load_policy(ENV)


def half_as_fast(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return half of what the baseline would do."""
    return {agent: 0.5 * rows for agent, rows in BASELINE(observations).items()}


def main(episodes: int = 100, seed: int = 0, csv: Path | None = None) -> None:
    """Evaluate the policy.

    Args:
      episodes: how many.
      seed: which episodes.
      csv: where to write them.
    """
    report = cg.evaluate(ENV, half_as_fast, episodes=episodes, seed=seed)
    print(report.to_markdown())
    if csv is not None:
        csv.write_text(report.to_csv())
        print(f"wrote {csv}")


if __name__ == "__main__":
    tyro.cli(main)
