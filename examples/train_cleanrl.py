"""PPO in one file, as CleanRL writes it: no library between you and the numbers.

    pip install -e ".[train]"
    python examples/train_cleanrl.py

One agent commands all robots. Gymnasium's vector wrappers count the episodes and
normalize what the agent sees and earns. As these wrappers need it, a world starts anew
in the step after its episode's end. So the observation after a step is always the
episode's own, and its value is the right one to bootstrap from. The steps that only
start a world are left out of the loss. Evaluates the policy behind its
normalization, as a function.
"""

from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
import tyro
from gymnasium.wrappers.vector import (
    NormalizeObservation,
    NormalizeReward,
    RecordEpisodeStatistics,
)
from torch import nn
from torch.distributions import Normal

import collaborative_gym as cg


@dataclass(frozen=True)
class Args:
    """What to train, and how."""

    env: str = "PokeTaskSawyers-v0"
    """an environment id"""
    total_steps: int = 300_000
    """environment steps to learn from"""
    num_envs: int = 64
    """worlds beside one another"""
    rollout: int = 50
    """control steps in each world between two updates"""
    epochs: int = 5
    """times that an update goes through the rollout"""
    minibatches: int = 2
    """gradient steps in an epoch"""
    learning_rate: float = 5e-4
    gamma: float = 0.95
    gae_lambda: float = 0.95
    clip: float = 0.2
    """largest change of an action's probability that pays"""
    episodes: int = 100
    """to evaluate"""


class Agent(nn.Module):
    """A policy and its critic."""

    def __init__(self, observations: int, actions: int):
        super().__init__()
        self.policy = network(observations, actions)
        self.critic = network(observations, 1)
        self.log_std = nn.Parameter(torch.full((actions,), np.log(0.3)))

    def forward(self, rows: torch.Tensor) -> Normal:
        """Return how actions are drawn."""
        return Normal(self.policy(rows), self.log_std.exp())


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Return a small network whose first answers are near zero."""
    last = nn.Linear(256, outputs)
    nn.init.orthogonal_(last.weight, 0.01)
    hidden = [nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU()]
    return nn.Sequential(*hidden, last)


class Rollout:
    """What was seen, done and earned in some steps of all worlds."""

    def __init__(self, envs: gymnasium.vector.VectorEnv, args: Args):
        shape, size = (args.rollout, args.num_envs), envs.single_action_space.shape
        self.observations = torch.zeros(*shape, *envs.single_observation_space.shape)
        self.actions, self.log_probs = torch.zeros(*shape, *size), torch.zeros(shape)
        self.values, self.rewards = torch.zeros(shape), torch.zeros(shape)
        self.terminated, self.ended = torch.zeros(shape), torch.zeros(shape)
        self.is_start = torch.zeros(shape, dtype=torch.bool)

    @torch.no_grad()
    def collect(self, envs, agent, observations, begins):
        """Fill it; return the last observations and which worlds start next."""
        for t in range(len(self.rewards)):
            rows = torch.as_tensor(observations, dtype=torch.float32)
            drawn = agent(rows)
            actions = drawn.sample()
            self.observations[t], self.actions[t] = rows, actions
            self.log_probs[t] = drawn.log_prob(actions).sum(1)
            self.values[t] = agent.critic(rows)[:, 0]
            self.is_start[t] = torch.as_tensor(begins)
            observations, rewards, terminated, truncated, _ = envs.step(actions.numpy())
            begins = terminated | truncated
            self.rewards[t] = torch.as_tensor(rewards)
            self.terminated[t] = torch.as_tensor(terminated)
            self.ended[t] = torch.as_tensor(begins)
        return observations, begins

    @torch.no_grad()
    def advantages(self, agent: Agent, observations, args: Args) -> torch.Tensor:
        """Return how much better than expected each step was (GAE)."""
        rows = torch.as_tensor(observations, dtype=torch.float32)
        after, gain = agent.critic(rows)[:, 0], torch.zeros(args.num_envs)
        gains = torch.zeros_like(self.rewards)
        for t in reversed(range(args.rollout)):
            target = self.rewards[t] + args.gamma * (1 - self.terminated[t]) * after
            kept = args.gamma * args.gae_lambda * (1 - self.ended[t])
            gains[t] = gain = target - self.values[t] + kept * gain
            after = self.values[t]
        return gains


def update(agent, optimizer, rollout: Rollout, gains: torch.Tensor, args: Args) -> None:
    """Improve the agent by what was collected."""
    counts = ~rollout.is_start.flatten()
    observations, actions = (
        rollout.observations.flatten(0, 1),
        rollout.actions.flatten(0, 1),
    )
    log_probs, values = rollout.log_probs.flatten(), rollout.values.flatten()
    gains = gains.flatten()
    for _ in range(args.epochs):
        shuffled = torch.randperm(int(counts.sum()))
        for part in counts.nonzero()[shuffled, 0].chunk(args.minibatches):
            drawn = agent(observations[part])
            ratio = (drawn.log_prob(actions[part]).sum(1) - log_probs[part]).exp()
            gain = (gains[part] - gains[part].mean()) / (gains[part].std() + 1e-8)
            clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
            policy_loss = -torch.minimum(ratio * gain, clipped * gain).mean()
            error = agent.critic(observations[part])[:, 0] - values[part] - gains[part]
            loss = policy_loss + 0.5 * error.square().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimizer.step()


class Normalized(nn.Module):
    """A policy behind the normalization that it learned with."""

    def __init__(self, policy: nn.Module, wrapper: NormalizeObservation):
        super().__init__()
        statistics = wrapper.obs_rms
        scale = np.sqrt(statistics.var + wrapper.epsilon)
        self.policy = policy
        self.register_buffer("mean", torch.as_tensor(statistics.mean).float())
        self.register_buffer("scale", torch.as_tensor(scale).float())

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the actions."""
        return self.policy((rows - self.mean) / self.scale)


