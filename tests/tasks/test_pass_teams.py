"""Pass as a relay of three arms and more."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.control import Command
from collaborative_gym.motion import safest_way
from collaborative_gym.policies.scripted import gripping_policy
from collaborative_gym.scene import Scene
from collaborative_gym.tasks.handing import PICKING, of, own_thing
from collaborative_gym.tasks.registry import make_task

IDS = ("PassPandas3-v0", "PassMixed3-v0", "PassPandas4-v0")
EIGHT = ("panda", "sawyer", "jaco", "sawyer", "panda", "jaco", "jaco", "sawyer")


def worlds(name, num_envs=4, robots=None, **settings):
    """Return worlds of a relay that rest after their episodes."""
    task = make_task(name, robots, **settings)
    env = cg.VectorEnv(task, num_envs, num_threads=1, auto_reset=False)
    env.reset(seed=1)
    return env


@pytest.fixture(scope="module", params=IDS)
def relay(request):
    env = worlds(request.param)
    yield env
    env.close()


@pytest.fixture(scope="module")
def four():
    env = worlds("PassPandas4-v0")
    yield env
    env.close()


def play(env, steps=None, change=lambda env, actions: None, each=lambda env: None):
    """Play the expert with changed actions; return completion."""
    env.reset(seed=1)
    for _ in range(steps or env.task.config.max_episode_steps):
        actions = env.expert()
        change(env, actions)
        metrics = env.step(actions)[4]["metrics"]
        each(env)
        if metrics["completion"].all():
            break
    return metrics["completion"]


def still(agent, grips=False):
    """Return a change of actions: an agent holds still, and may grip what comes."""

    def change(env, actions):
        own = gripping_policy(env)({}) if grips else env.idle()
        actions[agent] = own[agent]

    return change


def test_the_cubes_go_from_hand_to_hand_and_lie_at_their_targets(relay):
    stages = [relay.facts.handed]
    assert play(relay, each=lambda env: stages.append(env.facts.handed)).all()
    steps = np.diff(np.stack(stages), axis=0)
    assert (steps[1:] >= 0.0).all() and steps.max() == 1.0
    facts, count = relay.facts, len(relay.agents)
    assert facts.put.all() and (facts.handed == count).all()
    assert (facts.stage == 1.0).all()
    assert not any(held.any() for held in facts.holds.values())
    far = cg.math.distance(facts.cubes[0], facts.targets)
    assert (far < relay.task.config.success_radius).all()


def test_from_four_arms_on_two_cubes_are_under_way_at_once(four):
    both = np.zeros(4, bool)

    def see(env):
        both[(env.facts.handed > 0).all(axis=1) & ~env.facts.put.any(axis=1)] = True

    assert four.task.cubes == ("cube", "cube_2")
    assert play(four, each=see).all() and both.all()
    assert worlds("PassPandas3-v0", 1).task.cubes == ("cube",)


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("grips", (False, True))
def test_no_arm_can_be_left_out(name, grips):
    env = worlds(name)
    for agent in env.agents:
        assert not play(env, change=still(agent, grips)).any()
        i = env.agents.index(agent)
        assert (env.facts.handed <= max(i, grips and i + 1)).all()


def test_an_arm_that_keeps_its_cube_ends_the_relay(four):
    def keep(env, actions):
        actions["robot_2"][:, -1] = 1.0

    assert not play(four, steps=120, change=keep).any()


def test_a_cube_that_is_let_go_on_the_next_table_does_not_count(four):
    """robot_1 lets go before robot_2 holds it, in the very step in which it grips."""

    def drop(env, actions):
        near = env.facts.to_next["robot_1"] < 0.05
        actions["robot_1"][near, -1] = -1.0

    assert not play(four, steps=100, change=drop).any()
    assert (four.facts.handed[:, 0] == 1.0).all()


@pytest.mark.parametrize("name", ("PassPandas6-v0", "PassMixed3-v0"))
def test_only_neighbours_reach_each_other(name):
    task, scene = make_task(name), Scene()
    task.build(scene)
    bases = [np.array(each.position) for each in task.placements.values()]
    reaches = [robot.reach for robot in task.robots.values()]
    for i in range(len(bases)):
        for j in range(i + 2, len(bases)):
            apart = np.linalg.norm(bases[j] - bases[i])
            assert apart > reaches[i] + reaches[j] + 0.2


def test_rewards_are_those_of_two_arms_with_the_next_one(four):
    four.reset(seed=0)
    zero = np.zeros(4)
    facts = replace(
        four.facts,
        to_cube=dict.fromkeys(four.agents, zero + 0.02),
        to_next={f"robot_{i}": zero + far for i, far in ((1, 0.04), (2, 0.4), (3, 5))},
        to_target=zero + 0.7,
    )
    commands = {a: Command(np.zeros((4, 7)), zero == 0) for a in four.agents}
    terms = four.task.reward(facts, commands)
    expected = {
        "robot_1": (0.2, -0.04, -0.1),
        "robot_2": (-0.02, -0.4, 0.1),
        "robot_3": (-0.02, -1.0, 0.1),
        "robot_4": (-0.02, -0.7, 0.1),
    }
    for agent, (reach, onwards, grip) in expected.items():
        own = terms[agent]
        name = "carry" if agent == "robot_4" else "handover"
        assert own["reach"] == pytest.approx(reach)
        assert own[name] == pytest.approx(onwards)
        assert own["grip"] == pytest.approx(grip)
        # Both cubes are still to come, so one waits behind the own one.
        assert own["waiting"] == pytest.approx(-3.0)
    handed = np.tile([3.0, 1.0], (4, 1))
    first = four.task.reward(replace(facts, handed=handed, own=facts.own), commands)
    assert first["robot_1"]["waiting"] == pytest.approx(0.0)
    assert first["robot_1"]["reach"] == pytest.approx(0.2)
    assert first["robot_1"]["handover"] == pytest.approx(0.0)


def test_passing_a_cube_on_never_lowers_the_reward_of_the_arm(four):
    rewards = {agent: [] for agent in four.agents}
    passed = []

    def see(env):
        idle = {a: Command(np.zeros((4, 7)), np.zeros(4, bool)) for a in env.agents}
        for agent, terms in env.task.reward(env.facts, idle).items():
            rewards[agent].append(sum(terms.values()))
        passed.append(env.facts.handed)

    play(four, each=see)
    handed = np.stack(passed)
    for i, agent in enumerate(four.agents[:-1]):
        gained = np.diff(np.stack(rewards[agent]), axis=0)
        now = np.diff((handed >= i + 2).sum(axis=2), axis=0) > 0
        after = np.roll(now, 3, axis=0)
        total = [
            gained[s : s + 6, w].sum() for s, w in zip(*np.nonzero(now), strict=True)
        ]
        assert now.sum() == 8 and after.any() and min(total) > -0.5


def test_own_things_are_held_ones_or_the_first_that_are_left_or_the_last():
    held = np.array([[0, 0], [0, 0], [0, 1], [0, 0]], bool)
    passed = np.array([[0, 0], [1, 0], [0, 0], [1, 1]], bool)
    assert own_thing(held, passed).tolist() == [0, 1, 1, 1]
    assert of(np.arange(8).reshape(4, 2), np.array([0, 1, 1, 0])).tolist() == [
        0,
        3,
        5,
        6,
    ]


def test_all_seats_and_lengths_see_alike_and_count_the_cubes_that_are_left(four):
    task = make_task("Pass", ("panda", "panda"), relay=True)
    short = cg.VectorEnv(task, 1, num_threads=1)
    own = four.observation_blocks["robot_1"]
    for env in (four, short, worlds("PassMixed3-v0", 1)):
        for blocks in env.observation_blocks.values():
            assert blocks == own
    assert own["mates"].shape == (7, 7)
    play(four, steps=60)
    seen = four.task.observe(four.facts)
    for i, agent in enumerate(four.agents[:-1]):
        left = (four.facts.handed < i + 2).mean(axis=1)
        assert seen[agent]["cubes left"][:, 0] == pytest.approx(left)


def test_two_arms_may_play_as_a_relay_and_move_their_tools():
    env = worlds("Pass", robots=("panda", "jaco"), relay=True, action="tcp")
    assert play(env).all() and env.facts.put.all()


def test_a_relay_after_a_mishap_goes_on_from_the_arm_that_lost_the_cube():
    env = worlds("PassPandas4-v0", 32, randomization="lost")
    handed = env.facts.handed[:, 0]
    assert set(handed) == {1.0, 2.0, 3.0, 4.0} and (env.facts.handed[:, 1] == 0).all()
    bases = [place.position[1] for place in env.task.placements.values()]
    across = env.facts.cubes[0][:, 0, 1]
    for i, base in enumerate(bases):
        assert (np.abs(across[handed == i + 1] - base) < 0.7).all()


@pytest.mark.slow
def test_eight_arms_of_all_kinds_hand_two_cubes_on():
    env = worlds("Pass", 2, robots=EIGHT)
    assert env.task.config.max_episode_steps == 540
    assert play(env).all()


def test_a_relay_sees_what_two_arms_see_not():
    pair, team = make_task("Pass"), make_task("PassPandas3-v0")
    assert not pair.config.relay and pair.config.success_radius == 0.12
    assert pair.config.max_episode_steps == 200
    assert team.config.relay and team.config.success_radius == 0.06
    given = make_task("PassPandas3-v0", success_radius=0.1, max_episode_steps=90)
    assert given.config.success_radius == 0.1
    assert given.config.max_episode_steps == 90


@pytest.mark.parametrize(
    ("settings", "reason"),
    (
        ({"robots": ("panda",) * 9}, "needs 2 to 8 robots, got 9"),
        ({"relay": "yes"}, "relay must be"),
        ({"max_episode_steps": 0}, "max_episode_steps must be"),
        ({"max_episode_steps": 1.5}, "max_episode_steps must be"),
        ({"success_radius": -1.0}, "success_radius must be"),
    ),
)
def test_settings_that_do_not_fit_are_refused(settings, reason):
    with pytest.raises((TypeError, ValueError), match=reason):
        make_task("Pass", settings.pop("robots", ("panda",) * 3), **settings)


def test_a_row_that_is_too_wide_is_refused():
    places = make_task("PassPandas3-v0").placements.values()
    apart = [replace(p, position=(0.55, 1.5 * p.position[1], 0.62)) for p in places]
    with pytest.raises(
        ValueError, match=r"panda finds no way from .*; mount it nearer"
    ):
        cg.make_vec("PassPandas3-v0", 1, placements=tuple(apart))


def test_safest_way_touches_nothing_and_keeps_away_from_limits():
    task, scene = make_task("PassPandas3-v0"), Scene()
    task.build(scene)
    model, arm = scene.compile(), scene.arms["robot_1"]
    above = task.cube_start + np.array([0.0, 0.0, 0.25])
    ways = [[(above, PICKING), (above + np.array([0.0, -0.2, 0.0]), PICKING)]]
    chosen, angles = safest_way(model, arm, ways=ways)
    low, high = arm.joint_range
    assert chosen == 0 and (np.minimum(angles - low, high - angles) > 0.1).all()
    data = mujoco.MjData(model)
    for (place, _), posture in zip(ways[0], angles, strict=True):
        data.qpos[arm.qpos] = posture
        mujoco.mj_kinematics(model, data)
        assert data.site_xpos[arm.tcp] == pytest.approx(place, abs=1e-3)
