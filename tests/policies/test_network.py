import json
import os
import zipfile
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

import collaborative_gym as cg
from collaborative_gym.blocks import Block, Layout
from collaborative_gym.policies import network
from collaborative_gym.policies.network import (
    ACTIVATIONS,
    NetworkPolicy,
    Part,
    Weights,
)
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.task import RANDOMIZATIONS

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


IDENTITY = Identity(
    name="Carry",
    task="Carry",
    robots={agent: {"name": "panda", "digest": "0"} for agent in AGENTS},
    config={"height": 0.6},
    versions={},
)


def made(
    parts,
    weights,
    activation="relu",
    observation=3,
    action=2,
    identity=IDENTITY,
    layout=None,
):
    """Return a policy of two robots with equal spaces."""
    return NetworkPolicy(
        parts,
        weights,
        activation=activation,
        identity=identity,
        layout=layout
        or Layout.of_sizes(
            dict.fromkeys(AGENTS, observation), dict.fromkeys(AGENTS, action)
        ),
        metadata={"steps": 7},
    )


@pytest.fixture
def policies():
    """Return a policy of each kind: one network each, one shared, one for all."""
    each = {agent: drawn_weights(3, 2, i) for i, agent in enumerate(AGENTS)}
    told = [Part((agent,), "shared", i, 2) for i, agent in enumerate(AGENTS)]
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
    assert loaded.metadata == {"steps": 7} and loaded.identity == IDENTITY
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


def test_it_serves_only_whom_it_commands(policies, observations):
    whole = policies["each"](observations)
    for kind in ("each", "shared"):
        whole = policies[kind](observations)
        alone = policies[kind].serving(["robot_2"])
        assert alone.agents == ("robot_2",)
        actions = alone({"robot_2": observations["robot_2"]})
        assert list(actions) == ["robot_2"]
        assert np.array_equal(actions["robot_2"], whole["robot_2"])
    with pytest.raises(ValueError, match="commands robot_2, not robot_1; name another"):
        alone.serving(AGENTS)
    with pytest.raises(ValueError, match="commands robot_1 and robot_2 together"):
        policies["all"].serving(["robot_1"])
    assert policies["all"].serving(AGENTS).agents == AGENTS


def fitting(make_env, **settings):
    """Return a policy without sense for the small task with these settings."""
    identity = Identity.of(make_env(**settings).task)
    parts = [Part((agent,), "same") for agent in AGENTS]
    weights = {"same": drawn_weights(19, 8)}
    return made(parts, weights, observation=19, action=8, identity=identity)


@pytest.mark.parametrize("shape", [(3,), (4, 5), (4, 2, 3)])
def test_observations_of_another_shape_are_refused(policies, shape):
    message = r"observation of robot_2 has shape \(.*not \(num_envs, 3\); for one world"
    observations = {"robot_1": np.zeros((4, 3)), "robot_2": np.zeros(shape)}
    for policy in policies.values():
        with pytest.raises(ValueError, match=message):
            policy(observations)


def test_it_must_be_for_the_environment(make_env):
    policy = fitting(make_env)
    policy.check(make_env())
    policy.check(make_env(randomization=RANDOMIZATIONS["paper"], max_episode_steps=5))
    for settings, message in (
        (
            {"height": 0.7},
            r"for Carry with 2 panda; here height is 0\.7, not 0\.6\..*--any-env",
        ),
        ({"robots": ("panda", "jaco")}, "here robot_2 is jaco, not panda. Train one"),
    ):
        other = make_env(**settings)
        with pytest.raises(ValueError, match=message):
            policy.check(other)
    policy.check(make_env(height=0.7), any_env=True)
    poke = cg.make_vec("PokeTaskSawyers-v0", 1)
    # Where the sizes do not fit, any_env would not help.
    message = "here task is Poke, not Carry. Train one for this environment$"
    with pytest.raises(ValueError, match=message):
        policy.check(poke)
    message = "here the observation of robot_1 has 21 numbers, not 19; .* of robot_2"
    with pytest.raises(ValueError, match=message):
        policy.check(poke, any_env=True)


def named(env, change):
    """Return a policy of the small task whose first robot's blocks are changed."""
    layout = env.world.definition.layout
    blocks = change(dict(layout.observation["robot_1"]))
    layout = replace(layout, observation={**layout.observation, "robot_1": blocks})
    parts, weights = [Part((agent,), "same") for agent in AGENTS], drawn_weights(19, 8)
    identity = Identity.of(env.task)
    return made(parts, {"same": weights}, identity=identity, layout=layout)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda own: {"eye" if n == "tcp" else n: b for n, b in own.items()},
            "the observation of robot_1 has no block 'eye'; .*an extra block 'tcp'",
        ),
        (
            lambda own: own | {"cube": Block("cube", (1, 3), unit="mm")},
            r"block 'cube' of shape \(3,\), not \(1, 3\); .* of unit 'm', not 'mm'$",
        ),
        (lambda own: dict(reversed(own.items())), "another order: joints, tcp, cube"),
    ],
)
@pytest.mark.parametrize("any_env", [False, True])
def test_other_blocks_of_the_same_size_are_refused(make_env, change, message, any_env):
    env = make_env()
    named(env, lambda own: own).check(env)
    policy = named(env, change)
    with pytest.raises(ValueError, match=message):
        policy.check(env, any_env=any_env)


def test_a_file_has_the_blocks_by_name(make_env, tmp_path):
    env = make_env()
    policy = named(env, lambda own: own)
    policy.save(tmp_path / "policy.safetensors")
    loaded = NetworkPolicy.load(tmp_path / "policy.safetensors")
    assert loaded.layout == env.world.definition.layout
    assert loaded.digest == policy.digest


