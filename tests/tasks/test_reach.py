"""Reach: rewards, goals that change, touches that end episodes, and who gives way."""

from itertools import combinations

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.control import Command
from collaborative_gym.tasks import experts
from collaborative_gym.tasks.reach import ReachFacts
from collaborative_gym.tasks.teams import MOST_MATES

IDS = "ReachPandas2-v0", "ReachMixed3-v0", "ReachPandas4-v0", "ReachPandas8-v0"


@pytest.fixture
def make():
    """Return a function that makes a batch of worlds in which episodes end once."""
    made = []

    def make(num_envs, name="ReachPandas2-v0", robots=None, **options):
        task = cg.task(name, robots, **options)
        env = cg.VectorEnv(task, num_envs, num_threads=1, auto_reset=False)
        env.reset(seed=0)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


def finish(env, act=None):
    """Play to the end of all episodes; return infos and who has touched another."""
    touched = np.zeros(env.num_envs, bool)
    for _ in range(env.task.config.max_episode_steps):
        *_, infos = env.step(env.expert() if act is None else act(env))
        touched |= np.any(list(env.facts.touches.values()), axis=0)
        if infos["ended"].all():
            break
    return infos, touched


def careless(monkeypatch):
    """Let the expert look at nobody else."""
    monkeypatch.setattr(experts.reach, "_ROOM", -1.0)
    monkeypatch.setattr(experts.reach, "_ROOM_AT_REST", -1.0)


def test_rewards_of_a_worked_example():
    task = cg.task("ReachPandas2-v0")
    one, two = task.agents
    flags = {"reached": {one: [True, False], two: [False, False]}}
    flags["touches"] = {one: [False, True], two: [False, True]}
    numbers = {"nearer": {one: [0.03, -0.02], two: [0.01, 0.5]}}
    # In the second world the first arm has no goal left.
    numbers["done"] = {one: [1.0, 3.0], two: [0.0, 2.0]}
    given = {
        name: {agent: np.array(rows) for agent, rows in own.items()}
        for name, own in {**flags, **numbers}.items()
    }
    rest = ("joints", "tcps", "velocities", "elbows", "goals", "distance")
    rest += "stage", "idle"
    facts = ReachFacts(**given, **{name: {} for name in rest})
    moves = np.array([[0.6, 0.8], [0.0, 0.0]])
    commands = dict.fromkeys(task.agents, Command(moves, np.zeros(2, bool)))
    terms = task.reward(facts, commands)
    expected = {
        one: {"distance": [0.3, 0.0], "goal": [5.0, 0.0], "touch": [0.0, -20.0]},
        two: {"distance": [0.1, 5.0], "goal": [0.0, 0.0], "touch": [0.0, -20.0]},
    }
    for agent, own in expected.items():
        assert set(terms[agent]) == {*own, "effort"}
        np.testing.assert_allclose(terms[agent]["effort"], [-0.01, 0.0])
        for name, rows in own.items():
            np.testing.assert_allclose(terms[agent][name], rows)
    assert task.success(facts).tolist() == [False, False]
    assert task.over(facts).tolist() == [False, True]


def test_success_needs_every_goal_of_every_arm_and_no_touch():
    task = cg.task("ReachPandas2-v0")
    done = {"robot_1": np.array([3.0, 3.0, 3.0]), "robot_2": np.array([3.0, 2.0, 3.0])}
    touches = dict.fromkeys(task.agents, np.array([False, False, True]))
    rest = set(ReachFacts.__dataclass_fields__) - {"done", "touches"}
    facts = ReachFacts(done=done, touches=touches, **{name: {} for name in rest})
    assert task.success(facts).tolist() == [True, False, False]
    assert task.over(facts).tolist() == [True, False, True]


