"""The strain is what MuJoCo itself finds, physics step by physics step."""

from dataclasses import replace
from itertools import combinations

import gymnasium
import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.envs.strain import STRAIN, internal_force
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.timing import SIM_DT, SUBSTEPS

KINDS = "arms", "objects", "furniture"


def made(task, num_envs=2, **options):
    return VectorEnv(task, num_envs, num_threads=1, strain=True, **options)


def solved_to_the_end(build):
    """Return what also lets momentum balance, from which `Plain` finds torques."""

    def build_exactly(task, scene):
        build(task, scene)
        scene.spec.option.tolerance = 0.0

    return build_exactly


def played(env, policy, steps):
    """Return the strain after some steps."""
    observations, infos = env.reset(seed=0)
    for _ in range(steps):
        observations, *_, infos = env.step(policy(observations))
    return infos["metrics"]["strain"]


class Plain:
    """MuJoCo's own steps of world 0, beside the environment's, and what they find."""

    def __init__(self, env):
        self.env, self.model = env, env.model
        self.data, self.first = mujoco.MjData(env.model), mujoco.MjData(env.model)
        mujoco.mj_forward(env.model, self.first)
        self.found = dict.fromkeys(STRAIN, 0.0) | {"clearance": 1.0}
        self.held, self.at_limit = [], []
        self.step, env.sim.step = env.sim.step, self.steps

    def steps(self, controls, records=None, breaks=None, env_ids=None):
        state, kind = self.env.sim.get_state()[0], mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_setState(self.model, self.data, state, kind)
        for name in ("actuator_gainprm", "actuator_biasprm"):
            getattr(self.model, name)[:] = self.env.sim.expand(name)[0]
        for control in controls[0]:
            self.data.ctrl[:] = control
            before = self.data.qvel.copy()
            mujoco.mj_step(self.model, self.data)
            self.look()
            for arm in self.env.scene.arms.values():
                torque, turn = self.motors(before)[arm.dof], self.data.qvel[arm.dof]
                self.found["energy"] += np.abs(torque * turn).sum() * SIM_DT
                over = np.abs(torque) / arm.robot.torque_limits
                self.raises("torque_over_limit", over.max())
                commanded = np.abs(self.data.actuator_force[arm.servos] * turn)
                self.found["energy_commanded"] += commanded.sum() * SIM_DT
        self.step(controls, records, breaks)
        assert (self.data.qpos == self.env.sim.qpos[0]).all()
        mujoco.mj_forward(self.model, self.data)
        self.raises("clearance", self.clearance(), min)

    def raises(self, name, value, best=max):
        self.found[name] = best(self.found[name], value)

    def look(self):
        """After `mj_step` all but the state is still that of the step's beginning."""
        data, arms = self.data, self.env.scene.arms.values()
        forces = {}
        for i, contact in enumerate(data.contact):
            one, other = (self.owner(geom) for geom in contact.geom)
            kind = self.kind(one, other)
            self.raises(f"contact_depth_{kind}", -contact.dist)
            force = np.zeros(6)
            mujoco.mj_contactForce(self.model, data, i, force)
            if one > other:
                force = -force
            pair = kind, *sorted((one, other))
            total = contact.frame.reshape(3, 3).T @ force[:3]
            forces[pair] = forces.get(pair, 0.0) + total
        for (kind, *_), force in forces.items():
            self.raises(f"contact_force_{kind}", np.linalg.norm(force))
        for arm in arms:
            torque = np.abs(data.actuator_force[arm.servos])
            speed = np.abs(data.qvel[arm.dof])
            for name, felt in zip(("force", "torque"), self.felt(arm), strict=True):
                self.raises(f"wrist_{name}", np.linalg.norm(felt))
            self.at_limit += list(torque >= 0.99 * np.array(arm.robot.torque_limits))
            self.raises("speed_over_limit", (speed / arm.robot.velocity_limits).max())
        one, other = self.pulls()
        if one is not None:
            self.held.append(np.min(np.linalg.norm(one - shares(one + other), axis=1)))
            self.raises("internal_force", self.held[-1])

    def felt(self, arm):
        """Return force and torque at a wrist, without the hand's weight."""
        model, data = self.model, self.data
        link = model.dof_bodyid[arm.dof.stop - 1]
        torque, force = np.split(data.cfrc_int[link].copy(), 2)
        tcp, root = data.site_xpos[arm.tcp], model.body_rootid[link]
        torque -= np.cross(tcp - data.subtree_com[root], force)
        weight = model.body_subtreemass[link] * model.opt.gravity
        # Controllers are told once where it acts, whatever the fingers do.
        first, axes = self.first, data.site_xmat[arm.tcp].reshape(3, 3)
        centre = first.subtree_com[link] - first.site_xpos[arm.tcp]
        centre = axes @ first.site_xmat[arm.tcp].reshape(3, 3).T @ centre
        return force + weight, torque + np.cross(centre, weight)

    def motors(self, before):
        """Return what the motors added to the momentum in a step, per time."""
        model, data, inertia = self.model, self.data, np.zeros((self.model.nv,) * 2)
        mujoco.mj_fullM(model, data, inertia)
        others = data.qfrc_smooth - data.qfrc_actuator + data.qfrc_constraint
        return inertia @ (data.qvel - before) / SIM_DT - others

    def owner(self, geom):
        """Return the arm or the body of a shape."""
        name = self.model.body(self.model.geom_bodyid[geom]).name
        agent = name.split("/")[0]
        return agent if agent in self.env.agents else name

    def kind(self, *owners):
        names = [owner for owner in owners if owner not in self.env.agents]
        weights = [self.model.body_weldid[self.model.body(name).id] for name in names]
        if any(weights):
            return "objects"
        return "furniture" if names else "arms"

    def pulls(self):
        """Return the forces of both arms on what both hold, or nothing."""
        data, start, forces = self.data, 0, []
        while start < data.ne:
            bond = data.efc_id[start]
            is_weld = self.model.eq_type[bond] == mujoco.mjtEq.mjEQ_WELD
            forces.append(-data.efc_force[start : start + 3])
            start += 6 if is_weld else 3
            if is_weld:
                forces.append(self.carried(forces[0]))
        return forces if len(forces) == 2 else (None, None)

    def carried(self, pull):
        """Return the force of the arm that the board is fixed to, from its motion."""
        model, data = self.model, self.data
        board = model.body("robot_1/board/board").id
        motion = np.zeros(6)
        mujoco.mj_objectAcceleration(
            model, data, mujoco.mjtObj.mjOBJ_BODY, board, motion, 0
        )
        force = model.body_mass[board] * motion[3:] - pull
        force -= data.xfrc_applied[board, :3]
        for i, contact in enumerate(data.contact):
            bodies = [model.geom_bodyid[geom] for geom in contact.geom]
            if board in bodies:
                touch = np.zeros(6)
                mujoco.mj_contactForce(model, data, i, touch)
                touch = contact.frame.reshape(3, 3).T @ touch[:3]
                force += touch if bodies[0] == board else -touch
        return force

    def clearance(self):
        model, data = self.model, self.data
        owners = [self.owner(geom) for geom in range(model.ngeom)]
        excluded = {divmod(int(pair), 1 << 16) for pair in model.exclude_signature}
        least = 1.0
        for one, other in combinations(range(model.ngeom), 2):
            bodies = tuple(int(model.geom_bodyid[geom]) for geom in (one, other))
            if {owners[one], owners[other]} == set(self.env.agents) and not (
                {bodies, bodies[::-1]} & excluded
            ):
                gap = mujoco.mj_geomDistance(model, data, one, other, least, None)
                least = min(least, gap)
        return least

    def told(self):
        found = self.found | {
            "torque_limit_share": np.mean(self.at_limit),
            "internal_force_mean": np.mean(self.held) if self.held else 0.0,
        }
        if found["contact_depth_arms"] > 0.0:
            found["clearance"] = min(found["clearance"], -found["contact_depth_arms"])
        return found


