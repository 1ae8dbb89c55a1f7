"""Tianshou's PPO, with one agent that commands all robots.

pip install -e ".[tianshou]"
python examples/train_tianshou.py
"""

import numpy as np
import torch
import tyro
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

import collaborative_gym as cg
from collaborative_gym.adapters.tianshou import TianshouEnv

ROLLOUT = 50
"""Control steps in each world between two updates."""


def main(
    env: str = "PokeTaskSawyers-v0",
    total_steps: int = 300_000,
    num_envs: int = 64,
    episodes: int = 100,
) -> None:
    """Train, and evaluate what was learned.

    Args:
      env: an environment id.
      total_steps: environment steps to learn from.
      num_envs: worlds beside one another.
      episodes: to evaluate.
    """
    envs = TianshouEnv(cg.make_vec(env, num_envs))
    seen, done = envs.observation_space[0].shape, envs.action_space[0].shape
    hidden = {"state_shape": seen, "hidden_sizes": [256, 256]}
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(**hidden), action_shape=done, unbounded=True
    )
    torch.nn.init.constant_(actor.sigma_param, np.log(0.3))
    algorithm = PPO(
        policy=ProbabilisticActorPolicy(
            actor=actor,
            dist_fn=lambda given: Independent(Normal(*given), 1),
            action_space=envs.action_space[0],
        ),
        critic=ContinuousCritic(preprocess_net=Net(**hidden)),
        optim=AdamOptimizerFactory(lr=5e-4),
        gamma=0.95,
        max_grad_norm=0.5,
        return_scaling=True,
    )
    steps = ROLLOUT * num_envs
    collector = Collector(algorithm, envs, VectorReplayBuffer(steps, num_envs))
    trained = algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=collector,
            max_epochs=max(1, total_steps // (10 * steps)),
            epoch_num_steps=min(total_steps, 10 * steps),
            collection_step_num_env_steps=steps,
            update_step_num_repetitions=5,
            batch_size=steps // 2,
        )
    )
    print(f"{trained.timing.total_time:.0f} s of training")
    envs.close()

    sizes = [space.shape[0] for space in envs.vector_env.single_action_spaces.values()]

    @torch.no_grad()
    def act(observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Give all robots' observations to the network, and its actions to them."""
        (mean, _), _ = actor(np.concatenate([*observations.values()], axis=1))
        parts = np.split(mean.numpy(), np.cumsum(sizes)[:-1], axis=1)
        return dict(zip(observations, parts, strict=True))

    print(cg.evaluate(env, act, episodes=episodes).to_markdown())


if __name__ == "__main__":
    tyro.cli(main)
