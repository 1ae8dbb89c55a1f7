import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies.network import NetworkPolicy, Part, Weights
from collaborative_gym.policies.policy import SHIPPED
from collaborative_gym.tasks.identity import Identity


@pytest.fixture
def random_network(tmp_path, monkeypatch):
    """Return a function that ships a baseline with random weights; it gives its path.

    No other baseline is shipped during the test.
    """
    monkeypatch.setitem(SHIPPED, "baseline", tmp_path)

    def ship(env_id):
        env = cg.make_vec(env_id, 1, num_threads=1)
        rng = np.random.default_rng(0)
        layout = env.world.definition.layout
        weights = {}
        for agent, inputs in layout.observation_sizes.items():
            outputs = layout.action_sizes[agent]
            weight = rng.normal(0.0, 0.3, (outputs, inputs)).astype(np.float32)
            weights[agent] = Weights(
                np.zeros(inputs, np.float32),
                np.ones(inputs, np.float32),
                ((weight, np.zeros(outputs, np.float32)),),
            )
        parts = [Part((agent,), agent) for agent in env.agents]
        path = tmp_path / f"{env_id}.safetensors"
        NetworkPolicy(
            parts,
            weights,
            activation="tanh",
            identity=Identity.of(env.task),
            layout=layout,
            metadata={},
        ).save(path)
        return path

    return ship
