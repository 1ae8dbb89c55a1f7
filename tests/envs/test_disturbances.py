"""What disturbs episodes beside their starts."""

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.tasks.registry import disturbed
from collaborative_gym.tasks.task import RANDOMIZATIONS

MODELS = ("link_mass", "payload", "friction", "lost_torque")


@pytest.fixture
def make(make_env):
    """Return a function that makes worlds with some disturbances and one start."""

    def make(num_envs=6, **changes):
        env = make_env(num_envs, randomization=cg.Randomization(0, 0, 0, 0, **changes))
        env.reset(seed=0)
        return env

    return make


def own(env, i):
    """Return a world's model."""
    return env.sim._batch.get_model(i)


@pytest.mark.parametrize("name", MODELS)
def test_one_disturbance_does_not_change_the_others(make_env, name):
    rows = RANDOMIZATIONS["hard"], cg.Randomization(**{name: 0.2})
    all_, one = (make_env(4, randomization=each) for each in rows)
    for env in all_, one:
        env.reset(seed=3)
    for field in "body_mass", "geom_friction", "actuator_forcerange":
        changed = [getattr(own(one, i), field) for i in range(4)]
        for i, each in enumerate(changed):
            moved = each != getattr(one.model, field)
            np.testing.assert_array_equal(
                each[moved], getattr(own(all_, i), field)[moved]
            )


def test_masses_change_by_arm_and_by_thing(make):
    env = make(num_envs=30, link_mass=0.2, payload=0.5)
    models = [own(env, i) for i in range(30)]
    shares = np.array([m.body_mass for m in models]) / np.maximum(
        env.model.body_mass, 1e-9
    )
    names = [env.model.body(i).name for i in range(env.model.nbody)]
    weighs = env.model.body_mass > 0
    for agent in env.agents:
        links = [
            n.startswith(f"{agent}/") and w for n, w in zip(names, weighs, strict=True)
        ]
        of_arm = shares[:, links]
        np.testing.assert_allclose(of_arm, of_arm[:, :1].repeat(sum(links), axis=1))
        assert 0.8 <= of_arm.min() < 0.87 and 1.13 < of_arm.max() <= 1.2
    cube = shares[:, names.index("cube/cube")]
    assert 0.5 <= cube.min() < 0.6 and 1.4 < cube.max() <= 1.5
    assert abs(np.corrcoef(cube, of_arm[:, 0])[0, 1]) < 0.6
    for model, share in zip(models, cube, strict=True):
        inertia = model.body("cube/cube").inertia
        np.testing.assert_allclose(
            inertia, share * env.model.body("cube/cube").inertia, rtol=1e-12
        )
        # What follows from the masses follows.
        assert model.body_subtreemass[0] == pytest.approx(model.body_mass.sum())


def test_friction_changes_alike_everywhere_and_one_arm_is_weak(make):
    env = make(num_envs=40, friction=0.2, lost_torque=0.25)
    weak = []
    for i in range(40):
        model = own(env, i)
        share = model.geom_friction / env.model.geom_friction
        np.testing.assert_allclose(share, share[0, 0])
        assert 0.8 <= share[0, 0] <= 1.2
        arms = [
            model.actuator_forcerange[arm.servos, 1] / arm.robot.torque_limits
            for arm in env.scene.arms.values()
        ]
        assert sorted(float(arm.mean()) for arm in arms) == [0.75, 1.0]
        weak.append(arms[0].mean() < 1.0)
    assert 10 < sum(weak) < 30


def test_a_weak_arm_is_at_its_limit_sooner(carry):
    task = carry(randomization=cg.Randomization(0, 0, 0, 0, lost_torque=0.9))
    reports = [cg.evaluate(t, "expert", episodes=2) for t in (carry(), task)]
    shares = [report.strain["torque_limit_share"].mean for report in reports]
    assert shares[1] > shares[0]


def test_worlds_are_those_of_their_own_models(make):
    """Worlds go as MuJoCo alone goes with the same model."""
    env = make(num_envs=3, link_mass=0.2, payload=0.2, friction=0.2, lost_torque=0.2)
    data = [env.sim.data(i) for i in range(3)]
    controls = np.zeros((3, 7, env.model.nu))
    env.sim.step(controls)
    for i, each in enumerate(data):
        model = own(env, i)
        again = mujoco.MjData(model)
        state = mujoco.mjtState.mjSTATE_INTEGRATION
        row = np.zeros(mujoco.mj_stateSize(model, state))
        mujoco.mj_getState(env.model, each, row, state)
        mujoco.mj_setState(model, again, row, state)
        again.qacc_warmstart[:] = 0.0
        again.ctrl[:] = 0.0
        for _ in range(7):
            mujoco.mj_step(model, again)
        np.testing.assert_array_equal(again.qpos, env.sim.qpos[i])


def test_late_actions_are_done_a_step_later_in_some_episodes(make):
    punctual, late, some = make(8), make(8, delay=2), make(8, delay=2, delayed=0.5)
    seen = []
    for step in range(6):
        actions = {
            agent: np.full((8, 8), 0.1 * (step + 1)) for agent in punctual.agents
        }
        before = (
            punctual.idle()
            if step < 2
            else {a: 0 * x + 0.1 * (step - 1) for a, x in actions.items()}
        )
        seen.append([punctual.step(before)[0], late.step(actions)[0]])
        some.step(actions)
        np.testing.assert_array_equal(seen[-1][0]["robot_1"], seen[-1][1]["robot_1"])
    same = (some.sim.qpos == late.sim.qpos).all(axis=1)
    assert 0 < same.sum() < 8