def shares(total):
    """Return the forces between nothing and all, finely."""
    return np.linspace(0.0, 1.0, 20001)[:, None] * total


@pytest.mark.parametrize(
    ("env", "policy", "steps", "nonzero"),
    [
        (["PokeTaskSawyers-v0"], "random", 12, {"energy", "speed_over_limit"}),
        (["LiftTaskSawyers-v0"], "baseline", 20, {"internal_force"}),
        (["BalanceTaskSawyers-v0"], "baseline", 8, {"internal_force"}),
        (["Pass", ("jaco", "sawyer")], "expert", 40, {"contact_depth_arms"}),
        (["PokeTaskSawyers-v0", None, "torques"], "random", 12, {"energy"}),
        (["LiftTaskSawyers-v0", None, "impedance"], "expert", 20, {"internal_force"}),
    ],
)
def test_the_strain_is_what_mujoco_finds(env, policy, steps, nonzero, monkeypatch):
    action = env[2] if env[2:] else "joints"
    settings = {"action": action, "randomization": cg.Randomization()}
    task = make_task(*env[:2], **settings)
    monkeypatch.setattr(type(task), "build", solved_to_the_end(type(task).build))
    worlds = made(task)
    plain = Plain(worlds)
    strain = played(worlds, cg.load_policy(policy, worlds), steps)
    assert tuple(strain) == STRAIN
    found = plain.told()
    for name in STRAIN:
        assert strain[name][0] == pytest.approx(found[name], rel=1e-6, abs=1e-6), name
    assert all(found[name] > 0.0 for name in nonzero)


