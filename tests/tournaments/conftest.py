"""Small tasks and policies of which a tournament can be made."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies.network import NetworkPolicy, Part, Weights
from collaborative_gym.tasks.identity import Identity


@pytest.fixture
def duel(carry):
    """Return a task of two sides: who moves more scores in each step."""

    def lead(facts):
        # The height of a hand says how far its arm has moved up.
        return facts.tcp["robot_1"][0][:, 2] - facts.tcp["robot_2"][0][:, 2]

    def reward(self, facts, actions):
        own = {"robot_1": lead(facts), "robot_2": -lead(facts)}
        return {agent: {"lead": own[agent]} for agent in self.agents}

    parts = {
        "sides": (("robot_1",), ("robot_2",)),
        "reward": reward,
        "success": lambda self, facts: (lead(facts) > 0.05, lead(facts) < -0.05),
        "performing": lambda self, facts: (lead(facts) > 0.05, lead(facts) < -0.05),
        "score": lambda self, facts: (1 * (lead(facts) > 0.05), lead(facts) < -0.05),
    }
    base = carry()
    task = type("Duel", (type(base),), parts)
    return task([cg.get_robot("panda")] * 2, base.config)


@pytest.fixture
def network(tmp_path):
    """Return a function that writes a policy with random weights; it gives its path."""

    def write(task, name, agents=None, seed=0, one_network=False):
        env = cg.VectorEnv(task, 1, num_threads=1)
        agents = agents or env.agents
        layout = env.world.definition.layout
        rng, weights = np.random.default_rng(seed), {}
        parts = [Part((agent,), agent) for agent in agents]
        if one_network:
            parts = [Part(tuple(agents), "all")]
        for part in parts:
            inputs, outputs = (
                sum(sizes[agent] for agent in part.agents)
                for sizes in (layout.observation_sizes, layout.action_sizes)
            )
            weight = rng.normal(0.0, 0.3, (outputs, inputs)).astype(np.float32)
            weights[part.weights] = Weights(
                np.zeros(inputs, np.float32),
                np.ones(inputs, np.float32),
                ((weight, np.zeros(outputs, np.float32)),),
            )
        path = tmp_path / name
        NetworkPolicy(
            parts,
            weights,
            activation="tanh",
            identity=Identity.of(task),
            layout=layout,
            metadata={},
        ).save(path)
        return path

    return write
