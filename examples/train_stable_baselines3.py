"""PPO of Stable-Baselines3, with one agent that commands all robots.

    pip install -e ".[sb3]"
    python examples/train_stable_baselines3.py

Stable-Baselines3 makes batches of its own by stepping single environments one by one
(`make_vec_env`). `SB3VecEnv` steps all worlds at once. Prints how many environment
steps a second takes either way, how PPO learns, and an evaluation of what it learned. A
minute or two.
"""

import time

import numpy as np
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import nn

import collaborative_gym as cg
from collaborative_gym.adapters.sb3 import SB3VecEnv

ROLLOUT = 50
"""Control steps in each world between two updates."""


def rate(envs: VecEnv, steps: int) -> float:
    """Return environment steps per second, with the same random actions all along."""
    actions = np.stack([envs.action_space.sample() for _ in range(envs.num_envs)])
    envs.reset()
    started = time.perf_counter()
    for _ in range(steps):
        envs.step(actions)
    return steps * envs.num_envs / (time.perf_counter() - started)


def main(
    env: str = "PokeTaskSawyers-v0",
    total_steps: int = 300_000,
    num_envs: int = 64,
    episodes: int = 100,
) -> None:
    """Compare the batches, train and evaluate.

    Args:
      env: an environment id.
      total_steps: environment steps to learn from.
      num_envs: worlds beside one another.
      episodes: to evaluate.
    """
    worlds = SB3VecEnv(cg.make_vec(env, num_envs, seed=1))  # `evaluate` plays 0
    singles = make_vec_env(env, n_envs=num_envs)
    for name, envs in (("one by one", singles), ("at once", worlds)):
        print(f"{name}: {rate(envs, ROLLOUT):,.0f} environment steps per second")
    singles.close()

    normalized = VecNormalize(VecMonitor(worlds), gamma=0.95)
    model = PPO(
        "MlpPolicy",
        normalized,
        n_steps=ROLLOUT,
        batch_size=ROLLOUT * num_envs // 2,
        n_epochs=5,
        gamma=0.95,
        learning_rate=5e-4,
        policy_kwargs={
            "net_arch": [256, 256],
            "activation_fn": nn.ReLU,
            "log_std_init": np.log(0.3),
        },
        seed=0,
        device="cpu",
        verbose=1,
    )
    model.learn(total_steps, log_interval=10)

    print(cg.evaluate(env, model, episodes=episodes).to_markdown())
    worlds.close()


if __name__ == "__main__":
    tyro.cli(main)
