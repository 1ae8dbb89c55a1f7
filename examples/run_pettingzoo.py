"""One episode as a PettingZoo ParallelEnv, with dictionaries by robot.

    python examples/run_pettingzoo.py
    python examples/run_pettingzoo.py --env Lift --robots panda jaco --policy expert

The script prints what each robot earned, by the terms of its reward, and whether and
when they reached the goal together. It ends at once.
"""

from collections import Counter

import tyro

import collaborative_gym as cg


def main(
    env: str = "PassTaskSawyers-v0",
    robots: tuple[str, ...] | None = None,
    policy: str = "baseline",
    seed: int = 0,
) -> None:
    """Play an episode.

    Args:
      env: an environment id or a task's name.
      robots: other arms, in order.
      policy: baseline, expert, random, or a path to one that you trained.
      seed: which start.
    """
    world = cg.make(env, robots=robots)
    act = cg.load_policy(policy, world)
    earned = {agent: Counter() for agent in world.possible_agents}
    observations, infos = world.reset(seed=seed)
    while world.agents:
        observations, rewards, terminated, truncated, infos = world.step(
            act(observations)
        )
        for agent in rewards:
            earned[agent].update(infos[agent]["reward_terms"])
    for agent, terms in earned.items():
        named = ", ".join(f"{name} {value:.2f}" for name, value in terms.items())
        print(f"{agent}: {terms.total():.2f} ({named})")
    metrics = infos["robot_1"]["metrics"]  # of all robots, in the episode's last step
    if metrics["completion"]:
        print(f"reached the goal after {metrics['time_to_success']:.1f} s")
    else:
        print("did not reach the goal")
    world.close()


if __name__ == "__main__":
    tyro.cli(main)