def test_lost_actions_move_nothing_and_keep_grips(make):
    env = make(4, lost_actions=1.0)
    for _ in range(2):
        env.step({agent: np.ones((4, 8)) for agent in env.agents})
    still = make(4)
    for _ in range(2):
        still.step(still.idle())
    np.testing.assert_array_equal(env.sim.qpos, still.sim.qpos)
    # Most arrive; of those that do not, no grip is lost that was held.
    env, held = make(8, lost_actions=0.3), np.zeros((8, 2), bool)
    for _ in range(8):
        env.step(env.idle(grips=True))
        now = np.stack([env.scene.holds(env.sim, a) for a in env.agents], axis=1)
        assert not (held & ~now).any()
        held = now
    assert held.sum() > 8


def test_noise_is_seen_and_changes_nothing_else(make):
    env, exact = make(32, position_noise=0.005, angle_noise=0.02), make(32)
    misses = []
    for _ in range(4):
        actions = exact.expert()
        seen, rewards, *_ = env.step(actions)
        real, real_rewards, *_ = exact.step(actions)
        for agent in env.agents:
            np.testing.assert_array_equal(rewards[agent], real_rewards[agent])
        np.testing.assert_array_equal(
            env.sim.memory["highest"], exact.sim.memory["highest"]
        )
        np.testing.assert_array_equal(env.sim.qpos, exact.sim.qpos)
        misses.append(seen["robot_1"] - real["robot_1"])
        joints, tcp = np.split(misses[-1][:, :10], [7], axis=1)
        assert 0.015 < np.abs(joints).max() <= 0.02 + 1e-6
        assert 0.004 < np.abs(tcp).max() <= 0.005 + 1e-6
        np.testing.assert_array_equal(
            env.get_state().physics, exact.get_state().physics
        )
    assert not (misses[0] == misses[1]).any(axis=1).all()
    again = env.set_state(env.get_state())["robot_1"]
    np.testing.assert_array_equal(again, seen["robot_1"])
    turned = seen["robot_1"][:, 10:14]
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0, atol=1e-6)


def test_undisturbed_worlds_keep_the_models_own_numbers(make):
    env = make(2, delay=1, position_noise=0.01)
    assert env.sim._batch.expanded("body_mass") is None


def test_a_task_is_disturbed_as_asked(carry):
    task = disturbed(carry(), delay=3)
    assert task.config.randomization == cg.Randomization(delay=3)
    assert task.name == "Carry"


def test_a_limp_arm_falls_and_grips_what_comes_within_reach(make):
    heights, envs = [], (make(2, limp=("robot_1",)), make(2))
    for env in envs:
        env.step(env.idle(grips=True))
        assert env.scene.holds(env.sim, "robot_1").all()
        for _ in range(8):
            env.step(env.idle())
        heights.append([env.sim.pose(f"{a}/tcp")[0][:, 2] for a in env.agents])
    (limp, other), (still, same) = heights
    assert (limp < still - 0.15).all()
    np.testing.assert_allclose(other, same, atol=1e-3)
    model, data = own(envs[0], 1), envs[0].sim._batch.get_data(1)
    mujoco.mj_forward(model, data)
    torques = [data.actuator_force[arm.servos] for arm in envs[0].scene.arms.values()]
    assert not torques[0].any() and torques[1].any()


def test_nothing_touches_an_absent_arm(make):
    def rammed(env):
        """Return how far the joints of robot_2 turn while robot_1 leans forward."""
        before = env.task.joints(env.sim)["robot_2"]
        actions = env.idle()
        actions["robot_1"][:, 1], actions["robot_1"][:, 3] = 1.0, 1.0
        for _ in range(11):
            env.step(actions)
        return np.abs(env.task.joints(env.sim)["robot_2"] - before).max()

    assert rammed(make(1, absent=("robot_2",))) < 1e-3 < 1e-2 < rammed(make(1))
    env = make(1, absent=("robot_1",))
    touches = own(env, 0).geom_contype[:] > 0
    agents = [env.model.body(int(b)).name.split("/")[0] for b in env.model.geom_bodyid]
    expected = (env.model.geom_contype > 0) & (np.array(agents) != "robot_1")
    np.testing.assert_array_equal(touches, expected)


def test_what_is_fixed_in_an_absent_hand_is_there():
    nothing = cg.Randomization(0, 0, 0, 0, absent=("robot_1",))
    env = cg.VectorEnv(cg.task("PokeTaskSawyers-v0", randomization=nothing), 1)
    env.reset(seed=0)
    stick = [
        i
        for i in range(env.model.ngeom)
        if env.model.body(int(env.model.geom_bodyid[i])).name.startswith(
            "robot_1/stick"
        )
    ]
    assert stick and (own(env, 0).geom_contype[stick] > 0).any()


def test_limp_and_absent_name_agents(make_env):
    with pytest.raises(KeyError, match="no agent 'robot_3'"):
        make_env(randomization=cg.Randomization(limp=("robot_3",)))
    with pytest.raises(TypeError, match="absent must be a tuple of agents, got 'robot"):
        cg.Randomization(absent="robot_1")
