"""Poke: what counts as threaded and inside, the objects, the starts, the experts."""

from contextlib import closing

import mujoco
import numpy as np
import pytest

from collaborative_gym import Motion, Randomization, VectorEnv, math
from collaborative_gym.control import Command
from collaborative_gym.motion import reach
from collaborative_gym.objects.donut import donut
from collaborative_gym.objects.stick import stick
from collaborative_gym.policies.scripted import expert_policy
from collaborative_gym.tasks.poke import Poke, PokeFacts, is_threaded
from collaborative_gym.tasks.registry import make_task

IDS = ("PokeTaskSawyers-v0", "PokeTaskPandaSawyer-v0")
UPRIGHT, FLAT = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


def make(env_id, num_envs, **options):
    env = VectorEnv(make_task(env_id, **options), num_envs, num_threads=1)
    env.reset(seed=0)
    return env


def chase(env):
    """Return actions that bring the ring over the stick, wherever that is."""
    facts, tcp = env.facts, env.sim.pose("robot_2/tcp")
    normal, along = math.axis_z(facts.donut[1]), math.axis_z(facts.stick[1])
    axis = math.cross(normal, along)
    turn = np.concatenate([1.0 + math.dot(normal, along)[:, None], axis], axis=1)
    quat = math.multiply(turn / math.norm(turn)[:, None], tcp[1])
    ahead = math.rotate(math.conjugate(tcp[1]), facts.donut[0] - tcp[0])
    position = facts.stick[0] - math.rotate(quat, ahead)
    arm = env.scene.arms["robot_2"]
    home = np.array(arm.robot.home)
    change = reach(env.sim, arm, tcp=tcp, goal=(position, quat), posture=home)
    motions = {"robot_1": Motion(np.zeros_like(change)), "robot_2": Motion(change)}
    return env.action_mode.encode(motions)["robot_2"]


@pytest.mark.parametrize(
    ("offset", "axis", "expected"),
    [
        ((0.0, 0.0, 0.0), UPRIGHT, True),
        ((0.07, -0.07, 0.05), UPRIGHT, True),
        ((0.0, 0.0, -0.099), UPRIGHT, True),
        ((0.0, 0.0, -0.101), UPRIGHT, False),
        ((0.085, 0.0, 0.0), UPRIGHT, False),
        ((0.0, 0.0, 0.02), FLAT, False),
        ((0.0, 0.0, 0.0), (0.6, 0.0, -0.8), True),
        ((0.06, 0.0, -0.04), (0.6, 0.0, 0.8), False),
    ],
)
def test_a_stick_is_threaded_where_its_axis_crosses_the_hole(offset, axis, expected):
    assert is_threaded(np.array([offset]), np.array([axis])) == [expected]


def test_inside_implies_threaded():
    rng = np.random.default_rng(0)
    offset, axis = rng.normal(size=(2, 5000, 3))
    offset *= (0.065 * rng.uniform(0.9, 1.0, 5000) / math.norm(offset))[:, None]
    tilt = 0.2 * rng.uniform(0.9, 1.0, 5000)
    axis[:, :2] *= (tilt / math.norm(axis[:, :2]))[:, None]
    axis[:, 2] = np.sign(axis[:, 2]) * np.sqrt(1.0 - tilt**2)
    assert is_threaded(offset, axis).all()