def test_a_goal_changes_once_the_hand_is_at_rest_there_and_only_then(make):
    env = make(6)
    config, changes = env.task.config, 0
    for _ in range(config.max_episode_steps):
        before, resting = env.facts, env._progress.has_ended
        *_, infos = env.step(env.expert())
        for agent in env.agents:
            moved = np.any(env.facts.goals[agent] != before.goals[agent], axis=1)
            is_next = before.reached[agent] & (before.done[agent] < config.goals)
            np.testing.assert_array_equal(moved, is_next & ~resting)
            speed = np.linalg.norm(before.velocities[agent], axis=1)
            far = np.linalg.norm(before.tcps[agent][0] - before.goals[agent], axis=1)
            is_there = (far < config.radius) & (speed < config.at_rest)
            had = before.done[agent] - before.reached[agent] < config.goals
            np.testing.assert_array_equal(before.reached[agent], is_there & had)
            # Distances add up to the way of the hand, goal by goal.
            way = np.linalg.norm(before.tcps[agent][0] - env.facts.goals[agent], axis=1)
            gained = way - env.facts.distance[agent]
            np.testing.assert_allclose(
                env.facts.nearer[agent][~resting], gained[~resting], atol=1e-9
            )
            changes += moved.sum()
        if infos["ended"].all():
            break
    assert changes == 6 * 2 * (config.goals - 1)


@pytest.mark.parametrize("env_id", IDS)
def test_goals_are_apart_from_one_another_and_from_arms_that_wait(make, env_id):
    env, apart = make(20, env_id), []
    places = env.sim.memory["places"]
    for one, other in combinations(env.agents, 2):
        goals = env.facts.goals
        apart.append(np.linalg.norm(goals[one] - goals[other], axis=1))
        for agent, mate in ((one, other), (other, one)):
            rest = env.task.rests[mate]
            apart.append(np.linalg.norm(goals[agent] - rest, axis=1))
    apart = np.concatenate(apart)
    assert (apart < env.task.config.apart).mean() < 0.01
    assert apart.min() > 0.13
    # Each goal lies nearer to the place of a mate than half of the way there.
    assert np.ptp(places, axis=(0, 3)).min() > 0.25


def test_nominal_goals_are_fixed_and_apart(make):
    for env_id in IDS:
        env = make(2, env_id, randomization="paper")
        for one, other in combinations(env.agents, 2):
            gap = env.facts.goals[one] - env.facts.goals[other]
            assert np.linalg.norm(gap, axis=1).min() >= env.task.config.apart
            assert not np.ptp(gap, axis=0).any()


def test_arms_that_touch_end_the_round_and_fail(make, monkeypatch):
    careless(monkeypatch)
    env = make(40)
    infos, touched = finish(env)
    completed = infos["metrics"]["completion"] > 0
    # What looks at nobody fails often: that is the task.
    assert 0.3 < touched.mean() < 0.9
    np.testing.assert_array_equal(completed, ~touched)
    penalty = infos["metrics"]["reward_terms"]["robot_1"]["touch"]
    np.testing.assert_array_equal(penalty, np.where(touched, -20.0, 0.0))
    assert (infos["metrics"]["length"][touched] < 100).all()


def test_a_touch_of_two_is_a_fault_of_these_two(make, monkeypatch):
    careless(monkeypatch)
    env = make(24, "ReachPandas4-v0")
    infos, touched = finish(env)
    faults = sum(
        terms["touch"] < 0 for terms in infos["metrics"]["reward_terms"].values()
    )
    assert touched.any()
    assert set(faults[touched].tolist()) <= {2, 3, 4}
    assert 2 in faults[touched]


@pytest.mark.parametrize(
    "robots", [("panda", "jaco"), ("panda", "sawyer", "jaco"), ("sawyer",) * 5]
)
def test_the_expert_gives_way(make, robots):
    infos, touched = finish(make(20, "Reach", robots))
    assert not touched.any()
    assert infos["metrics"]["completion"].mean() >= 0.95


def test_an_arm_that_idles_lets_nobody_succeed_and_wins_nothing(make):
    env = make(10)
    infos, _ = finish(
        env, lambda env: env.expert() | {"robot_2": env.idle()["robot_2"]}
    )
    assert not infos["metrics"]["completion"].any()
    assert (infos["metrics"]["returns"]["robot_2"] < 1.0).all()
    both, _ = finish(make(10))
    assert (both["metrics"]["return"] > infos["metrics"]["return"] + 10.0).all()


