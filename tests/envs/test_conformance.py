"""What every environment promises, for its own arms and for others."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import reduce
from operator import and_

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

import collaborative_gym as cg
from collaborative_gym import testing
from collaborative_gym.motion import reach
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import columns
from collaborative_gym.testing import leaves, play

PAIRS = (("panda", "jaco"), ("jaco", "panda"))
TEAM = ("panda", "sawyer", "jaco", "panda")
CASES = [(env_id, None) for env_id in cg.list_envs()]
PAIRED = [name for name in cg.list_tasks() if 2 in cg.task(name).robot_counts]
CASES += [(task, pair) for task in PAIRED for pair in PAIRS]
CASES += [("Touch", arms) for arms in (("jaco",), TEAM[:3], TEAM)]
CASES = [(*case, "joints") for case in CASES]
CASES += [("Lift", PAIRS[0], "tcp"), ("Touch", TEAM[:3], "tcp")]
CASES += [("Poke", PAIRS[0], "torques"), ("Lift", PAIRS[1], "impedance")]

MANY = 4  # arms, above which a step takes long

pytestmark = pytest.mark.filterwarnings("ignore:.*Box observation space")


class Touch(cg.Task):
    """Any number of arms; each brings its hand to a target of its own."""

    robot_counts = range(1, 5)

    def build(self, scene):
        for agent, placement in self.placements.items():
            scene.add_robot(agent, self.robots[agent], placement=placement)
            scene.add_target(f"{agent} target", radius=0.05)

    def reset(self, sim, env_ids, *, rng):
        self.start_arms(sim, env_ids, rng=rng)
        for agent, placement in self.placements.items():
            draw = rng.within(self.config.randomization.target_position, 3)
            base = np.array(placement.position) * (0.0, 1.0, 1.0)
            place = np.array([0.65, 0.0, 0.25]) + base + draw
            self.scene.place(sim, env_ids, name=f"{agent} target", position=place)

    def measure(self, sim):
        joints, hands, targets, far = self.joints(sim), {}, {}, {}
        for agent in self.agents:
            hands[agent] = sim.pose(f"{agent}/tcp")
            targets[agent] = sim.pose(f"{agent} target")[0]
            far[agent] = cg.math.distance(hands[agent][0], targets[agent])
        return {"joints": joints, "hands": hands, "targets": targets, "far": far}

    def observe(self, facts):
        hands = {agent: cg.math.pose(*pose) for agent, pose in facts["hands"].items()}
        blocks = {
            **columns("joints", facts["joints"]),
            **columns("hand", hands),
            **columns("target", facts["targets"]),
        }
        return dict.fromkeys(self.agents, blocks)

    def reward(self, facts, commands):
        terms = {}
        for agent, command in commands.items():
            effort = -0.01 * cg.math.norm(command.moves)
            terms[agent] = {"distance": -facts["far"][agent], "effort": effort}
        return terms

    def success(self, facts):
        return reduce(and_, [far < 0.03 for far in facts["far"].values()])

    def expert(self, sim, facts):
        motions = {}
        for agent, arm in self.scene.arms.items():
            hand, home = facts["hands"][agent], arm.robot.home
            goal = facts["targets"][agent], hand[1]
            change = reach(sim, arm, tcp=hand, goal=goal, posture=home)
            motions[agent] = cg.Motion(change)
        return motions


@pytest.fixture(
    scope="module",
    params=CASES,
    ids=lambda case: "-".join((case[0], *(case[1] or ()), *case[2:])),
)
def trial(request):
    """Return an environment's task, with batches of its worlds."""
    name, robots, action = request.param
    if name == "Touch":
        task = Touch(
            [cg.get_robot(each) for each in robots], cg.TaskConfig(action=action)
        )
    else:
        task = make_task(name, robots, action=action)
    trial = testing.TaskUnderTest(task, episodes=7 if len(task.agents) <= MANY else 3)
    yield trial
    trial.close()


@pytest.fixture
def case(trial):
    """Return a function that makes batches of an environment, each size once."""
    return trial.worlds


@pytest.mark.parametrize("check", testing.CHECKS, ids=lambda check: check.__name__)
def test_the_task_keeps_its_promises(trial, check):
    if check is testing.check_expert and len(trial.task.agents) > MANY:
        pytest.skip("test_starts has these experts, and smaller teams the rest")
    check(trial)


def test_spaces_hold_what_is_returned(case):
    env = case(7)
    observations, _ = env.reset(seed=0)
    play(env, 3)
    for agent in env.agents:
        space = env.single_observation_spaces[agent]
        blocks = env.observation_blocks[agent]
        assert sum(block.size for block in blocks.values()) == space.shape[0]
        assert all(row in space for row in observations[agent])
        robot = env.task.robots[agent]
        mode = env.task.config.action
        moves = len(robot.joints) if mode in ("joints", "torques") else 6
        actions = moves + env.task.gripping
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


def test_a_world_that_diverges_ends_alone(case, monkeypatch, tmp_path):
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


def test_observations_describe_the_state_after_the_step(case):
    env = case(7)
    for _ in range(3):
        observations = env.step(env.expert())[0]
    for i in (0, 6):
        np.testing.assert_array_equal(env.sim.sensordata[i], env.sim.data(i).sensordata)
    again = env.set_state(env.get_state())
    for agent in env.agents:
        np.testing.assert_array_equal(again[agent], observations[agent])


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
    commands = converted(env.action_mode.commands(actions), np.array)
    tensors = converted(facts, torch.from_numpy)
    on_torch = (
        task.observe(tensors),
        task.reward(tensors, converted(commands, torch.from_numpy)),
        task.success(tensors),
        task.performing(tensors),
    )
    on_numpy = (
        task.observe(facts),
        task.reward(facts, commands),
        task.success(facts),
        task.performing(facts),
    )
    numbers, given = leaves(on_numpy), leaves(on_torch)
    for tensor, array in zip(given.values(), numbers.values(), strict=True):
        if array is None:  # Not every task says what counts towards performance.
            assert tensor is None
            continue
        assert isinstance(tensor, torch.Tensor)
        assert tensor.shape == array.shape
        np.testing.assert_allclose(tensor.numpy(), array, rtol=1e-9, atol=1e-12)


def test_gravity_acts(case):
    assert case(7).model.opt.gravity.tolist() == [0.0, 0.0, -9.81]


@pytest.mark.parametrize("env_id", cg.list_envs())
def test_contracts_of_other_libraries(env_id):
    parallel_api_test(cg.make(env_id, max_episode_steps=3), num_cycles=5)
    if len(make_task(env_id).sides) > 1:
        with pytest.raises(ValueError, match="one agent cannot command the 2 sides"):
            gymnasium.make(env_id)
        return
    check_env(gymnasium.make(env_id).unwrapped, skip_render_check=True)
    envs = gymnasium.make_vec(env_id, num_envs=2, max_episode_steps=2, num_threads=1)
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    for _ in range(2):  # Still, because arms that touch end an episode of Reach.
        *_, truncated, infos = envs.step(np.zeros_like(envs.action_space.sample()))
    assert truncated.all()
    assert infos["_final_obs"].all()
    envs.close()
