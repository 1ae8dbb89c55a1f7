"""Minari: the expert's episodes as a dataset, and a network that learns to copy them.

    pip install -e ".[train]" 'minari[hdf5]'
    python examples/train_minari.py

All episodes are played at once. Minari's own `DataCollector` plays them one after the
other, and needs JAX. The dataset is in `datasets/`, or where `MINARI_DATASETS_PATH`
says, and is made once. It knows its environment, and each episode its seed. The copy
is evaluated as a function.
"""

import os
import time
from pathlib import Path

import gymnasium
import minari
import numpy as np
import torch
import tyro
from minari.data_collector import EpisodeBuffer
from torch import nn

import collaborative_gym as cg


def collect(env: str, dataset_id: str, episodes: int) -> minari.MinariDataset:
    """Return a new dataset of the expert's episodes."""
    worlds = cg.make_vec(env, episodes)
    worlds.reset()
    for i in range(episodes):  # each as `reset(seed=i + 1)` of one environment
        observations, _ = worlds.reset(i + 1, [0], env_ids=[i])
    expert = cg.load_policy("expert", worlds)
    seen, done, earned, ends = [joined(observations)], [], [], []
    for _ in range(worlds.task.config.max_episode_steps):
        given = expert(observations)
        actions = {agent: rows.astype(np.float32) for agent, rows in given.items()}
        observations, rewards, terminated, _, infos = worlds.step(actions)
        seen.append(joined(infos["final_observation"]))
        done.append(joined(actions))
        earned.append(np.sum([*rewards.values()], axis=0))
        ends.append([terminated["robot_1"], infos["ended"]])
    seen, done, earned, ends = map(np.stack, (seen, done, earned, ends))
    buffers = []
    for i in range(episodes):
        last = int(np.argmax(ends[:, 1, i])) + 1
        terminations = ends[:last, 0, i]
        buffers.append(
            EpisodeBuffer(
                id=i,
                seed=i + 1,  # `evaluate` plays seed 0
                observations=seen[: last + 1, i],
                actions=done[:last, i],
                rewards=earned[:last, i],
                terminations=terminations,
                truncations=ends[:last, 1, i] & ~terminations,
            )
        )
    return minari.create_dataset_from_buffers(
        dataset_id, buffers, env, algorithm_name="scripted expert"
    )


def joined(by_agent: dict[str, np.ndarray]) -> np.ndarray:
    """Return the arrays of all robots side by side."""
    return np.concatenate([*by_agent.values()], axis=1)


def replayed(data: minari.MinariDataset) -> bool:
    """Return whether the recovered environment repeats the dataset's first episode."""
    env, episode = data.recover_environment(), next(data.iterate_episodes([0]))
    seed = next(iter(data.storage.get_episode_metadata([0])))["seed"]
    observations = [env.reset(seed=int(seed))[0]]
    observations += [env.step(action)[0] for action in episode.actions]
    env.close()
    return np.array_equal(observations, episode.observations)


def clone(data: minari.MinariDataset, updates: int) -> nn.Sequential:
    """Return a network that does what the dataset's robots did."""
    episodes = list(data.iterate_episodes())
    rows = np.concatenate([episode.observations[:-1] for episode in episodes])
    done = np.concatenate([episode.actions for episode in episodes])
    rows, targets = torch.as_tensor(rows), torch.as_tensor(done)
    policy = nn.Sequential(
        nn.BatchNorm1d(rows.shape[1], affine=False),
        nn.Linear(rows.shape[1], 256),
        nn.ReLU(),
        nn.Linear(256, 256),
        nn.ReLU(),
        nn.Linear(256, targets.shape[1]),
    )
    optimizer = torch.optim.Adam(policy.parameters(), 1e-3)
    for _ in range(updates):
        part = torch.randint(len(rows), (256,))
        loss = (policy(rows[part]) - targets[part]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return policy.eval()


def playing(policy: nn.Module, env: str):
    """Return a network's policy, from rows by robot to rows by robot."""
    spaces = cg.make_vec(env, 1).single_action_spaces
    ends = np.cumsum([space.shape[0] for space in spaces.values()])[:-1]

    def act(observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        with torch.no_grad():
            actions = policy(torch.as_tensor(joined(observations))).clamp(-1, 1)
        rows = np.split(actions.numpy(), ends, axis=1)
        return dict(zip(spaces, rows, strict=True))

    return act


def main(
    env: str = "PokeTaskSawyers-v0",
    episodes: int = 100,
    updates: int = 4000,
    tests: int = 100,
) -> None:
    """Collect, recover, clone and evaluate.

    Args:
      env: an environment id.
      episodes: of the expert.
      updates: gradient steps.
      tests: episodes of the copy.
    """
    # Minari 0.5.4 writes to no relative folder.
    os.environ.setdefault("MINARI_DATASETS_PATH", str(Path("datasets").resolve()))
    torch.manual_seed(0)
    dataset_id = f"{gymnasium.spec(env).name}/expert-v0"
    if dataset_id not in minari.list_local_datasets():
        started = time.perf_counter()
        collect(env, dataset_id, episodes)
        print(f"collected {dataset_id} in {time.perf_counter() - started:.1f} s")
    data = minari.load_dataset(dataset_id)
    print(f"{data.total_episodes} episodes, {data.total_steps:,} steps")
    print("replayed to the bit" if replayed(data) else "replayed otherwise")
    policy = playing(clone(data, updates), env)
    print(cg.evaluate(env, policy, episodes=tests).to_markdown())


if __name__ == "__main__":
    tyro.cli(main)
