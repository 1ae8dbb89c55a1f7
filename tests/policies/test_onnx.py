"""Networks of other libraries in ONNX files."""

from contextlib import closing

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

import collaborative_gym as cg

ENV = "PokeTaskSawyers-v0"
FLOATS = {
    np.float64: TensorProto.DOUBLE,
    np.float32: TensorProto.FLOAT,
    np.float16: TensorProto.FLOAT16,
}


def weights(sees, does, dtype=np.float32):
    rng = np.random.default_rng(0)
    return rng.normal(0.0, 0.3, (sees, does)).astype(dtype)


def write(path, nodes, sizes, kind=TensorProto.FLOAT, rows="worlds", constants=()):
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes,
        "policy",
        [value("seen", kind, [rows, sizes[0]])],
        [value("done", kind, [rows, sizes[1]])],
        constants,
    )
    opset = helper.make_opsetid("", 17)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=10), path)


def write_matrix(path, matrix, rows="worlds"):
    node = helper.make_node("MatMul", ["seen", "matrix"], ["done"])
    constants = [numpy_helper.from_array(matrix, "matrix")]
    write(path, [node], matrix.shape, FLOATS[matrix.dtype.type], rows, constants)


def by_hand(agents, matrix, sizes):
    """Return the policy that a file with this matrix is."""

    def act(observations):
        rows = np.concatenate([observations[agent] for agent in agents], axis=1)
        actions = np.clip(rows.astype(matrix.dtype) @ matrix, -1.0, 1.0)
        return dict(zip(agents, np.split(actions, sizes, axis=1), strict=True))

    return act


@pytest.fixture
def env():
    with closing(cg.make_vec(ENV, 3, num_threads=1)) as env:
        env.reset(seed=0)
        yield env


@pytest.fixture
def sizes(env):
    sees = [space.shape[0] for space in env.single_observation_spaces.values()]
    does = [space.shape[0] for space in env.single_action_spaces.values()]
    return sees, does


@pytest.mark.parametrize("dtype", FLOATS)
def test_a_file_plays_as_its_network_does(env, sizes, tmp_path, dtype):
    (sees, does), path = sizes, tmp_path / "mine.onnx"
    whole, first = (
        weights(sum(sees), sum(does), dtype),
        weights(sees[0], does[0], dtype),
    )
    write_matrix(path, whole)
    write_matrix(tmp_path / "first.onnx", first)
    observations, _ = env.reset()
    known = by_hand(env.agents, whole, np.cumsum(does)[:-1])(observations)
    for agent, actions in cg.load_policy(path, env)(observations).items():
        np.testing.assert_allclose(actions, known[agent], atol=1e-2, rtol=1e-2)
    pair = {"robot_1": tmp_path / "first.onnx", "robot_2": "idle"}
    found = cg.load_policy(pair, env)(observations)["robot_1"]
    known = by_hand(["robot_1"], first, [])(observations)["robot_1"]
    np.testing.assert_allclose(found, known, atol=1e-2, rtol=1e-2)


def test_a_network_of_other_sizes_is_refused(env, sizes, tmp_path):
    (sees, does), path = map(sum, sizes), tmp_path / "mine.onnx"
    write_matrix(path, weights(sees + 1, does))
    with pytest.raises(ValueError, match=f"takes {sees + 1} numbers; .* {sees}"):
        cg.load_policy(path, env)
    write_matrix(path, weights(sees, does + 1))
    with pytest.raises(ValueError, match=r"shape \(3, \d+\) for 3 worlds; the actions"):
        cg.load_policy(path, env)
    with pytest.raises(TypeError, match="needs an environment"):
        cg.load_policy(path)
    with pytest.raises(ValueError, match="start_from must be a trained policy"):
        cg.train(ENV, start_from=path, output=tmp_path / "run")


def test_a_batch_of_fixed_size_is_named_as_the_reason(env, sizes, tmp_path):
    path = tmp_path / "mine.onnx"
    write_matrix(path, weights(*map(sum, sizes)), rows=1)
    with pytest.raises(ValueError, match=r"for 1 rows at once, .* 3 worlds.*num_envs"):
        cg.load_policy(path, env)
    cg.evaluate(ENV, path, episodes=1, num_envs=1, num_threads=1)


def test_inputs_that_are_no_floats_are_refused(env, sizes, tmp_path):
    path = tmp_path / "mine.onnx"
    node = helper.make_node("Identity", ["seen"], ["done"])
    write(path, [node], list(map(sum, sizes)), TensorProto.INT64)
    with pytest.raises(ValueError, match=r"takes a tensor.int64.*float32"):
        cg.load_policy(path, env)


def test_a_loop_that_never_ends_is_ended(env, sizes, tmp_path, monkeypatch):
    sees, does = map(sum, sizes)
    value, path = helper.make_tensor_value_info, tmp_path / "endless.onnx"
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go_on"], ["goes_on"]),
            helper.make_node("Identity", ["kept"], ["keeps"]),
        ],
        "body",
        [
            value("i", TensorProto.INT64, []),
            value("go_on", TensorProto.BOOL, []),
            value("kept", TensorProto.BOOL, []),
        ],
        [value("goes_on", TensorProto.BOOL, []), value("keeps", TensorProto.BOOL, [])],
    )
    nodes = [
        helper.make_node("Loop", ["", "true", "true"], ["never"], body=body),
        helper.make_node("MatMul", ["seen", "matrix"], ["done"]),
    ]
    constants = [
        numpy_helper.from_array(np.array(True), "true"),
        numpy_helper.from_array(weights(sees, does), "matrix"),
    ]
    write(path, nodes, (sees, does), constants=constants)
    monkeypatch.setattr("collaborative_gym.policies.onnx.MOST_SECONDS", 0.3)
    with pytest.raises(TimeoutError, match=r"endless.onnx .*never ends"):
        cg.load_policy(path, env)


def test_another_kind_of_file_is_refused(env, tmp_path):
    (tmp_path / "policy.onnx").write_bytes(b"PK" + bytes(100))
    with pytest.raises(ValueError, match=r"is not an ONNX file"):
        cg.load_policy(tmp_path / "policy.onnx", env)


def test_a_tournament_knows_a_file_that_has_changed(sizes, tmp_path):
    sees, does = map(sum, sizes)
    path, kept = tmp_path / "mine.onnx", tmp_path / "kept"
    write_matrix(path, weights(sees, does))
    players = {"mine": path, "idle": "idle"}
    given = {"episodes": 1, "num_threads": 1, "output": kept}
    cg.tournament(ENV, players, **given)
    cg.tournament(ENV, players, **given, on_pairing=pytest.fail)
    write_matrix(path, 2.0 * weights(sees, does))
    with pytest.raises(ValueError, match="mine"):
        cg.tournament(ENV, players, **given)