@pytest.mark.parametrize("env_id", ["ReachPandas4-v0", "LiftMixed3-v0"])
def test_the_clearance_is_the_least_of_all_pairs_of_shapes(env_id):
    """Boxes and spheres rule out nobody who is nearest, wherever the arms are."""
    count, plain = 24, []
    env = made(make_task(env_id), count)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    least = np.where(np.arange(count) % 3, 1.0, 0.1)
    for arm in env.scene.arms.values():
        drawn = rng.uniform(*arm.joint_range, (count, arm.num_joints))
        env.sim.qpos[:, arm.qpos] = drawn
    env.sim.forward()
    rows = {"strain: clearance": least.copy()}
    moved = np.arange(count) != count - 1
    env.strain.count_clearance(rows, moved)
    model, data = env.model, mujoco.MjData(env.model)
    names = [model.body(int(b)).name.split("/")[0] for b in model.geom_bodyid]
    collides = model.geom_contype & model.geom_conaffinity
    for qpos, bound in zip(env.sim.qpos[moved], least[moved], strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        gaps = [
            mujoco.mj_geomDistance(model, data, one, other, bound, None)
            for one, other in combinations(range(model.ngeom), 2)
            if names[one] != names[other]
            and {names[one], names[other]} <= set(env.agents)
            and collides[one]
            and collides[other]
        ]
        plain.append(min(gaps))
    assert rows["strain: clearance"].tolist() == [*plain, 1.0]
    assert len(set(plain)) > count / 2


def test_the_internal_force_of_a_control_step_is_its_mean():
    env = made(make_task("BalanceTaskSawyers-v0"))
    plain = Plain(env)
    played(env, cg.load_policy("random", env), 3)
    assert env.strain is not None
    found = np.mean(plain.held[-SUBSTEPS:])
    assert env.strain.internal_force[0] == pytest.approx(found, rel=1e-6) != 0.0


@pytest.mark.parametrize(
    ("forces", "spent"),
    [
        ([(0, 0, 20), (0, 0, 5)], 0.0),
        ([(7, 0, 0), (-7, 0, 0)], 7.0),
        ([(100, 0, 0), (-30, 0, 0)], 30.0),
        ([(10, 0, 24.5), (-10, 0, 24.5)], 10.0),
        ([(0, 0, 30), (0, 0, 30), (0, 0, -20)], 20.0),
        ([(3, 4, 0)], 0.0),
        ([(0, 0, 0), (0, 0, 0)], 0.0),
    ],
)
def test_internal_force_is_what_no_share_of_the_sum_explains(forces, spent):
    # Twice, as rows of a batch.
    rows = [np.tile(np.array(force, float), (2, 1)) for force in forces]
    np.testing.assert_allclose(internal_force(rows), [spent, spent], atol=1e-9)


@pytest.mark.parametrize("env_id", ["PassTaskJacoSawyer-v0", "BalanceTaskSawyers-v0"])
def test_measuring_moves_no_bit(env_id):
    task = make_task(env_id, max_episode_steps=6)
    plain, measured = VectorEnv(task, 3, num_threads=1), made(task, 3)
    policy = cg.load_policy("random", plain)
    observations, _ = plain.reset(seed=1)
    measured.reset(seed=1)
    for _ in range(8):
        actions = policy(observations)
        observations, rewards, *_ = plain.step(actions)
        others, own, *_ = measured.step(actions)
        for agent in plain.agents:
            assert (observations[agent] == others[agent]).all()
            assert (rewards[agent] == own[agent]).all()
        assert (plain.sim.get_state() == measured.sim.get_state()).all()


def steps_of(env, count, **reset):
    """Return the strain after each of some steps of one motion."""
    rng, told = np.random.default_rng(0), []
    env.reset(**reset)
    for _ in range(count):
        actions = {agent: rng.uniform(-1, 1, 7) for agent in env.agents}
        told.append(step(env, actions))
    return told


def step(env, actions):
    rows = {
        agent: np.tile(action, (env.num_envs, 1)) for agent, action in actions.items()
    }
    return env.step(rows)[-1]["metrics"]["strain"]


def same(one, other):
    return all((one[name] == other[name]).all() for name in STRAIN)


def test_bits_depend_on_no_other_world_and_no_watcher():
    task = make_task("BalanceTaskSawyers-v0")
    alone, among = made(task, 1), made(task, 3)
    reference = steps_of(among, 5, seed=2)
    for told, of_many in zip(
        steps_of(alone, 5, seed=2, episodes=[1]), reference, strict=True
    ):
        assert same(told, {name: rows[1:2] for name, rows in of_many.items()})
    among.watch(lambda: None, 5)
    assert all(map(same, steps_of(among, 5, seed=2), reference))


def test_a_saved_episode_goes_on_with_its_strain():
    env = made(make_task("BalanceTaskSawyers-v0"))
    *_, told = steps_of(env, 3, seed=0)
    state, actions = env.get_state(), {agent: np.ones(7) for agent in env.agents}
    then = step(env, actions)
    assert not same(told, then)
    env.reset(seed=5)
    env.set_state(state)
    assert same(step(env, actions), then)


def test_a_step_that_fails_leaves_no_strain():
    env = made(make_task("BalanceTaskSawyers-v0"))
    steps_of(env, 2, seed=0)
    state = env.get_state()

    def fail():
        raise RuntimeError("of the watcher")

    env.watch(fail, 2)
    with pytest.raises(RuntimeError, match="of the watcher"):
        env.step(env.idle())
    env.watch(None)
    for name, row in env.get_state().progress.items():
        assert (row == state.progress[name]).all(), name


def test_a_new_episode_begins_without_strain_and_a_resting_one_has_no_more(carry):
    env = made(carry(), 2, auto_reset=False)
    actions = {
        agent: np.ones(space.shape) for agent, space in env.single_action_spaces.items()
    }
    _, infos = env.reset(seed=0)
    assert (infos["metrics"]["strain"]["energy"] == 0.0).all()
    for _ in range(12):
        told = step(env, actions)
    env.reset(env_ids=[1])
    later = step(env, actions)
    assert all(later[name][0] == told[name][0] for name in STRAIN)
    assert 0.0 < later["energy"][1] < told["energy"][1]


def test_a_world_that_diverges_ends_with_finite_strain(carry):
    env = made(carry())
    env.reset(seed=0)
    env.sim.qvel[0] = 1e9
    *_, infos = env.step(env.idle())
    assert infos["diverged"].tolist() == [True, False]
    for rows in infos["metrics"]["strain"].values():
        assert np.isfinite(rows).all()
    assert infos["metrics"]["strain"]["speed_over_limit"][0] == 0.0


def test_a_grip_that_tears_between_two_actions_has_strained(carry):
    panda = cg.get_robot("panda")
    weak = replace(panda, gripper=replace(panda.gripper, holding_force=100.0))
    env = made(type(carry())((weak, weak), carry().config), 8)
    env.reset(seed=3)
    jerk = np.random.default_rng(0).choice([-1.0, 1.0], (2, 8, 8))
    jerk[:, :, 7] = 1.0
    *_, infos = env.step(dict(zip(env.agents, jerk, strict=True)))
    told, torn = infos["metrics"]["strain"], (env.sim.eq_active == 0).any(axis=1)
    assert (told["internal_force"][torn] > 0.0).any()
    mean, greatest = told["internal_force_mean"], told["internal_force"]
    assert ((mean > 0.0) == (greatest > 0.0)).all()
    assert (mean <= greatest).all() and (greatest <= 100.0).all()


def test_the_mean_force_counts_only_steps_in_which_two_arms_hold():
    env = made(cg.task("SortPandas2-v0"))
    env.reset(seed=0)
    for _ in range(60):  # One arm after the other takes cubes off the belt.
        *_, infos = env.step(env.expert())
    told = infos["metrics"]["strain"]
    assert (told["internal_force"] > 0.0).any()  # Of one hand alone.
    assert (told["internal_force_mean"] == 0.0).all()


def test_things_without_a_name_are_measured(carry):
    class Crowded(type(carry())):
        def build(self, scene):
            super().build(scene)
            post = scene.spec.worldbody.add_body(pos=(0.0, 0.0, 0.2))
            post.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.1, 0.2))

    base = carry()
    env = made(Crowded(tuple(base.robots.values()), base.config))
    assert played(env, lambda _: env.idle(), 2)["contact_force_furniture"].shape == (2,)


def test_every_face_tells_the_strain_that_is_asked_for():
    env_id = "PokeTaskSawyers-v0"
    _, infos = cg.make(env_id, strain=True).reset(seed=0)
    assert tuple(infos["robot_2"]["metrics"]["strain"]) == STRAIN
    _, infos = cg.make(env_id).reset(seed=0)
    assert "strain" not in infos["robot_2"]["metrics"]
    _, infos = gymnasium.make(env_id, strain=True).reset(seed=0)
    assert infos["metrics"]["strain"]["energy"] == 0.0
    _, infos = gymnasium.make_vec(env_id, 2, strain=True).reset(seed=0)
    assert infos["metrics"]["strain"]["energy"].tolist() == [0.0, 0.0]
    _, infos = cg.make_vec(env_id, 2, strain=True).reset()
    assert infos["metrics"]["strain"]["clearance"].tolist() == [1.0, 1.0]
