"""How often 95 % intervals over few runs hold what they should, by drawing runs.

    python benchmarks/coverage.py

Draws runs' scores again and again from distributions whose means are known, and counts
how often the intervals of `compare` hold them, and those of the percentile bootstrap.
Takes about half a minute.
"""

from collections.abc import Callable

import numpy as np
import tyro

from collaborative_gym.evaluation.intervals import iqm_of, mean_of, median_of, wilson
from collaborative_gym.evaluation.table import markdown_table

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]

DRAWS: dict[str, tuple[Draw, bool]] = {
    "returns, normal": (lambda rng, size: rng.normal(size=size), False),
    "returns, skewed": (lambda rng, size: -np.exp(rng.normal(0.0, 0.5, size)), False),
    "shares near 1": (lambda rng, size: rng.beta(9.0, 1.0, size), True),
    "shares, one in ten fails": (
        lambda rng, size: np.where(rng.random(size) < 0.1, 0.2, 1.0),
        True,
    ),
}
"""How scores of runs fall, and whether they are shares."""

COUNTS = (2, 3, 5, 10, 20)
RESAMPLES = 400


def bootstrap(scores: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return the ends of the percentile bootstrap's intervals of the means."""
    count = len(scores)
    drawn = rng.integers(0, count, (RESAMPLES, count))
    return tuple(np.quantile(scores[drawn].mean(axis=1), (0.025, 0.975), axis=0))


def held(estimates: list, truth: float) -> str:
    """Return how many of the intervals hold the truth, in %."""
    ends = np.array([(each.low, each.high) for each in estimates])
    if np.isnan(ends).any():
        return "-"
    return told(ends[:, 0], ends[:, 1], truth)


def told(low: np.ndarray, high: np.ndarray, truth: float) -> str:
    """Return how many of the intervals hold the truth, in %."""
    return f"{100 * np.mean((low <= truth) & (truth <= high)):.0f} %"


def main(samples: int = 4000) -> None:
    """Print the table.

    Args:
      samples: groups of runs that are drawn for each number.
    """
    rng, lines = np.random.default_rng(0), []
    for name, (draw, is_share) in DRAWS.items():
        many = np.sort(draw(rng, (1, 1_000_000))[0])
        middle = many[len(many) // 4 : -len(many) // 4].mean()
        mean, median = many.mean(), many[len(many) // 2]
        for count in COUNTS:
            scores = draw(rng, (count, samples))
            lines.append(
                [
                    name,
                    str(count),
                    told(*bootstrap(scores, rng), mean),
                    held(mean_of([scores], is_share=is_share), mean),
                    held(iqm_of([scores], is_share=is_share), middle),
                    held(median_of([scores]), median),
                ]
            )
    heads = ["scores", "runs", "mean, bootstrap", "mean"]
    heads += ["interquartile mean", "median"]
    print(markdown_table(heads, lines, words=1))
    found = []
    for share in (0.9, 0.99):
        ends = wilson(rng.binomial(32, share, 100_000) / 32, 32)
        found.append(f"{told(*ends, share)} for {share:g}")
    found = ", ".join(found)
    print(f"\nWilson's interval of a share of 32 episodes holds it in {found}.")


if __name__ == "__main__":
    tyro.cli(main)