@pytest.mark.parametrize("kind", ["each", "shared", "all"])
def test_a_file_without_blocks_is_read_and_written_as_it_was(
    policies, observations, kind, tmp_path
):
    path = tmp_path / "policy.safetensors"
    policies[kind].save(path)
    description = json.loads(read(path)[1]["collaborative_gym"][64:])
    assert description["format"] == 2
    assert description["observation_sizes"] == dict.fromkeys(AGENTS, 3)
    assert all(
        set(part) == {"agents", "weights", "index"} for part in description["parts"]
    )
    NetworkPolicy.load(path).save(tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


def test_a_shared_network_knows_its_seats_when_it_plays_one(make_env, tmp_path):
    env = make_env()
    layout = env.world.definition.layout
    parts = [Part((agent,), "shared", i, 2) for i, agent in enumerate(AGENTS)]
    weights = {"shared": drawn_weights(21, 8)}
    whole = made(parts, weights, identity=Identity.of(env.task), layout=layout)
    whole.serving(["robot_2"]).save(tmp_path / "policy.safetensors")
    alone = NetworkPolicy.load(tmp_path / "policy.safetensors")
    rows = {agent: np.ones((2, 19), np.float32) for agent in AGENTS}
    assert np.array_equal(alone(rows)["robot_2"], whole(rows)["robot_2"])


def test_networks_must_fit_the_sizes():
    with pytest.raises(ValueError, match="from 3 to 2 numbers has arrays of shapes"):
        made([Part(("robot_1",), "a")], {"a": drawn_weights(4, 2)})
    with pytest.raises(ValueError, match="two networks command one agent"):
        made([Part(("robot_1",), "a")] * 2, {"a": drawn_weights(3, 2)})
    with pytest.raises(ValueError, match="no activation 'rleu'"):
        made([], {}, activation="rleu")


def read(path):
    """Return the tensors and the metadata of a file."""
    with safe_open(path, framework="numpy") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, file.metadata()  # noqa: SIM118


def edited(change):
    """Return what changes a file's description, and its digest too."""

    def spoil(path):
        tensors, metadata = read(path)
        description = json.loads(metadata["collaborative_gym"][64:])
        text = json.dumps(change(description, tensors) or description)
        digest = network._digest(text, tensors)
        save_file(tensors, path, {"collaborative_gym": digest + text})

    return spoil


def without(name):
    return edited(lambda description, tensors: description.pop(name) and None)


SPOILT = {
    "empty": (lambda path: path.write_bytes(b""), ""),
    "text": (lambda path: path.write_text("text"), ""),
    "short": (lambda path: path.write_bytes(path.read_bytes()[:-8]), ""),
    "foreign": (lambda path: save_file({"a": np.zeros(1)}, path), "its format is None"),
    "no JSON": (
        lambda path: save_file({}, path, {"collaborative_gym": 64 * "0" + "{"}),
        "line 1",
    ),
    "a list": (edited(lambda description, tensors: [1]), "'list'"),
    "a number": (edited(lambda description, tensors: 1), "'int'"),
    "format": (edited(lambda d, tensors: d.update(format=7)), "its format is 7"),
    **{
        f"without {name}": (without(name), f"it has no {name!r}")
        for name in ("parts", "activation", "identity", "action_sizes", "metadata")
    },
    "agents": (edited(lambda d, t: d["parts"][0].update(agents=[3])), ""),
    "activation": (edited(lambda d, t: d.update(activation="rleu")), "rleu"),
    "identity": (edited(lambda d, t: d.update(identity=[])), "not the identity"),
    "sizes": (edited(lambda d, t: d.update(action_sizes={"robot_1": 2})), "robot_2"),
    "weights": (edited(lambda d, t: t.clear()), "it has no 'robot_1/mean'"),
    "shape": (
        edited(lambda d, t: t.update({"robot_1/mean": np.zeros(4, "f4")})),
        "from 3 to 2 numbers",
    ),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_a_spoilt_file_is_refused_in_one_sentence(policies, tmp_path, kind):
    path = tmp_path / "policy.safetensors"
    policies["each"].save(path)
    spoil, message = SPOILT[kind]
    spoil(path)
    with pytest.raises(ValueError, match="is not a policy, or is damaged: ") as caught:
        NetworkPolicy.load(path)
    words = str(caught.value)
    assert message in words and str(path) in words and "\n" not in words
    assert words.endswith("or fetch the file again")


def test_no_flipped_bit_goes_unnoticed(policies, tmp_path):
    path = tmp_path / "policy.safetensors"
    policies["shared"].save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for place in rng.integers(0, 8 * len(whole), 300):
        spoilt = bytearray(whole)
        spoilt[place // 8] ^= 1 << (place % 8)
        path.write_bytes(spoilt)
        with pytest.raises(ValueError, match="is not a policy, or is damaged"):
            NetworkPolicy.load(path)
    for length in rng.integers(0, len(whole), 50):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="is not a policy, or is damaged"):
            NetworkPolicy.load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.safetensors"):
        NetworkPolicy.load(tmp_path / "nowhere.safetensors")


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ("_stable_baselines3_version", r"mine is a model of Stable-B.*PPO.load\(path"),
        ("mine/data.pkl", "mine is a file of torch.*folder.*ONNX"),
    ],
)
def test_files_of_other_libraries_are_called_what_they_are(tmp_path, inside, message):
    with zipfile.ZipFile(tmp_path / "mine", "w") as archive:
        archive.writestr(inside, "2.9.0")
    with pytest.raises(ValueError, match=message):
        NetworkPolicy.load(tmp_path / "mine")


@pytest.mark.parametrize("name", ["pipe", "pipe.onnx"])
def test_a_pipe_is_refused_at_once(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ValueError, match="is a pipe or a device; give a file"):
        cg.load_policy(tmp_path / name)
