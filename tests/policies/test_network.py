import json
from itertools import pairwise

import numpy as np
import pytest
from safetensors.numpy import save_file

from collaborative_gym.policies.network import (
    ACTIVATIONS,
    NetworkPolicy,
    Part,
    Weights,
)

AGENTS = ("robot_1", "robot_2")


def drawn_weights(inputs, outputs, seed=0):
    """Return weights of a network with two hidden layers."""
    rng = np.random.default_rng(seed)
    widths = (inputs, 5, 4, outputs)
    layers = tuple(
        (np.float32(rng.normal(0, 0.3, (out, of))), np.float32(rng.normal(0, 0.3, out)))
        for of, out in pairwise(widths)
    )
    return Weights(np.full(inputs, 0.5, "f4"), np.full(inputs, 2.0, "f4"), layers)


def made(parts, weights, activation="relu", observation=3, action=2):
    """Return a policy of two robots with equal spaces."""
    facts = {
        "environment": "Carry",
        "robots": ["panda", "panda"],
        "observation_sizes": dict.fromkeys(AGENTS, observation),
        "action_sizes": dict.fromkeys(AGENTS, action),
    }
    return NetworkPolicy(parts, weights, activation, facts)


@pytest.fixture
def policies():
    """Return a policy of each kind: one network each, one shared, one for all."""
    each = {agent: drawn_weights(3, 2, i) for i, agent in enumerate(AGENTS)}
    told = [Part((agent,), "shared", i) for i, agent in enumerate(AGENTS)]
    return {
        "each": made([Part((agent,), agent) for agent in AGENTS], each),
        "shared": made(told, {"shared": drawn_weights(5, 2)}),
        "all": made([Part(AGENTS, "team")], {"team": drawn_weights(6, 4)}),
    }


@pytest.fixture
def observations():
    """Return observations of seven worlds."""
    rng = np.random.default_rng(1)
    return {agent: np.float32(rng.normal(size=(7, 3))) for agent in AGENTS}


@pytest.mark.parametrize(
    ("activation", "expected"),
    [("relu", 2.0 - 0.25), ("elu", 2.0 + np.expm1(-1.0) / 4 - 0.25), ("tanh", None)],
)
def test_actions_are_what_a_hand_computes(activation, expected):
    layers = (
        (np.float32([[1.0], [-0.5]]), np.zeros(2, "f4")),
        (np.float32([[1.0, 0.25]]), np.float32([-0.25])),
    )
    weights = Weights(np.float32([1.0]), np.float32([2.0]), layers)
    if expected is None:
        expected = np.tanh(2.0) + 0.25 * np.tanh(-1.0) - 0.25
    parts = [Part(("robot_1",), "a")]
    policy = made(parts, {"a": weights}, activation, 1, 1)
    # (5 - 1) / 2 = 2 goes in; what comes out is cut off at 1.
    out = policy({"robot_1": np.float32([[5.0]])})["robot_1"]
    assert out == pytest.approx(min(expected, 1.0))
    # Far inputs count as five standard deviations.
    far = [policy({"robot_1": np.float32([[x]])})["robot_1"] for x in (-9.0, -1e6)]
    assert far[0] == far[1]


@pytest.mark.parametrize("kind", ["each", "shared", "all"])
def test_a_file_brings_the_same_policy_back(policies, observations, kind, tmp_path):
    policy = policies[kind]
    policy.save(tmp_path / "a" / "policy.safetensors")
    loaded = NetworkPolicy.load(tmp_path / "a" / "policy.safetensors")
    assert loaded.facts == policy.facts
    actions = policy(observations), loaded(observations)
    for agent in AGENTS:
        assert np.array_equal(actions[0][agent], actions[1][agent])
        assert actions[1][agent].shape == (7, 2)
        assert actions[1][agent].dtype == np.float32
        assert abs(actions[1][agent]).max() <= 1.0


@pytest.mark.parametrize("kind", ["each", "shared", "all"])
def test_a_world_does_not_depend_on_the_others(policies, observations, kind):
    together = policies[kind](observations)
    for worlds in ([0], [3], [5, 1], [6, 5, 4, 3, 2, 1, 0]):
        some = policies[kind]({a: rows[worlds] for a, rows in observations.items()})
        assert all(np.array_equal(some[a], together[a][worlds]) for a in AGENTS)


def test_a_shared_network_is_told_which_robot_it_commands(policies, observations):
    alike = dict.fromkeys(AGENTS, observations["robot_1"])
    actions = policies["shared"](alike)
    assert not np.allclose(actions["robot_1"], actions["robot_2"])


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_extreme_observations_give_finite_actions(activation):
    policy = made(
        [Part(AGENTS, "team")], {"team": drawn_weights(6, 4)}, activation=activation
    )
    for value in (3e38, -3e38):
        actions = policy(dict.fromkeys(AGENTS, np.full((1, 3), value, np.float32)))
        assert all(np.isfinite(action).all() for action in actions.values())


def test_it_must_fit_the_environment(make_env, policies):
    message = (
        "for Carry with panda, panda: its observation sizes are robot_1 3, robot_2 3,"
        " the environment's robot_1 19, robot_2 19"
    )
    with pytest.raises(ValueError, match=message):
        policies["each"].check(make_env())
    made([], {}, observation=19, action=8).check(make_env())
    with pytest.raises(ValueError, match="its action sizes are robot_1 7"):
        made([], {}, observation=19, action=7).check(make_env())


def other_format(path, policy):
    text = json.dumps({"format": 7})
    save_file({"a": np.zeros(1)}, path, {"collaborative_gym": text})


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path, policy: path.write_bytes(b""), "is no policy, or is damaged"),
        (lambda path, policy: path.write_text("text"), "is no policy, or is damaged"),
        (
            lambda path, policy: path.write_bytes(path.read_bytes()[:-8]),
            "is no policy, or is damaged",
        ),
        (
            lambda path, policy: save_file({"a": np.zeros(1)}, path),
            "its format is None, not 1",
        ),
        (other_format, "its format is 7, not 1"),
    ],
)
def test_another_file_is_refused(policies, tmp_path, spoil, message):
    path = tmp_path / "policy.safetensors"
    policies["each"].save(path)
    spoil(path, policies["each"])
    with pytest.raises(ValueError, match=message):
        NetworkPolicy.load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.safetensors"):
        NetworkPolicy.load(tmp_path / "nowhere.safetensors")
