"""What every environment promises, for its own arms and for others."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

import collaborative_gym as cg

PAIRS = (("panda", "jaco"), ("jaco", "panda"))
CASES = [(env_id, None) for env_id in cg.list_envs()]
CASES += [(task, pair) for task in cg.list_tasks() for pair in PAIRS]

pytestmark = pytest.mark.filterwarnings("ignore:.*Box observation space")


@pytest.fixture(
    scope="module", params=CASES, ids=lambda case: "-".join((case[0], *(case[1] or ())))
)
def case(request):
    """Return a function that makes batches of an environment, each size once."""
    name, robots = request.param
    made = {}

    def make(num_envs, num_threads=1, copy=0):
        key = num_envs, num_threads, copy
        if key not in made:
            made[key] = cg.make_vec(
                name, num_envs, num_threads=num_threads, robots=robots
            )
        made[key].reset(seed=0)
        return made[key]

    yield make
    for env in made.values():
        env.close()


def test_spaces_hold_what_is_returned(case, play):
    env = case(7)
    observations, _ = env.reset(seed=0)
    play(env, 3)
    for agent in env.agents:
        space = env.single_observation_spaces[agent]
        assert sum(env.observation_blocks[agent].values()) == space.shape[0]
        assert all(row in space for row in observations[agent])
        robot = env.task.robots[agent]
        actions = len(robot.joints) + env.task.gripping
        assert env.single_action_spaces[agent].shape == (actions,)
        assert env.model.site(f"{agent}/tcp").id >= 0
        for joint in robot.joints:
            assert env.model.joint(f"{agent}/{joint}").id >= 0
    assert env.model.camera("overview").bodyid == 0


def test_values_are_finite_and_rewards_are_sums_of_their_terms(case):
    env = case(7)
    for _ in range(4):
        observations, rewards, _, _, infos = env.step(env.expert())
        for agent in env.agents:
            assert np.isfinite(observations[agent]).all()
            terms = infos["reward_terms"][agent]
            assert tuple(terms) == env.reward_terms[agent]
            for term in terms.values():
                assert term.shape == (7,)
                assert np.isfinite(term).all()
            np.testing.assert_allclose(rewards[agent], sum(terms.values()), rtol=1e-5)


def test_starts_are_sound(case):
    env = case(7)
    for i in range(7):
        data = env.sim.data(i)
        # Resting on a table means a depth of less than a tenth of a millimetre.
        depth = min((contact.dist for contact in data.contact), default=0.0)
        assert depth > -1e-4, contact_names(env.model, data)
        assert np.abs(data.qvel).max() == 0.0
    for arm in env.scene.arms.values():
        low, high = arm.joint_range
        angle = env.sim.qpos[:, arm.qpos]
        assert (angle > low).all()
        assert (angle < high).all()
    rows = env.reset(seed=0)[0]["robot_1"]
    assert len(np.unique(rows, axis=0)) == 7


def contact_names(model, data):
    return [
        (model.geom(contact.geom1).name, model.geom(contact.geom2).name)
        for contact in data.contact
    ]


def test_an_episode_has_the_same_bits_in_any_batch(case, play):
    expected = play(case(64), 4)
    for env in (case(1), case(7), case(7, num_threads=4)):
        for key, data in play(env, 4).items():
            assert data == expected[key]


def test_an_expert_does_the_same_in_any_batch(case):
    small, large = case(1), case(7)
    for _ in range(4):
        one, seven = small.expert(), large.expert()
        for agent in small.agents:
            np.testing.assert_array_equal(one[agent][0], seven[agent][0])
        small.step(one)
        large.step(seven)


def test_worlds_that_restart_leave_the_others_alone(case, play):
    env, other = case(7), case(7, copy=1)
    late = other.get_state([1, 3])
    late.progress["step"][:] = env.task.config.max_episode_steps - 2
    other.set_state(late, [1, 3])
    expected, seen = play(env, 4), play(other, 4)
    assert set(seen) - set(expected) == {(0, 8), (0, 10)}
    for episode in (0, 2, 4, 5, 6):
        assert seen[0, episode] == expected[0, episode]


def test_a_world_that_diverges_ends_alone(case, play, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    env, other = case(7), case(7, copy=1)
    other.sim.qpos[2, -1] = np.nan
    idle = {
        agent: np.zeros((7, *space.shape))
        for agent, space in env.single_action_spaces.items()
    }
    env.step(idle)
    _, rewards, _, truncated, infos = other.step(idle)
    assert infos["diverged"].tolist() == [False, False, True] + [False] * 4
    assert truncated["robot_1"].tolist() == infos["diverged"].tolist()
    for agent in env.agents:
        assert np.isfinite(infos["final_observation"][agent]).all()
        assert np.isfinite(rewards[agent]).all()
    expected, seen = play(env, 3), play(other, 3)
    for episode in (0, 1, 3, 4, 5, 6):
        assert seen[0, episode] == expected[0, episode]
    env.reset(seed=0, episodes=[0, 1, 9, 3, 4, 5, 6])
    assert play(env, 3)[0, 9] == seen[0, 9]


def test_a_saved_episode_continues_anywhere(case, play):
    env, other = case(7), case(7, copy=1)
    for _ in range(3):
        env.step(env.expert())
    state = env.get_state([0, 5])
    expected = play(env, 4)
    other.reset(seed=1)
    play(other, 2)
    other.set_state(state, [4, 2])
    seen = play(other, 4)
    for episode in (0, 5):
        assert seen[0, episode] == expected[0, episode]


def test_observations_describe_the_state_after_the_step(case):
    env = case(7)
    for _ in range(3):
        observations = env.step(env.expert())[0]
    for i in (0, 6):
        np.testing.assert_array_equal(env.sim.sensordata[i], env.sim.data(i).sensordata)
    again = env.set_state(env.get_state())
    for agent in env.agents:
        np.testing.assert_array_equal(again[agent], observations[agent])


def test_measuring_again_changes_nothing(case):
    env = case(7)
    for _ in range(3):
        env.step(env.expert())
    task = env.task
    memory = {name: array.copy() for name, array in task.memory.items()}
    first, second = leaves(env.facts), leaves(task.measure(env.sim))
    assert len(first) == len(second) > 2
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, two)
    for name, array in memory.items():
        np.testing.assert_array_equal(array, task.memory[name])


def leaves(value):
    """Return the arrays in nested facts."""
    if is_dataclass(value):
        parts = [getattr(value, field.name) for field in fields(value)]
    elif isinstance(value, Mapping):
        parts = list(value.values())
    elif isinstance(value, (tuple, list)):
        parts = list(value)
    else:
        return [value]
    return [leaf for part in parts for leaf in leaves(part)]


def converted(value, convert):
    """Return nested facts with their arrays converted."""
    if is_dataclass(value):
        parts = {
            field.name: converted(getattr(value, field.name), convert)
            for field in fields(value)
        }
        return replace(value, **parts)
    if isinstance(value, Mapping):
        return {name: converted(part, convert) for name, part in value.items()}
    if isinstance(value, (tuple, list)):
        return type(value)(converted(part, convert) for part in value)
    return convert(value)


def test_torch_computes_the_same(case):
    torch = pytest.importorskip("torch")
    env = case(7)
    rng = np.random.default_rng(0)
    for _ in range(3):
        actions = env.expert()
        env.step(actions)
    actions = {agent: rng.uniform(-1, 1, rows.shape) for agent, rows in actions.items()}
    task, facts = env.task, converted(env.facts, np.array)
    tensors = converted(facts, torch.from_numpy)
    on_torch = (
        task.observe(tensors),
        task.reward(tensors, converted(actions, torch.from_numpy)),
        task.success(tensors),
        task.performing(tensors),
    )
    on_numpy = (
        task.observe(facts),
        task.reward(facts, actions),
        task.success(facts),
        task.performing(facts),
    )
    for tensor, array in zip(leaves(on_torch), leaves(on_numpy), strict=True):
        assert isinstance(tensor, torch.Tensor)
        assert tensor.shape == array.shape
        np.testing.assert_allclose(tensor.numpy(), array, rtol=1e-9, atol=1e-12)


def test_gravity_acts(case):
    assert case(7).model.opt.gravity.tolist() == [0.0, 0.0, -9.81]


@pytest.mark.parametrize("env_id", cg.list_envs())
def test_contracts_of_other_libraries(env_id):
    parallel_api_test(cg.make(env_id, max_episode_steps=3), num_cycles=5)
    check_env(gymnasium.make(env_id).unwrapped, skip_render_check=True)
    envs = gymnasium.make_vec(env_id, num_envs=2, max_episode_steps=2, num_threads=1)
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    for _ in range(2):
        *_, truncated, infos = envs.step(envs.action_space.sample())
    assert truncated.all()
    assert infos["_final_obs"].all()
    envs.close()
