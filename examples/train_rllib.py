"""An RLlib script of your own, on environments that RLlib knows by their ids.

    pip install -e ".[rllib]"
    python examples/train_rllib.py

All that RLlib needs is the import of `collaborative_gym.envs.rllib`; a runner that
steps its worlds in one batch, `BatchedEnvRunner`, collects several times as fast as
RLlib's own. Prints the mean return and environment steps per second of each iteration;
then saves a checkpoint, restores the algorithm from it, evaluates what the robots
learned and writes a picture of how they stand at the end of an episode.
"""

import logging
import os
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import ray
import torch
import tyro
from PIL import Image
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.rl_module import RLModule

import collaborative_gym as cg
import collaborative_gym.envs.rllib  # registers every id with RLlib
from collaborative_gym.envs.rllib_runner import BatchedEnvRunner


def policy_of(modules: Mapping[str, RLModule]):
    """Return trained modules, one for each robot, as a policy without noise."""

    def policy(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        actions = {}
        for agent, module in modules.items():
            with torch.no_grad():
                batch = {"obs": torch.from_numpy(observations[agent])}
                logits = module.forward_inference(batch)["action_dist_inputs"]
            distribution = module.get_inference_action_dist_cls().from_logits(logits)
            actions[agent] = distribution.to_deterministic().sample().numpy()
        return actions

    return policy


def show(env_id: str, policy, file: Path) -> None:
    """Write a picture of the end of an episode."""
    env = cg.make(env_id, render_mode="rgb_array")
    observations, _ = env.reset(seed=0)
    while env.agents:
        rows = {agent: row[None] for agent, row in observations.items()}
        actions = {agent: rows[0] for agent, rows in policy(rows).items()}
        observations, *_ = env.step(actions)
    Image.fromarray(env.render()).save(file)
    env.close()


def main(
    env: str = "PokeTaskSawyers-v0",
    total_steps: int = 200_000,
    steps_per_iteration: int = 4_000,
    runners: int = 0,
    episodes: int = 100,
    output: Path = Path("runs/rllib"),
) -> None:
    """Train a policy for each robot, save, restore, evaluate and show them.

    Args:
      env: an environment id.
      total_steps: environment steps to learn from.
      steps_per_iteration: environment steps between two updates.
      runners: processes that collect; 0 for this one.
      episodes: to evaluate.
      output: folder of the checkpoint and the picture.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # tells nobody of the run
    # "local", so as not to join a cluster that happens to run on this machine.
    ray.init("local", include_dashboard=False, logging_level=logging.ERROR)
    agents = cg.make(env).possible_agents
    config = (
        PPOConfig()
        .environment(env, env_config={"randomization": "default"})
        .env_runners(
            env_runner_cls=BatchedEnvRunner,
            num_env_runners=runners,
            # Each world plays an episode of 200 steps in an iteration.
            num_envs_per_env_runner=max(
                1, steps_per_iteration // 200 // max(1, runners)
            ),
        )
        .multi_agent(policies=set(agents), policy_mapping_fn=lambda agent, *_: agent)
        .rl_module(
            # In layers that they share, a critic's large errors drown out the policy.
            model_config=DefaultModelConfig(
                fcnet_hiddens=[256, 256],
                fcnet_activation="relu",
                vf_share_layers=False,
            )
        )
        .training(
            gamma=0.95,
            lr=5e-4,
            train_batch_size_per_learner=steps_per_iteration,
            minibatch_size=steps_per_iteration // 4,
            num_epochs=10,
            use_kl_loss=False,
            vf_clip_param=float("inf"),
        )
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    steps, started = 0, time.perf_counter()
    while steps < total_steps:
        found = algorithm.train()["env_runners"]
        steps = int(found["num_env_steps_sampled_lifetime"])
        rate = steps / (time.perf_counter() - started)
        mean = found["episode_return_mean"]
        print(f"{steps:,} steps: return {mean:.1f}, {rate:,.0f} steps per second")

    algorithm.save_to_path((output / "checkpoint").absolute())
    algorithm.stop()
    algorithm = Algorithm.from_checkpoint((output / "checkpoint").absolute())
    policy = policy_of({agent: algorithm.get_module(agent) for agent in agents})
    print(cg.evaluate(env, policy, episodes=episodes).to_markdown())
    show(env, policy, output / "end.png")
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    tyro.cli(main)
