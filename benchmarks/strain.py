"""A table of what arms do to one another, to things and to themselves.

    python benchmarks/strain.py
    python benchmarks/strain.py --envs LiftTaskSawyers-v0 --policies baseline
    python benchmarks/strain.py --envs LiftTaskSawyers-v0 --cards

Each cell has the mean over episodes and the worst of them, of the measures that
`docs/concepts.md` explains. The torque limits' share and the energy have means alone.
With `--cards`, the tables of strain on baselines' cards are measured anew instead.
"""

import argparse

import collaborative_gym as cg
from collaborative_gym.evaluation.report import strain_table
from collaborative_gym.policies.policy import SHIPPED

HEAD = (
    "| environment | policy | depth arms, objects, furniture, mm |"
    " force arms, objects, furniture, N | clearance, mm | torque limits, % |"
    " torque / limit | speed / limit | energy, applied, commanded, J |"
    " internal force, N | its mean, N |"
)
KINDS = "arms", "objects", "furniture"


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--envs", nargs="*", default=cg.list_envs())
    parser.add_argument("--policies", nargs="*", default=["expert", "baseline"])
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--cards", action="store_true")
    options = parser.parse_args()
    if options.cards:
        for env_id in options.envs:
            rewrite(env_id, options.threads)
        return
    print(f"{HEAD}\n{'|---' * 11}|")
    for env_id in options.envs:
        for policy in options.policies:
            report = cg.evaluate(
                env_id,
                policy,
                episodes=options.episodes,
                seed=options.seed,
                num_threads=options.threads,
            )
            print(row(report, policy), flush=True)


def rewrite(env_id: str, num_threads: int) -> None:
    """Write the strain of a baseline into its card, whose last table it is."""
    # The episodes that `write_baseline` measures.
    report = cg.evaluate(env_id, "baseline", episodes=1000, num_threads=num_threads)
    path = SHIPPED["baseline"] / f"{env_id}.md"
    above = path.read_text().partition("| strain |")[0]
    path.write_text(f"{above}{strain_table(report)}\n")
    print(path)


def row(report: cg.Report, policy: str) -> str:
    """Return the line of a report."""
    strain = report.strain

    def both(name: str, factor: float = 1.0, digits: int = 0) -> str:
        mean, worst = factor * strain[name].mean, factor * strain[name].worst
        return f"{mean:.{digits}f} / {worst:.{digits}f}"

    cells = [
        ", ".join(both(f"contact_depth_{kind}", 1e3, 1) for kind in KINDS),
        ", ".join(both(f"contact_force_{kind}") for kind in KINDS),
        both("clearance", 1e3, 1),
        f"{100 * strain['torque_limit_share'].mean:.1f}",
        both("torque_over_limit", 1.0, 2),
        both("speed_over_limit", 1.0, 2),
        f"{strain['energy'].mean:.0f}, {strain['energy_commanded'].mean:.0f}",
        both("internal_force"),
        f"{strain['internal_force_mean'].mean:.1f}",
    ]
    return f"| {report.environment} | {policy} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