def playing(policy: nn.Module, worlds: gymnasium.vector.VectorEnv):
    """Return a network's policy, from rows by robot to rows by robot."""
    spaces = worlds.unwrapped.vector_env.single_action_spaces
    ends = np.cumsum([space.shape[0] for space in spaces.values()])[:-1]

    def act(observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        rows = np.concatenate([*observations.values()], axis=1)
        with torch.no_grad():
            actions = policy(torch.as_tensor(rows)).clamp(-1, 1).numpy()
        return dict(zip(spaces, np.split(actions, ends, axis=1), strict=True))

    return act


def main(args: Args) -> None:
    """Train a policy and evaluate it."""
    torch.manual_seed(0)
    worlds = gymnasium.make_vec(
        args.env, num_envs=args.num_envs, autoreset_mode="NextStep"
    )
    counted = RecordEpisodeStatistics(worlds, buffer_length=args.num_envs)
    normalized = NormalizeObservation(counted)
    envs = NormalizeReward(normalized, args.gamma)
    agent = Agent(
        worlds.single_observation_space.shape[0], worlds.action_space.shape[1]
    )
    optimizer = torch.optim.Adam(agent.parameters(), args.learning_rate)
    rollout = Rollout(envs, args)
    observations, _ = envs.reset(seed=1)  # `evaluate` plays seed 0
    begins = np.zeros(args.num_envs, bool)
    per_update = args.rollout * args.num_envs
    for steps in range(per_update, args.total_steps + per_update, per_update):
        observations, begins = rollout.collect(envs, agent, observations, begins)
        gains = rollout.advantages(agent, observations, args)
        update(agent, optimizer, rollout, gains, args)
        if counted.return_queue:
            print(f"{steps:,} steps: return {np.mean(counted.return_queue):.1f}")
    policy = playing(Normalized(agent.policy, normalized), worlds)
    print(cg.evaluate(args.env, policy, episodes=args.episodes).to_markdown())
    envs.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
