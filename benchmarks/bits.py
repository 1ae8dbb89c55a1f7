"""Hashes of episodes, to show that a change of the code changes no bit of any.

    python benchmarks/bits.py --output before.json
    ... change the code ...
    python benchmarks/bits.py --compare before.json

`--starts default lost late` takes other starts than the default ones: presets, and
"late", where all actions come a control step late.

Every observation, reward, end and metric of the first 100 episodes of seed 0 counts,
for each environment and for random actions, the expert and the baseline, if it has one.
Hashes of different processors or library versions may differ; compare within one
machine.
"""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np

import collaborative_gym as cg
from collaborative_gym.policies.policy import is_shipped

POLICIES = ("random", "expert", "baseline")


def main() -> None:
    """Write the hashes, or compare them with those of a file."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, help="file to write the hashes to")
    parser.add_argument("--compare", type=Path, help="file to compare them with")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--envs", nargs="*", default=cg.list_envs())
    parser.add_argument("--starts", nargs="*", default=["default"])
    options = parser.parse_args()
    hashes = {
        f"{env_id} {policy} {start}": digest(env_id, policy, options.episodes, start)
        for env_id in options.envs
        for start in options.starts
        for policy in POLICIES
        if policy != "baseline" or is_shipped(policy, env_id)
    }
    if options.output:
        options.output.write_text(json.dumps(hashes, indent=2) + "\n")
    if options.compare:
        before = json.loads(options.compare.read_text())
        changed = [name for name in hashes if hashes[name] != before.get(name)]
        for name in changed:
            print(f"changed: {name}")
        print(f"{len(hashes) - len(changed)} of {len(hashes)} hashes are the same")
        raise SystemExit(bool(changed))


def digest(env_id: str, policy_name: str, episodes: int, start: str = "default") -> str:
    """Return the hash of the episodes of one environment, policy and start."""
    how = cg.Randomization(delay=1) if start == "late" else start
    env = cg.make_vec(env_id, episodes, seed=0, randomization=how)
    policy = cg.load_policy(policy_name, env)
    total = hashlib.sha256()
    observations, _ = env.reset()
    ended = np.zeros(episodes, bool)
    while not ended.any():
        observations, rewards, terminated, truncated, infos = env.step(
            policy(observations)
        )
        ended = infos["ended"]
        for agent in env.agents:
            total.update(infos["final_observation"][agent].tobytes())
            for each in (rewards, terminated, truncated):
                total.update(np.ascontiguousarray(each[agent]).tobytes())
        for each in by_side(infos["success"]):
            total.update(each.tobytes())
    metrics = infos["metrics"]
    for name in ("return", "completion", "performance", "length", "time_to_success"):
        for each in by_side(metrics[name]):
            total.update(np.ascontiguousarray(each).tobytes())
    env.close()
    return total.hexdigest()


def by_side(given: dict[str, np.ndarray] | np.ndarray) -> list[np.ndarray]:
    """Return the arrays of several sides, or that of the only one."""
    return list(given.values()) if isinstance(given, dict) else [given]


if __name__ == "__main__":
    main()
