from contextlib import closing

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

import collaborative_gym as cg

ENV = "PokeTaskSawyers-v0"


def weights(sees, does):
    rng = np.random.default_rng(0)
    return rng.normal(0.0, 0.3, (sees, does)).astype(np.float32)


def write_onnx(path, matrix):
    shape = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["seen", "matrix"], ["done"])],
        "policy",
        [shape("seen", TensorProto.FLOAT, ["worlds", len(matrix)])],
        [shape("done", TensorProto.FLOAT, ["worlds", matrix.shape[1]])],
        [numpy_helper.from_array(matrix, "matrix")],
    )
    opset = helper.make_opsetid("", 17)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=10), path)


def write_torchscript(path, matrix):
    layer = torch.nn.Linear(*matrix.shape, bias=False)
    layer.weight.data = torch.from_numpy(matrix.T.copy())
    torch.jit.trace(layer, torch.zeros(1, len(matrix))).save(path)


WRITERS = {"mine.onnx": write_onnx, "mine.pt": write_torchscript}


def by_hand(agents, matrix, sizes):
    """Return the policy that a file with this matrix is."""

    def act(observations):
        rows = np.concatenate([observations[agent] for agent in agents], axis=1)
        actions = np.clip(rows.astype(np.float32) @ matrix, -1.0, 1.0)
        return dict(zip(agents, np.split(actions, sizes, axis=1), strict=True))

    return act


@pytest.fixture
def env():
    with closing(cg.make_vec(ENV, 3, num_threads=1)) as env:
        yield env


@pytest.fixture
def sizes(env):
    sees = [space.shape[0] for space in env.single_observation_spaces.values()]
    does = [space.shape[0] for space in env.single_action_spaces.values()]
    return sees, does


pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_plays_as_its_network_does(env, sizes, tmp_path, name):
    (sees, does), path = sizes, tmp_path / name
    whole = weights(sum(sees), sum(does))
    WRITERS[name](path, whole)
    first = weights(sees[0], does[0])
    WRITERS[name](tmp_path / f"first_{name}", first)
    own = by_hand(["robot_1"], first, [])
    pairs = [
        (path, by_hand(env.agents, whole, np.cumsum(does)[:-1])),
        (
            {"robot_1": tmp_path / f"first_{name}", "robot_2": "idle"},
            {"robot_1": own, "robot_2": "idle"},
        ),
    ]
    for policy, known in pairs:
        found = [
            cg.evaluate(ENV, each, episodes=3, num_threads=1).mean_reward.mean
            for each in (policy, known)
        ]
        assert found[0] == pytest.approx(found[1], rel=1e-4)
        assert found[0] != cg.evaluate(ENV, "idle", episodes=3).mean_reward.mean


@pytest.mark.parametrize("name", WRITERS)
def test_a_network_of_other_sizes_is_refused(env, sizes, tmp_path, name):
    (sees, does), path = sizes, tmp_path / name
    WRITERS[name](path, weights(sum(sees) + 1, sum(does)))
    with pytest.raises(ValueError, match=r"does not take the \d+ numbers that robot_1"):
        cg.load_policy(path, env)
    WRITERS[name](path, weights(sum(sees), sum(does) + 1))
    with pytest.raises(ValueError, match=r"shape \(3, \d+\) for 3 worlds; the actions"):
        cg.load_policy(path, env)
    with pytest.raises(TypeError, match="needs an environment"):
        cg.load_policy(path)
    with pytest.raises(ValueError, match="start_from must be a trained policy"):
        cg.train(ENV, start_from=path, output=tmp_path / "run")


@pytest.mark.parametrize("name", ["best.pt", "policy.onnx"])
def test_another_kind_of_file_is_refused(env, tmp_path, name):
    (tmp_path / name).write_bytes(b"PK" + bytes(100))
    with pytest.raises(ValueError, match=r"is not an? (TorchScript|ONNX) file"):
        cg.load_policy(tmp_path / name, env)


def test_a_tournament_knows_a_file_that_has_changed(sizes, tmp_path):
    sees, does = map(sum, sizes)
    path, kept = tmp_path / "mine.onnx", tmp_path / "kept"
    write_onnx(path, weights(sees, does))
    players = {"mine": path, "idle": "idle"}
    given = {"episodes": 1, "num_threads": 1, "output": kept}
    cg.tournament(ENV, players, **given)
    cg.tournament(ENV, players, **given, on_pairing=pytest.fail)
    write_onnx(path, 2.0 * weights(sees, does))
    with pytest.raises(ValueError, match="mine"):
        cg.tournament(ENV, players, **given)
