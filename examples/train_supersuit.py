"""One network for every robot, by SuperSuit's vector environment.

    pip install -e ".[sb3]" supersuit
    python examples/train_supersuit.py

SuperSuit makes the agents of some PettingZoo environments the rows of one batch. Here
Stable-Baselines3's PPO learns from it, so all robots share what is learned. Robots with
other spaces are padded. SuperSuit steps its environments one by one, so this is slow:
`SB3VecEnv` steps all worlds at once, with one agent for all robots.
"""

import numpy as np
import supersuit
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

import collaborative_gym as cg

ROLLOUT = 50
"""Control steps in each row between two updates."""


def main(
    env: str = "PokeTaskSawyers-v0",
    total_steps: int = 100_000,
    num_envs: int = 8,
    episodes: int = 20,
) -> None:
    """Train, and evaluate what was learned.

    Args:
      env: an environment id.
      total_steps: steps of single robots to learn from.
      num_envs: environments beside one another.
      episodes: to evaluate.
    """
    single = cg.make(env)
    padded = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(single))
    rows = supersuit.pettingzoo_env_to_vec_env_v1(padded)
    envs = VecMonitor(
        supersuit.concat_vec_envs_v1(rows, num_envs, base_class="stable_baselines3")
    )
    print(f"{envs.num_envs} rows, {num_envs} of each robot")
    model = PPO(  # `seed` would fail: SuperSuit's batch has none
        "MlpPolicy",
        envs,
        n_steps=ROLLOUT,
        batch_size=ROLLOUT * envs.num_envs // 2,
        gamma=0.95,
        device="cpu",
        verbose=1,
    )
    model.learn(total_steps, log_interval=10)
    envs.close()

    size = envs.observation_space.shape[0]

    def act(observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Ask the network for each robot, padded as SuperSuit does it."""
        actions = {}
        for agent, own in observations.items():
            seen = np.pad(own, ((0, 0), (0, size - own.shape[1])))
            answer, _ = model.predict(seen, deterministic=True)
            actions[agent] = answer[:, : single.action_space(agent).shape[0]]
        return actions

    print(cg.evaluate(env, act, episodes=episodes).to_markdown())


if __name__ == "__main__":
    tyro.cli(main)
