"""Wrists feel what hangs from them, is in them, and what touches them."""

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.blocks import Block, columns_of
from collaborative_gym.control import JointChanges
from collaborative_gym.envs.wrists import Wrists, add_wrist_sensors
from collaborative_gym.scene import Scene
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.tasks.task import RANDOMIZATIONS
from collaborative_gym.testing import check_task
from collaborative_gym.timing import SUBSTEPS

MASS, LEVER, GRAVITY = 2.0, 0.1, 9.81


def weight(lever):
    """Return a heavy ball that moves freely, and where it hangs from, aside of it."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ball")
    body.add_freejoint()
    body.add_geom(size=[0.02] * 3, mass=MASS, contype=0, conaffinity=0)
    body.add_site(name="hook", pos=[0, lever, 0])
    return spec


def resting(robot, lever, turns):
    """Return wrenches of an arm, raw and compensated, once a ball hangs still."""
    scene = Scene()
    scene.add_robot("arm", robot, placement=cg.Placement((0, 0, 1.0)))
    data = mujoco.MjData(model := robot.spec().compile())
    for joint, angle in zip(robot.joints, robot.home, strict=True):
        data.joint(joint).qpos = angle
    mujoco.mj_forward(model, data)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, data.site(robot.tcp).xmat)
    place = data.site(robot.tcp).xpos - math.rotate(quat, np.array([0, lever, 0]))
    place[2] += 1.0
    scene.add("weight", weight(lever), position=place, quat=quat)
    scene.add_weld(f"arm/{robot.tcp}", "weight/hook", turns=turns)
    add_wrist_sensors(scene)
    JointChanges.add_drives(scene)
    model = scene.compile()
    sim = CpuSim(model, 1, 1)
    mode, arm = JointChanges(scene, sim, gripping=False), scene.arms["arm"]
    sim.qpos[:, arm.qpos] = robot.home
    mode.start(np.arange(1))
    for _ in range(60):
        sim.step(np.repeat(sim.ctrl[:, None], SUBSTEPS, axis=1))
    found = []
    for is_raw in True, False:
        sim.feel()
        wrists = Wrists(scene, model, is_raw=is_raw).sensed(sim.sensordata)
        found.append(wrists["arm"][0])
    link = model.dof_bodyid[arm.dof.stop - 1]
    (tcp,), (quat,) = sim.pose("arm/tcp")
    ball = sim.data(0).body("weight/ball").xpos
    aside = math.rotate(math.conjugate(quat), ball - tcp)
    return *found, aside, quat, model.body_subtreemass[link]


@pytest.mark.parametrize("name", ["sawyer", "panda", "jaco"])
def test_a_hanging_mass_pulls_with_its_weight_and_turns_by_its_lever(name):
    raw, felt, aside, quat, own = resting(cg.get_robot(name), LEVER, turns=False)
    down = math.rotate(math.conjugate(quat), np.array([0.0, 0.0, -1.0]))
    force = MASS * GRAVITY * down
    np.testing.assert_allclose(felt[:3], force, atol=1e-3)
    # What holds it gives way a little, and so do fingers.
    np.testing.assert_allclose(aside, [0.0, -LEVER, 0.0], atol=5e-3)
    np.testing.assert_allclose(felt[3:], np.cross(aside, force), atol=5e-3)
    np.testing.assert_allclose(raw[:3] - felt[:3], own * GRAVITY * down, atol=1e-9)


def test_what_may_turn_turns_nothing():
    _, felt, *_ = resting(cg.get_robot("panda"), 0.0, turns=True)
    assert np.linalg.norm(felt[:3]) == pytest.approx(MASS * GRAVITY, rel=1e-4)
    np.testing.assert_allclose(felt[3:], 0.0, atol=1e-3)


@pytest.fixture
def made(make_env):
    """Return a batch of the small task whose robots feel, after some steps."""

    def made(wrench="compensated", steps=4, **settings):
        env = make_env(3, wrench=wrench, **settings)
        observations, _ = env.reset(seed=0)
        for _ in range(steps):
            observations, *_ = env.step(env.idle(True))
        return env, observations

    return made


def wrench(env, observations, agent="robot_1"):
    return observations[agent][:, columns_of(env.observation_blocks[agent], "wrench")]


def test_the_block_is_there_on_demand_alone_and_changes_no_bit(made):
    env, seen = made()
    assert env.observation_blocks["robot_1"]["wrench"] == Block(
        "wrench", (6,), unit="N; N m"
    )
    plain, without = made(wrench="off")
    assert "wrench" not in plain.observation_blocks["robot_1"]
    np.testing.assert_array_equal(env.sim.qpos, plain.sim.qpos)
    for agent in env.agents:
        np.testing.assert_array_equal(seen[agent][:, :-6], without[agent])
    with pytest.raises(KeyError, match="did you mean 'raw'"):
        cg.make("Pass", wrench="row")
    with pytest.raises(TypeError, match="wrench must be"):
        cg.make("Pass", wrench=True)


def test_it_is_the_same_in_any_batch_and_after_saving(carry):
    check_task(carry(wrench="compensated", pad_force=True), episodes=4)


def test_sensors_are_off_by_a_bias_and_by_noise(made):
    exact, clean = made()
    blurred = cg.Randomization(force_bias=3.0, torque_bias=0.5)
    env, seen = made(randomization=blurred)
    np.testing.assert_array_equal(env.sim.qpos, exact.sim.qpos)
    biases = []
    for agent in env.agents:
        off = wrench(env, seen, agent) - wrench(exact, clean, agent)
        assert (np.abs(off[:, :3]) <= 3.0).all() and (np.abs(off[:, 3:]) <= 0.5).all()
        biases.append(off)
    assert len(np.unique(biases)) == 2 * 3 * 6
    later = env.step(env.idle(True))[0]
    expected = exact.step(exact.idle(True))[0]
    off = wrench(env, later) - wrench(exact, expected)
    np.testing.assert_allclose(off, biases[0], atol=1e-4)
    noisy, shaken = made(randomization=cg.Randomization(force_noise=3.0))
    off = wrench(noisy, shaken) - wrench(exact, clean)
    assert np.abs(off[:, :3]).max() > 1.0 and not off[:, 3:].any()
    _, pads = made(
        "off", pad_force=True, randomization=cg.Randomization(force_bias=3.0)
    )
    assert (np.abs(pads["robot_1"][:, -1]) > 0.01).all()
    assert (np.abs(pads["robot_1"][:, -1]) < 3.0).all()
    again = noisy.step(noisy.idle(True))[0]
    assert np.abs(wrench(noisy, again) - wrench(exact, expected) - off).max() > 0.5


@pytest.mark.parametrize("grasp", ["magnet", "pinch", "friction"])
def test_pads_press_with_the_force_of_the_gripper(grasp):
    task = cg.task("Pass", ("panda", "panda"), grasp=grasp, pad_force=True)
    env = cg.make_vec(task, 1, strain=True, num_threads=1)
    env.reset(seed=0)
    cube, wrench, felt = env.model.body("cube/cube").id, np.zeros(6), []
    for _ in range(20):
        seen, *_, infos = env.step(env.expert())
        felt.append(seen["robot_1"][0, -1])
        data, pressing = env.sim.data(0), 0.0
        for i, bodies in enumerate(env.model.geom_bodyid[data.contact.geom]):
            names = " ".join(env.model.body(body).name for body in bodies)
            if cube in bodies and "robot_1/" in names:
                mujoco.mj_contactForce(env.model, data, i, wrench)
                pressing += wrench[0] / 2
        assert grasp != "friction" or felt[-1] == pytest.approx(pressing, abs=1e-4)
    gripper = env.task.robots["robot_1"].gripper
    expected = 0.0 if grasp == "magnet" else gripper.pad_force
    assert felt[0] == 0.0 and felt[-1] == pytest.approx(expected, rel=1e-3)
    assert infos["metrics"]["strain"]["pad_force"][0] >= expected - 1e-3


def test_noise_of_wrists_leaves_the_other_disturbances(made):
    """It is drawn after them, and only where it is felt."""
    hard = RANDOMIZATIONS["hard"]
    _, usual = made(randomization=hard, wrench="off")
    env, seen = made(randomization=hard)
    for agent in env.agents:
        np.testing.assert_array_equal(seen[agent][:, :-6], usual[agent])