def test_what_a_robot_sees_has_one_shape_in_teams_of_all_sizes(make):
    spaces = set()
    for count in (2, 3, 8):
        env = make(2, "Reach", ("panda",) * count)
        for agent in env.agents:
            blocks = env.observation_blocks[agent]
            spaces.add(tuple((b.name, b.shape) for b in blocks.values()))
            seen = env.task.observe(env.facts)[agent]["mates"]
            assert seen.shape == (2, MOST_MATES, 12)
            assert (seen[:, :, 0].sum(axis=1) == count - 1).all()
            assert not seen[:, count - 1 :].any()
    assert len(spaces) == 1


def test_a_robot_sees_whose_turn_it_is(make):
    # Who has more goals left goes first, and of equal ones the first.
    env = make(4)
    for _ in range(40):
        env.step(env.expert())
    seen, done = env.task.observe(env.facts), env.facts.done
    assert all((done[agent] > 0).any() for agent in env.agents)
    for agent, mate in zip(env.agents, env.agents[::-1], strict=True):
        left = 1.0 - done[mate] / env.task.config.goals
        after = 1.0 if agent == "robot_1" else -1.0
        np.testing.assert_array_equal(seen[agent]["mates"][:, 0, 1], after)
        np.testing.assert_array_equal(seen[agent]["mates"][:, 0, 2], left)
        np.testing.assert_array_equal(seen[mate]["goals left"][:, 0], left)


def test_equal_seats_of_a_ring_see_equal_worlds(make):
    # Every second arm of a full ring starts alike, but for whose turn it is.
    env = make(1, "ReachPandas4-v0", randomization=cg.Randomization(0, 0, 0, 0))
    seen = env.task.observe(env.facts)
    for agent in env.agents:
        seen[agent]["mates"] = np.delete(seen[agent]["mates"], 1, axis=2)
    for name, block in seen["robot_1"].items():
        np.testing.assert_allclose(block, seen["robot_3"][name], atol=1e-6)


def test_bits_do_not_depend_on_the_batch_and_states_continue(make):
    env, alone = make(4, "ReachMixed3-v0"), make(1, "ReachMixed3-v0")
    alone.reset(seed=0, episodes=[3])
    for each in (env, alone):
        for _ in range(40):
            each.step(each.expert())
    # By now goals have changed.
    assert max(own.max() for own in env.facts.done.values()) > 0
    state, begun = env.get_state(), alone.get_state()
    for _ in range(25):
        env.step(env.expert())
        alone.step(alone.expert())
    after, same = env.get_state(), alone.get_state()
    assert_same(after.rows([3]), same)
    env.set_state(state)
    assert_same(env.get_state([3]), begun)
    for _ in range(25):
        env.step(env.expert())
    assert_same(env.get_state(), after)


def assert_same(state, other):
    np.testing.assert_array_equal(state.physics, other.physics)
    for part in ("memory", "progress"):
        for name, array in getattr(state, part).items():
            np.testing.assert_array_equal(array, getattr(other, part)[name])


def test_a_world_at_rest_remembers_what_it_did(make):
    env = make(8)
    last = {}
    for _ in range(env.task.config.max_episode_steps):
        *_, infos = env.step(env.expert())
        for i in np.flatnonzero(infos["ended"]):
            memory = {name: rows[i].copy() for name, rows in env.sim.memory.items()}
            for name, rows in last.setdefault(i, memory).items():
                np.testing.assert_array_equal(memory[name], rows)
        if infos["ended"].all():
            break
    assert len(last) == 8


def test_a_goal_has_the_colour_of_its_arm_s_pedestal():
    env = cg.make_vec("ReachPandas4-v0", 1, num_threads=1)
    model = env.scene.compile_to_draw()

    def colours(body):
        own = np.flatnonzero(model.geom_bodyid == model.body(body).id)
        return {tuple(rgba) for rgba in model.geom_rgba[own].tolist()}

    agents = [f"robot_{i + 1}" for i in range(4)]
    goals = [colours(f"{agent} goal") for agent in agents]
    assert [len(own) for own in goals] == [1] * 4 and len(set.union(*goals)) == 4
    for agent, own in zip(agents, goals, strict=True):
        assert own < colours(f"{agent}_stand/pedestal")