def test_reward_and_success_of_known_states():
    task = make_task(IDS[0])
    offset = np.zeros((6, 3))
    offset[:, 2] = 0.064, 0.066, 0.089, 0.091, 0.02, 0.02
    leaning = (0.21, 0.0, np.sqrt(1.0 - 0.21**2))
    axis = np.array([UPRIGHT, UPRIGHT, UPRIGHT, UPRIGHT, FLAT, leaning])
    pose = np.zeros((6, 3)), np.zeros((6, 4))
    facts = PokeFacts(
        joints={},
        stick=pose,
        donut=pose,
        offset=offset,
        axis=axis,
        distance=math.norm(offset),
        cosine=math.norm(axis[:, :2]),
        is_threaded=is_threaded(offset, axis),
    )
    command = Command(np.full((6, 4), 0.5), np.zeros(6, bool))
    terms = task.reward(facts, dict.fromkeys(task.agents, command))["robot_1"]
    np.testing.assert_allclose(terms["distance"], -offset[:, 2])
    np.testing.assert_allclose(terms["angle"], [0, 0, 0, 0, -0.8, -0.8 * 0.21])
    np.testing.assert_allclose(terms["effort"], -0.01)
    np.testing.assert_array_equal(terms["inside"], [1, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(task.success(facts), [1, 1, 1, 0, 0, 1])


@pytest.mark.parametrize(("x", "touches"), [(0.0, False), (0.06, False), (0.1, True)])
def test_the_ring_has_a_hole_for_the_stick(x, touches):
    spec = mujoco.MjSpec()
    for child, position in ((donut(), (0, 0, 0)), (stick(), (x, 0, 0))):
        frame = spec.worldbody.add_frame(pos=position)
        body = child.worldbody.bodies[0]
        body.add_freejoint()
        spec.attach(child, frame=frame, prefix=f"{body.name}/")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(model.body_mass[1:], 0.1)
    assert bool(data.ncon) == touches


@pytest.mark.parametrize("env_id", IDS)
def test_starts_differ_and_touch_nothing(env_id):
    env = make(env_id, 40)
    nominal = make(env_id, 1, randomization="paper").facts
    for name in ("stick", "donut"):
        position, quat = getattr(env.facts, name)
        middle, upright = getattr(nominal, name)
        assert (np.abs(position - middle).max(axis=0) > 0.05).all()
        turn = math.multiply(quat, np.repeat(math.conjugate(upright), 40, axis=0))
        angle = math.norm(math.rotation_vector(turn))
        assert angle.max() > np.radians(15)
    assert all(env.sim.data(i).ncon == 0 for i in range(40))


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("delay", [0, 1])
def test_the_expert_threads_the_stick_and_keeps_it_there(env_id, delay):
    env = make(env_id, 6, randomization=Randomization(delay=delay))
    policy = expert_policy(env)
    for _ in range(40):
        env.step(policy({}))
        assert not any(env.sim.data(i).ncon for i in range(6))
    assert env.task.success(env.facts).all()
    assert (env.facts.distance < 0.01).all()
    assert (env.facts.cosine < 0.05).all()


@pytest.mark.parametrize(
    ("env_id", "episodes"),
    [(IDS[0], [31, 590, 937, 909]), (IDS[1], [88, 93, 527, 889])],
)
def test_the_expert_waits_where_both_are_in_line_for_a_moment_only(env_id, episodes):
    # There both still swing, and the stick once went through the ring's bar.
    task = make_task(env_id)
    with closing(VectorEnv(task, 4, num_threads=1, strain=True)) as env:
        observations, _ = env.reset(seed=0, episodes=episodes)
        policy, deepest = expert_policy(env), 0.0
        for _ in range(30):
            observations, *_, infos = env.step(policy(observations))
            deepest = max(deepest, env.strain.depths["arms"].max())
        assert infos["metrics"]["completion"].all()
        assert deepest == 0.0


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("idle", ["robot_1", "robot_2"])
def test_no_arm_can_do_it_alone(env_id, idle):
    env = make(env_id, 6)
    nearest = np.inf
    for _ in range(60):
        actions = env.expert()
        if idle == "robot_1":
            actions["robot_2"] = chase(env)
        actions[idle] = np.zeros_like(actions[idle])
        env.step(actions)
        nearest = min(nearest, env.facts.distance.min())
    assert nearest > 0.3


def test_arms_that_cannot_meet_are_refused():
    far = Poke.mounts(make_task("Poke", robots=("sawyer", "sawyer")))
    with pytest.raises(ValueError, match="panda cannot bring its tcp"):
        make("Poke", 1, robots=("panda", "panda"), placements=far)
