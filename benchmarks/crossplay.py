"""How policies of one environment get on with one another, as a table.

    python benchmarks/crossplay.py ENV_ID [NAME=]POLICY... [--table NAME]

All pairings are played. The environment's part replaces that in docs/tables/NAME.md
(crossplay.md unless told otherwise), which is written anew; the numbers are in the JSON
beside it. With an output the tournament can be stopped and goes on.
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np

import collaborative_gym as cg
from collaborative_gym.evaluation.intervals import wilson
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.tournaments.result import format_measure
from kept import keep


def numbers(result: cg.Tournament) -> dict:
    """Return what is kept of a tournament: who played, and means by measure."""
    means = {
        measure: [[cell.mean for cell in row.values()] for row in matrix.values()]
        for measure, matrix in result.matrices.items()
    }
    standings = {
        name: {
            "worst": standing.worst,
            "self-play": {m: own.mean for m, own in standing.self_play.items()},
            "cross-play": {
                m: [own.mean, own.low, own.high]
                for m, own in standing.cross_play.items()
            },
        }
        for name, standing in result.standings.items()
    }
    return {
        "episodes": result.settings["episodes"],
        "seats": list(result.seats),
        "players": list(result.players),
        "means": means,
        "standings": standings,
        "conventions": result.conventions,
    }


def met(env: str, policies: dict[str, str]) -> dict[str, list[str]]:
    """Return the partners that each policy learned with, for those that had some."""
    with closing(cg.make_vec(env, 1, num_threads=1)) as world:
        loaded = {n: cg.load_policy(policy, world) for n, policy in policies.items()}
    known = {n: getattr(each, "metadata", {}) for n, each in loaded.items()}
    return {n: own["partners"] for n, own in known.items() if own.get("partners")}


def strangers(found: dict, name: str, partners: list[str]) -> str:
    """Return which players a policy learned with, and its completion with all kinds."""
    names, rows = found["players"], found["means"]["completion"]

    def together(group: list[str]) -> str:
        pairs = [(names.index(name), names.index(each)) for each in group]
        both = [(rows[i][j], rows[j][i]) for i, j in pairs]
        return format_measure("completion", float(np.mean(both))) if both else "-"

    def listed(group: list[str]) -> str:
        return ", ".join(f"`{each}`" for each in group)

    known = [each for each in names if each in partners]
    others = [each for each in names if each not in [*partners, name]]
    more = len({*partners} - {*known})
    line = f"- `{name}` learned with {listed(known)}"
    line += f" (and {more} others)" if more else ""
    line += f": completion {together(known)}"
    if others:
        line += f"; with strangers, {listed(others)}: {together(others)}"
    return line


def told(means: dict[str, float]) -> str:
    """Return a cell: completion and performance in %, and the return."""
    cells = [format_measure(m, mean).removesuffix(" %") for m, mean in means.items()]
    return " / ".join(cells)


def section(env: str, found: dict) -> list[str]:
    """Return an environment's part of the page."""
    names, means = found["players"], found["means"]
    cells, partners = [], []
    for i, name in enumerate(names):
        row = [told({m: means[m][i][j] for m in means}) for j in range(len(names))]
        cells.append([f"**{name}**", *row])
    for name, own in found["standings"].items():
        cross = told({m: mean for m, (mean, _, _) in own["cross-play"].items()})
        partners.append([name, own["worst"], told(own["self-play"]), cross])
    heads = ["player", "worst partner", "self-play", "cross-play"]
    tables = (
        markdown_table([" / ".join(found["seats"]), *names], cells, words=1),
        markdown_table(heads, partners, words=2),
    )
    lines = [f"### {env}", *(line for table in tables for line in ("", table)), ""]
    for seat, lists in found["conventions"].items():
        listed = "; ".join(", ".join(f"`{name}`" for name in own) for own in lists)
        lines.append(f"- groups of partners that the same {seat} suits: {listed}")
    for name, partners in found.get("met", {}).items():
        lines.append(strangers(found, name, partners))
    return [*lines, ""]


def main() -> None:
    """Play the tournament, and bring the table up to it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("env", metavar="ENV_ID")
    parser.add_argument("policies", nargs="+", metavar="[NAME=]POLICY")
    parser.add_argument("--table", default="crossplay")
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    words = (word.rpartition("=") for word in options.policies)
    policies = {name or policy: policy for name, _, policy in words}
    result = cg.tournament(
        options.env,
        policies,
        episodes=options.episodes,
        num_threads=1,
        output=options.output,
    )
    found = {**numbers(result), "met": met(options.env, policies)}
    keep(options.table, [options.env], found, page)


def page(kept: dict[str, dict]) -> str:
    """Return the page, in the order of the environments."""
    order = sorted(kept, key=cg.list_envs().index)
    fewest = min(found["episodes"] for found in kept.values())
    head = (
        "Each cell has completion in %, performance in % and return, over"
        f" {fewest} episodes or more. For 100 % of {fewest} episodes, the 95 % interval"
        f" is {100 * wilson(1.0, fewest)[0]:.0f} to 100 % (Wilson)."
    )
    lines = [line for env in order for line in section(env, kept[env])]
    return "\n".join([head, "", *lines]).rstrip() + "\n"


if __name__ == "__main__":
    main()
