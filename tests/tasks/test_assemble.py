"""Assemble: what holds what, what counts as in, and that it takes every arm."""

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import math
from collaborative_gym.objects import assembly
from collaborative_gym.scene import Scene
from collaborative_gym.scene.contacts import depth_sensors
from collaborative_gym.tasks.registry import make_task

STILL, ASIDE = (1.0, 0.0, 0.0, 0.0), 0.5**0.5
HARDEST = 140.0  # N, what a Panda's pads bear
SLOW = 700.0, 5.0  # N s/m and N m s/rad, so that parts move as slowly as hands do


@pytest.fixture(scope="module")
def env():
    env = cg.make_vec("AssemblePandas3-v0", 4, num_threads=1)
    env.reset(seed=0)
    yield env
    env.close()


@pytest.fixture(scope="module")
def parts():
    """Return a block that is fixed 1 m above the floor, a peg and a pin, weightless."""
    scene, block = Scene(), assembly.block()
    block.delete(block.joint("free"))
    scene.add("block", block, position=(0, 0, 1))
    scene.add("peg", assembly.peg())
    scene.add("pin", assembly.pin())
    scene.spec.option.gravity = (0.0, 0.0, 0.0)
    model = scene.compile()
    for name in ("peg/free", "pin/free"):
        start = model.joint(name).dofadr[0]
        model.dof_damping[start : start + 3] = SLOW[0]
        model.dof_damping[start + 3 : start + 6] = SLOW[1]
    return model


def pushed(model, part, place, force, quat=STILL, **others):
    """Return where in the block a push of 2 s brings a part, and how deep it gets, m.

    Others are where peg or pin are; they are far away otherwise.
    """
    data = mujoco.MjData(model)
    poses = {"peg": (5, 0, 0, *STILL), "pin": (0, 5, 0, *STILL), **others}
    poses[part] = *place, *quat
    for name, pose in poses.items():
        data.joint(f"{name}/free").qpos = np.add(pose, (0, 0, 1, 0, 0, 0, 0))
    body, deepest = model.body(f"{part}/{part}").id, 0.0
    data.xfrc_applied[body, :3] = force
    for _ in range(200):
        mujoco.mj_step(model, data)
        deepest = max(deepest, -data.contact.dist.min(initial=0.0))
    return data.joint(f"{part}/free").qpos[:3] - [0.0, 0.0, 1.0], deepest


def test_a_peg_goes_in_where_the_chamfer_leads_it_and_stops_at_its_collar(parts):
    for beside in (0.0, 0.004, -0.004):
        place, deepest = pushed(parts, "peg", (0.075, beside, 0), (-HARDEST, 0, 0))
        assert np.abs(place).max() < 0.0012 and deepest < 0.002
    # Beside the chamfer it slides off, however hard it is pushed.
    place, deepest = pushed(parts, "peg", (0.075, 0, 0.02), (-HARDEST, 0, 0))
    assert np.hypot(*place[1:]) > 0.01 and deepest < 0.004
    place, deepest = pushed(parts, "peg", (0.075, 0.03, 0), (-10, 0, 0))
    assert place[0] > 0.05 and deepest < 0.001


def test_a_pin_goes_through_block_and_peg_and_nothing_else_lets_it(parts):
    push, start = (0, -HARDEST, 0), (0, 0.06, 0)
    seated, half_in = (0, 0, 0, *STILL), (0.03, 0, 0, *STILL)
    turned = (0, 0, 0, ASIDE, ASIDE, 0, 0)
    # A straight push acts beside the pin's axis, so it is a gentle one that gets in.
    place, deepest = pushed(parts, "pin", start, (0, -40, 0), peg=seated)
    assert np.abs(place).max() < 0.004 and deepest < 0.001
    for peg in (half_in, turned):
        place, deepest = pushed(parts, "pin", start, push, peg=peg)
        assert place[1] > 0.01 and deepest < 0.003


def test_a_pin_locks_the_peg(parts):
    pull, seated = (HARDEST, 0, 0), (0, 0, 0, *STILL)
    place, deepest = pushed(parts, "peg", (0, 0, 0), pull, pin=seated)
    assert place[0] < 0.004 and deepest < 0.002
    assert pushed(parts, "peg", (0, 0, 0), pull)[0][0] > 0.2
    # And with the pin in, no peg goes in.
    place, _ = pushed(parts, "peg", (0.075, 0, 0), (-HARDEST, 0, 0), pin=seated)
    assert place[0] > 0.02


def test_holes_have_the_play_that_is_promised():
    peg, pin = (each().compile() for each in (assembly.peg, assembly.pin))
    block = assembly.block().compile()
    assert 2 * peg.geom("peg_1").size[1] == pytest.approx(0.03)
    assert 2 * pin.geom("pin_1").size[0] == pytest.approx(0.014)
    top, bottom = block.geom("block_2"), block.geom("block_1")
    gap = (top.pos[2] - top.size[2]) - (bottom.pos[2] + bottom.size[2])
    assert gap == pytest.approx(0.03 + assembly.PLAY)


