"""How a shared policy for sets does in teams of other sizes than it was trained in.

    python benchmarks/team_sizes.py POLICY [--stranger OTHER] [--sizes 2 3 4 5 6 8]

Each line is a team of the policy's own task and arms, on held-out starts of `default`:
completion, with 95 % intervals, of the expert, of the policy, and of teams in
which one robot, each in turn, plays another policy of the same kind, such as another
seed's. Its own size is marked.
"""

import argparse
from pathlib import Path

import numpy as np

import collaborative_gym as cg
from collaborative_gym.evaluation.report import format_statistic
from collaborative_gym.evaluation.table import markdown_table

COLUMNS = "robots", "expert", "policy", "with one stranger, mean (least)"


def main() -> None:
    """Print a line for each size as soon as it is measured, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("policy", type=Path)
    parser.add_argument("--stranger", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=[2, 3, 4, 5, 6, 8])
    parser.add_argument("--episodes", type=int, default=200)
    options = parser.parse_args()
    policy = cg.load_policy(options.policy)
    if not policy.suits_any_team:
        parser.error(f"{options.policy} is no shared policy with --network set")
    identity = policy.identity
    table = []
    for size in options.sizes:
        own = {"egocentric": True} if identity.task == "Lift" else {}
        arm, action = identity.robot_names[0], identity.action
        task = cg.task(identity.task, arm, num_robots=size, action=action, **own)

        def completion(team, task=task):
            how = {"episodes": options.episodes, "any_env": True}
            return cg.evaluate(task, team, **how).completion

        shares = [completion("expert"), completion(options.policy)]
        cells = [format_statistic(share, percent=True) for share in shares]
        if options.stranger:
            mixed = [
                completion(
                    dict.fromkeys(task.agents, options.policy)
                    | {agent: options.stranger}
                ).mean
                for agent in task.agents
            ]
            cells.append(f"{100 * np.mean(mixed):.0f} % ({100 * min(mixed):.0f} %)")
        name = f"{size}, its own" if size == len(identity.robots) else f"{size}"
        table.append((name, *cells))
        print(*table[-1], sep="; ", flush=True)
    print(markdown_table(COLUMNS[: len(table[0])], table))


if __name__ == "__main__":
    main()
