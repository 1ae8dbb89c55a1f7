"""Each grasp bears what it says, and keeps what it holds where it took it."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.errors import UnknownName
from collaborative_gym.scene.grasps import GRASPS, get_grasp

BONDS = ("suction", "pinch")


@pytest.fixture
def picked():
    """Return a function that makes worlds whose first arm has picked up its cube."""

    def make(grasp, worlds=1, **settings):
        task = cg.task("PassTaskSawyers-v0", grasp=grasp, **settings)
        env = cg.VectorEnv(task, worlds, num_threads=1)
        env.reset(seed=0)
        lifted = np.zeros(worlds, bool)
        while not lifted.all():
            assert env.progress["step"].max() < 100
            actions, still = env.expert(), env.idle({"robot_1": True})
            for agent, own in actions.items():
                actions[agent] = np.where(lifted[:, None], still[agent], own)
            env.step(actions)
            height = env.sim.pose("cube/centre")[0][:, 2] - env.task.cube_start[2]
            lifted |= env.facts.holds["robot_1"] & (height > 0.02)
        wait(env, 5)
        return env

    return make


def wait(env, steps):
    for _ in range(steps):
        env.step(env.idle({"robot_1": True}))


def in_hand(env):
    place, quat = env.sim.pose("robot_1/tcp")
    cube, turned = env.sim.pose("cube/centre")
    back = math.conjugate(quat)
    return math.rotate(back, cube - place), math.multiply(back, turned)


@pytest.mark.parametrize("grasp", [*BONDS, "friction"])
def test_a_held_thing_stays_where_it_was_taken(picked, grasp):
    env = picked(grasp, 2)
    before, turned = in_hand(env)
    wait(env, 40)
    after, now = in_hand(env)
    assert np.abs(after - before).max() < 0.001 * 4.0 / 20.0
    turn = math.rotation_vector(math.multiply(math.conjugate(turned), now))
    assert np.degrees(math.norm(turn)).max() < 1.0
    if grasp != "friction":
        # It is not drawn to the tool, as by a magnet.
        assert math.norm(before).min() > 0.005


@pytest.mark.parametrize(
    ("grasp", "along", "across"), [("pinch", 40.0, 40.0), ("suction", 76.4, 38.2)]
)
def test_a_hand_loses_what_it_is_pulled_at_beyond_its_bound(
    picked, grasp, along, across
):
    env = picked(grasp, 4)
    body = env.model.body("cube/cube").id
    newtons = np.array([0.9, 1.1, 0.9, 1.1]) * [along, along, across, across]
    ways = np.array([[0, 0, 1.0], [0, 0, 1.0], [1.0, 0, 0], [1.0, 0, 0]])
    for share in np.linspace(0.05, 1.0, 20):
        quat = env.sim.pose("robot_1/tcp")[1]
        force = math.rotate(quat, share * newtons[:, None] * ways)
        force[:, 2] += 9.81 * env.model.body_mass[body]
        env.sim.xfrc_applied[:, body, :3] = force
        wait(env, 1)
    wait(env, 3)
    assert env.facts.holds["robot_1"].tolist() == [True, False, True, False]


def test_friction_bears_twice_the_force_of_its_fingers(picked):
    env = picked("friction", 2)
    body, start = env.model.body("cube/cube").id, in_hand(env)[0]
    bears = get_grasp("friction").strength(env.task.robots["robot_1"])
    assert bears == 2.0 * 20.0
    env.sim.xfrc_applied[:, body, 2] = -bears * np.array([0.85, 1.15])
    wait(env, 5)
    moved = math.norm(in_hand(env)[0] - start)
    assert moved[0] < 0.002
    assert moved[1] > 0.02


def test_fingers_that_turn_press_with_their_torque_over_their_lever():
    pads = {n: cg.get_robot(n).gripper.pad_force for n in ("panda", "sawyer", "jaco")}
    # Kinova gives 40 N for three fingers.
    assert pads == pytest.approx({"panda": 70.0, "sawyer": 20.0, "jaco": 40.8}, abs=0.1)


@pytest.mark.parametrize("grasp", BONDS)
def test_a_restored_state_knows_where_things_were_taken(picked, grasp):
    env = picked(grasp)
    state = env.get_state()
    wait(env, 5)
    other = cg.VectorEnv(cg.task("PassTaskSawyers-v0", grasp=grasp), 1, num_threads=1)
    other.set_state(state)
    wait(other, 5)
    np.testing.assert_array_equal(other.sim.get_state(), env.sim.get_state())


def test_the_pot_weighs_what_two_hands_and_no_single_one_hold():
    weights = {}
    for grasp in ("magnet", "suction", "pinch"):
        task = cg.make_vec("LiftTaskSawyers-v0", 1, grasp=grasp, num_threads=1).task
        held = get_grasp(grasp).strength(task.robots["robot_1"]) / 9.81
        weights[grasp] = task.pot_mass
        if grasp != "magnet":
            assert 1.2 * held <= task.pot_mass < 1.5 * held
    assert weights["suction"] < weights["pinch"] < weights["magnet"]


@pytest.mark.parametrize("grasp", GRASPS)
def test_experts_pass_with_each_grasp(grasp):
    report = cg.evaluate(
        cg.task("PassTaskSawyers-v0", grasp=grasp), "expert", episodes=8, num_threads=1
    )
    assert report.completion.mean == 1.0


@pytest.mark.parametrize("grasp", BONDS)
def test_experts_lift_what_could_slip(grasp):
    report = cg.evaluate(
        cg.task("LiftTaskJacos-v0", grasp=grasp), "expert", episodes=4, num_threads=1
    )
    assert report.completion.mean == 1.0


def test_a_grasp_that_cannot_be_is_refused_in_one_sentence():
    with pytest.raises(UnknownName, match=r"no grasp 'pich'.*did you mean 'pinch'"):
        cg.make("PassTaskSawyers-v0", grasp="pich")
    with pytest.raises(ValueError, match="Poke has no grips, so grasp='pinch'"):
        cg.make("PokeTaskSawyers-v0", grasp="pinch")
    with pytest.raises(ValueError, match=r"handles collide with nothing.*'pinch'"):
        cg.make("LiftTaskSawyers-v0", grasp="friction")


def test_policies_of_a_time_without_grasps_are_of_magnets():
    own, other = (
        cg.make_vec("PassTaskSawyers-v0", 1, grasp=grasp, num_threads=1).identity
        for grasp in ("magnet", "pinch")
    )
    old = cg.make_vec("PassTaskSawyers-v0", 1, num_threads=1).identity
    old.config.pop("grasp")
    assert not old.differences(own)
    assert other.differences(old) == ["grasp is pinch, not magnet"]
