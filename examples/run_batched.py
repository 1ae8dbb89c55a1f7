"""Hundreds of worlds stepped together, which start their next episodes by themselves.

    python examples/run_batched.py
    python examples/run_batched.py --num-envs 1024 --policy random

Every array has a row for each world. A step that ends an episode also starts the next
one: `step` returns the first observation of the new episode, and
`infos["final_observation"]` has the last one of the old episode. The script prints the
mean return and completion of each batch of episodes, and the environment steps per
second. It takes seconds.
"""

import time

import tyro

import collaborative_gym as cg


def main(
    env: str = "LiftTaskSawyers-v0",
    num_envs: int = 256,
    steps: int = 400,
    policy: str = "baseline",
    seed: int = 0,
) -> None:
    """Step a batch of worlds; an episode lasts 200 steps.

    Args:
      env: an environment id or a task's name.
      num_envs: how many worlds.
      steps: control steps in each world.
      policy: baseline, expert, random, or a path to one that you trained.
      seed: of the episodes, which are counted 0, 1, 2 ... over all worlds.
    """
    envs = cg.make_vec(env, num_envs)
    act = cg.load_policy(policy, envs)
    observations, infos = envs.reset(seed=seed)
    for agent, rows in observations.items():
        print(f"{agent} observes {rows.shape}")
    started = time.perf_counter()
    for step in range(steps):
        observations, rewards, terminated, truncated, infos = envs.step(
            act(observations)
        )
        ended = infos["ended"]
        if not ended.any():
            continue
        # No episode ends because of its state: all are truncated, and a learner takes
        # the value of what follows from the last observation, not from the next first.
        last = infos["final_observation"]["robot_1"][ended]
        first = observations["robot_1"][ended]
        metrics = infos["metrics"]
        print(
            f"step {step + 1}: {ended.sum()} episodes ended with return"
            f" {metrics['return'][ended].mean():.2f}, completion"
            f" {metrics['completion'][ended].mean():.0%}; robot_1 observed"
            f" {last[0, :3].round(2)} last and {first[0, :3].round(2)} first"
        )
    seconds = time.perf_counter() - started
    print(f"{steps * num_envs / seconds:,.0f} environment steps per second")


if __name__ == "__main__":
    tyro.cli(main)
