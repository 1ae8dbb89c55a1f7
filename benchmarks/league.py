"""Whether a league gets stronger as it learns, and how it does against the expert.

    python benchmarks/league.py ENV_ID RUN [--output FOLDER]

RUN is the folder of a run with `--opponent league`. Some of its main policy's copies,
evenly over the run, its latest policy and the expert play a tournament. Told are the
ratings over the steps at which the copies were made, the rank correlation of the two
(Spearman's), and which share of the decided episodes the latest policy wins against the
expert from each seat. With an output the tournament can be stopped and goes on.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

import collaborative_gym as cg


def copies(run: Path, count: int) -> dict[str, int]:
    """Return some of the main policy's copies, first and last ones too, with steps."""
    players = json.loads((run / "league.json").read_text())["players"]
    steps = {
        name: player["steps"]
        for name, player in players.items()
        if name.startswith("main-")
    }
    names = sorted(steps, key=steps.__getitem__)
    places = np.unique(np.linspace(0, len(names) - 1, count).round().astype(int))
    return {names[place]: steps[names[place]] for place in places}


def correlation(first: list[float], second: list[float]) -> float:
    """Return Spearman's rank correlation of values without ties."""
    ranks = [np.argsort(np.argsort(values)) for values in (first, second)]
    return float(np.corrcoef(*ranks)[0, 1])


def decided(result: cg.Tournament, seat: str) -> str:
    """Return how many of the decided episodes the latest policy wins from a seat."""
    i, j = result.players.index("main"), result.players.index("expert")
    points = result.values["points"][result.turns.index(seat), i, j]
    wins, losses = int((points == 1.0).sum()), int((points == 0.0).sum())
    share = 100.0 * wins / max(wins + losses, 1)
    return f"{seat}: {wins} of {wins + losses} decided episodes ({share:.0f} %)"


def main() -> None:
    """Play the tournament and print what came of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("env", metavar="ENV_ID")
    parser.add_argument("run", metavar="RUN", type=Path)
    parser.add_argument("--copies", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    steps = copies(options.run, options.copies)
    policies = {name: f"{options.run}/{name}" for name in steps}
    policies |= {"main": str(options.run), "expert": "expert"}
    console = Console()
    with Progress(console=Console(stderr=True)) as progress:
        bar = progress.add_task(options.env, total=1.0)
        result = cg.tournament(
            options.env,
            policies,
            episodes=options.episodes,
            num_threads=1,
            output=options.output,
            on_progress=lambda share: progress.update(bar, completed=share),
        )
    table = Table("player", "steps", "rating", "wins", "draws", "losses")
    for name, standing in result.standings.items():
        rating = result.ratings[name]
        table.add_row(
            name,
            f"{steps[name] / 1e6:.2f} M" if name in steps else "",
            f"{rating.mean:.0f} ({rating.low:.0f} to {rating.high:.0f})",
            *(str(n) for n in (standing.wins, standing.draws, standing.losses)),
        )
    console.print(table)
    ratings = [result.ratings[name].mean for name in steps]
    rank = correlation(list(steps.values()), ratings)
    print(f"rank correlation of steps and ratings of the copies: {rank:.2f}")
    for seat in result.turns:
        print(f"main against the expert from {decided(result, seat)}")


if __name__ == "__main__":
    main()
