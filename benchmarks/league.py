"""Whether a league gets stronger as it learns, and how it does against the expert.

    python benchmarks/league.py ENV_ID RUN [--output FOLDER]

RUN is the folder of a run with `--opponent league`. Some of its main policy's copies,
evenly over the run, its latest policy and the expert play a tournament. It prints the
card of the latest policy: the ratings over the steps at which the copies were made, the
rank correlation of the two (Spearman's), and which share of the decided episodes the
latest policy wins against the expert from each seat. With an output the tournament can
be stopped and goes on.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

import collaborative_gym as cg
from collaborative_gym.evaluation.machine import describe_machine
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.learning.baselines import training_commands
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.config import Resources


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
    share, draws = wins / max(wins + losses, 1), len(points) - wins - losses
    return f"from {seat} {wins} of {wins + losses} ({100 * share:.0f} %; {draws} draws)"


def card(run: Path, steps: dict[str, int], result: cg.Tournament) -> str:
    """Return what is told of a league, as Markdown."""
    checkpoint = Checkpoint.load(run / "last.pt")
    settings, done = checkpoint.settings, checkpoint.backend["steps"]
    robots = ", ".join(dict.fromkeys(settings.identity.robot_names))
    machine = describe_machine()
    ratings = [result.ratings[name].mean for name in steps]
    lines = [
        f"# {settings.identity.name}: baseline",
        "",
        f"One policy for each seat ({robots}), the main policy of a league, trained by"
        " PPO from scratch; it never played the scripted player.",
        "",
        *training_commands(settings, Resources()),
        f"- {done / 1e6:.1f} M environment steps of all members together, in"
        f" {checkpoint.seconds / 60:.0f} min",
        f"- machine: {machine['cpu']}, {machine['cores']} cores, one of them used,"
        f" MuJoCo {machine['mujoco']}",
        f"- rank correlation of steps and ratings of the copies:"
        f" {correlation(list(steps.values()), ratings):.2f}",
        f"- episodes that it wins against the expert, of those decided:"
        f" {', '.join(decided(result, seat) for seat in result.turns)}",
        "",
        f"Everybody against everybody from each seat, {result.settings['episodes']}"
        " episodes of seed 0 each; ratings with 95 % intervals:",
        "",
    ]
    table = []
    for name, standing in result.standings.items():
        rating = result.ratings[name]
        when = f"{steps.get(name, done) / 1e6:.2f} M" if name != "expert" else ""
        told = f"{rating.mean:.0f} ({rating.low:.0f} to {rating.high:.0f})"
        counts = standing.wins, standing.draws, standing.losses
        table.append([name, when, told, *map(str, counts)])
    heads = ["player", "steps", "rating", "wins", "draws", "losses"]
    return "\n".join([*lines, markdown_table(heads, table, words=1)]) + "\n"


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
    print(card(options.run, steps, result), end="")


if __name__ == "__main__":
    main()