def play(env, fault=None, agent=None):
    """Return completion, and how deep parts ever are in things, while experts play."""
    env.reset(seed=1)
    gripping, deepest = cg.load_policy("gripping", env), 0.0
    sensors = depth_sensors(env.model, ("objects",))["objects"]
    for _ in range(env.task.config.max_episode_steps - 1):
        actions = env.expert()
        if fault == "idle":
            actions[agent] = env.idle()[agent]
        elif fault == "gripping":
            actions[agent] = gripping({})[agent]
        elif fault == "frozen":
            held = env.scene.holds(env.sim, agent)
            still = env.idle({agent: held})[agent]
            actions[agent] = np.where(held[:, None], still, actions[agent])
        *_, infos = env.step(actions)
        deep = env.sim.sensordata[:, env.model.sensor_adr[sensors]]
        deepest = max(deepest, -float(deep.min()))
    return infos["metrics"]["completion"], deepest


@pytest.mark.parametrize("robots", (("panda",) * 3, ("jaco", "sawyer", "panda")))
def test_expert_assembles_and_nothing_passes_through_anything(robots):
    env = cg.VectorEnv(make_task("Assemble", robots), 8, num_threads=1)
    completion, deepest = play(env)
    env.close()
    assert (completion == 1.0).all()
    assert deepest < 0.001


@pytest.mark.slow
@pytest.mark.parametrize("fault", ("idle", "gripping", "frozen"))
def test_nothing_is_assembled_with_an_arm_that_does_not_help(env, fault):
    for agent in env.agents:
        completion, _ = play(env, fault, agent)
        assert (completion == 0.0).all()


def test_what_is_beside_a_hole_or_turned_is_not_in(env):
    env.reset(seed=0)
    state, task = env.get_state(), env.task
    block, away = np.array([0.0, 0.0, 1.2]), np.array([0.0, 0.0, 0.0])

    def facts(peg, pin=away, turn=STILL):
        for name, place, quat in (
            ("block", away, STILL),
            ("peg", peg, turn),
            ("pin", pin, STILL),
        ):
            task.scene.place(
                env.sim, np.arange(4), name=name, position=block + place, quat=quat
            )
        env.sim.forward()
        return task.measure(env.sim)

    np.testing.assert_allclose(facts((0.0, 0.0, 0.0)).inside, 1.0)
    half = facts((0.033, 0.0, 0.0), (0.0, 0.029, 0.0))
    np.testing.assert_allclose(half.inside[:, 1:], 0.5)
    np.testing.assert_allclose(half.stage, 0.5)
    assert not task.success(half).any()
    assert (facts((0.0, 0.004, 0.0)).inside[:, 1] == 0.0).all()
    assert (facts((0.0, 0.0, 0.0), (0.0, 0.0, 0.004)).inside[:, 2] == 0.0).all()
    turned = math.from_yaw(np.array(np.pi))
    assert (facts((0.0, 0.0, 0.0), turn=turned).inside[:, 1] == 0.0).all()
    # The pin waits before its hole until the peg is in.
    for out, waits in ((0.01, 0.14), (0.002, 0.0)):
        found = facts((out, 0.0, 0.0))
        place, _ = found.goals["robot_3"]
        np.testing.assert_allclose(place[:, 1] - block[1], waits, atol=1e-9)
    env.set_state(state)


def test_success_asks_for_the_block_at_its_target_and_half_a_second(env):
    env.reset(seed=0)
    facts = env.facts
    inside = np.ones_like(facts.inside)

    def reached(distance):
        far = {**facts.to_goal, "robot_1": np.full(4, distance)}
        return env.task.success(replaced(facts, inside=inside, to_goal=far))

    assert reached(0.049).all() and not reached(0.051).any()
    assert type(env.task).success_for == 5


def replaced(facts, **changes):
    return type(facts)(**{**vars(facts), **changes})


def test_rewards_are_what_the_page_says(env):
    env.reset(seed=0)
    _, rewards, *_, infos = env.step(env.idle())
    terms, facts = infos["reward_terms"], env.facts
    for agent in env.agents:
        own = terms[agent]
        np.testing.assert_allclose(own["reach"], -facts.to_knob[agent], rtol=1e-6)
        far = np.minimum(facts.to_goal[agent], 1.0) + 0.2 * facts.turn[agent]
        np.testing.assert_allclose(own["bring"], -far, rtol=1e-6)
        assert (own["insert"] == 0.0).all() and (own["success"] == 0.0).all()
        np.testing.assert_allclose(sum(own.values()), rewards[agent], rtol=1e-5)


def test_only_fingers_that_hold_a_part_pass_through_it(env):
    model = env.model
    pairs = {
        tuple(sorted((model.body(s >> 16).name, model.body(s & 0xFFFF).name)))
        for s in model.exclude_signature
    }
    names = ["block/block", "peg/peg", "pin/pin"]
    for i, agent in enumerate(env.agents):
        for finger in ("left_finger", "right_finger"):
            own = [p for p in names if (p, f"{agent}/{finger}") in pairs]
            assert own == [names[i]]
            geoms = model.body(f"{agent}/{finger}").geomadr[0]
            assert model.geom_conaffinity[geoms] & 2


def test_what_does_not_fit_is_refused_in_a_sentence():
    with pytest.raises(ValueError, match="keeps parts from turning"):
        cg.make("Assemble", grasp="magnet")
    with pytest.raises(ValueError, match="needs 3 robots, got 2"):
        cg.make("Assemble", robots=("panda", "panda"))
