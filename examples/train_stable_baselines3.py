"""PPO of Stable-Baselines3, with one agent that commands all robots.

    pip install stable-baselines3
    python examples/train_stable_baselines3.py

Stable-Baselines3 makes batches of its own by stepping single environments one by one
(`make_vec_env`). `gymnasium.make_vec` steps all worlds at once; the class `Worlds`
passes them on. Prints how many environment steps a second takes either way, how PPO
learns, and an evaluation of what it learned. A minute or two.
"""

import time
from collections.abc import Mapping

import gymnasium
import numpy as np
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import nn

import collaborative_gym as cg

ROLLOUT = 50
"""Control steps in each world between two updates."""


class Worlds(VecEnv):
    """A Gymnasium batch that resets in the same step, as Stable-Baselines3 wants it."""

    def __init__(self, envs: gymnasium.vector.VectorEnv):
        self.envs = envs
        spaces = envs.single_observation_space, envs.single_action_space
        super().__init__(envs.num_envs, *spaces)

    def reset(self):
        observations, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observations

    def step_async(self, actions):
        self._actions = actions

    def step_wait(self):
        observations, rewards, terminated, truncated, infos = self.envs.step(
            self._actions
        )
        by_world = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(terminated | truncated):
            by_world[i] = {
                # With these two PPO knows that the world goes on, and from where.
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "is_success": bool(infos["final_info"]["metrics"]["completion"][i]),
            }
        return observations, rewards, terminated | truncated, by_world

    def close(self):
        self.envs.close()

    def get_attr(self, attr_name, indices=None):
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError("the worlds of a batch have all in common")

    def env_method(self, method_name, *args, indices=None, **kwargs):
        raise NotImplementedError("the worlds of a batch have all in common")

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False for _ in self._get_indices(indices)]


def rate(envs: VecEnv, steps: int) -> float:
    """Return environment steps per second, with the same random actions all along."""
    actions = np.stack([envs.action_space.sample() for _ in range(envs.num_envs)])
    envs.reset()
    started = time.perf_counter()
    for _ in range(steps):
        envs.step(actions)
    return steps * envs.num_envs / (time.perf_counter() - started)


def policy_of(model: PPO, normalizer: VecNormalize, env: cg.VectorEnv):
    """Return the one agent as a policy from observations to actions, both by robot."""
    sizes = [space.shape[0] for space in env.single_action_spaces.values()]

    def policy(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        rows = np.concatenate(list(observations.values()), axis=1)
        rows = normalizer.normalize_obs(rows)
        actions, _ = model.predict(rows, deterministic=True)
        parts = np.split(actions, np.cumsum(sizes)[:-1], axis=1)
        return dict(zip(observations, parts, strict=True))

    return policy


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
    batch = gymnasium.make_vec(env, num_envs=num_envs)
    worlds = Worlds(batch)
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

    policy = policy_of(model, normalized, batch.unwrapped.vector_env)
    print(cg.evaluate(env, policy, episodes=episodes).to_markdown())
    worlds.close()


if __name__ == "__main__":
    tyro.cli(main)
