import mujoco
import numpy as np
import pytest

from collaborative_gym.control import JointChanges
from collaborative_gym.objects.table import table
from collaborative_gym.robots import get_robot
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.cpu import CpuSim


def ball():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ball")
    body.add_freejoint(name="free")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], name="shape")
    body.add_site(name="centre")
    return spec


@pytest.fixture
def scene():
    scene = Scene()
    scene.add_robot("robot_1", get_robot("panda"), placement=Placement((0, -1, 0.7)))
    scene.add_robot(
        "robot_2",
        get_robot("sawyer"),
        placement=Placement((0, 1, 1.0), np.pi),
        holds=0.02,
    )
    scene.add("ball", ball(), position=(0, 0, 1.0))
    scene.add_grip("robot_1", "ball/centre", threshold=0.03, width=0.04)
    scene.add_target("goal", 0.02, rgba=(0, 1, 0, 1))
    return scene


def test_arms_are_found_under_their_agents_prefix(scene):
    JointChanges.add_drives(scene)
    model = scene.compile()
    for agent in ("robot_1", "robot_2"):
        arm = scene.arms[agent]
        names = [f"{agent}/{joint}" for joint in arm.robot.joints]
        assert [model.joint(i).name for i in range(model.njnt)][arm.dof] == names
        assert [model.actuator(i).name for i in range(model.nu)][arm.servos] == names
        assert model.site(arm.tcp).name == f"{agent}/tcp"
    assert scene.arms["robot_1"].fingers.stop - scene.arms["robot_1"].fingers.start == 2
    assert scene.arms["robot_2"].fingers == slice(0, 0)


def test_fingers_that_hold_a_tool_are_fixed_at_its_width():
    gaps = {}
    for width in (0.02, 0.05):
        scene = Scene()
        scene.add_robot(
            "robot_1", get_robot("panda"), placement=Placement((0, 0, 1)), holds=width
        )
        model = scene.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        tips = [data.body(f"robot_1/{side}_finger").xpos for side in ("left", "right")]
        gaps[width] = np.linalg.norm(tips[0] - tips[1])
        assert model.nv == 7
    assert gaps[0.05] - gaps[0.02] == pytest.approx(0.03, abs=1e-6)


def test_a_repeated_grip_of_a_site_reads_one_sensor(scene):
    scene.add_grip("robot_2", "ball/centre", threshold=0.03, width=0.04)
    model = scene.compile()
    assert [grip.agent for grip in scene.grips] == ["robot_1", "robot_2"]
    assert model.neq == 2
    assert not model.eq_active0.any()


def test_a_site_may_be_measured_twice_but_a_name_has_one_site(scene):
    scene.add_pose_sensor("ball/centre", "ball/centre")
    scene.add_pose_sensor("robot_1/tcp", "robot_1/tcp")
    with pytest.raises(ValueError, match="'goal' is measured at the site 'goal' alrea"):
        scene.add_pose_sensor("goal", "ball/centre")
    model = scene.compile()
    sensors = [model.sensor(i).name for i in range(model.nsensor)]
    assert sensors.count("ball/centre.position") == 1


def test_an_object_without_mass_is_named(scene):
    weightless = ball()
    weightless.geom("shape").mass = 0
    scene.add("puck", weightless)
    with pytest.raises(
        ValueError,
        match=r"^MuJoCo cannot compile the scene: mass and inertia .*'puck/ball'.*; g",
    ):
        scene.compile()


def test_physics_leaves_out_what_is_only_seen_and_keeps_every_mass(scene):
    physics, drawn = scene.compile(), scene.compile_to_draw()
    assert physics.ngeom < drawn.ngeom
    assert np.all((physics.geom_contype | physics.geom_conaffinity) > 0)
    moves = physics.body_jntnum[physics.body_weldid] > 0
    np.testing.assert_array_equal(physics.body_mass[moves], drawn.body_mass[moves])
    inertias = physics.body_inertia[moves], drawn.body_inertia[moves]
    np.testing.assert_array_equal(*inertias)
    assert physics.nq == drawn.nq


def test_what_is_only_seen_weighs_where_nothing_else_does(scene):
    lamp = ball()
    lamp.body("ball").add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.1, 0.2, 0.3],
        pos=[0.05, 0.1, 0.2],
        contype=0,
        conaffinity=0,
        mass=2.0,
    )
    scene.add("lamp", lamp)
    physics, drawn = scene.compile(), scene.compile_to_draw()
    assert physics.body("lamp/ball").geomnum == 1
    for name in ("mass", "inertia", "ipos", "iquat"):
        own = getattr(physics.body("lamp/ball"), name)
        assert (own == getattr(drawn.body("lamp/ball"), name)).all(), name
    assert physics.body("lamp/ball").mass > 2.0


def test_a_table_carries_and_its_legs_are_in_the_way():
    scene = Scene()
    scene.add("table", table())
    scene.add("ball", ball())
    model = scene.compile()
    data = mujoco.MjData(model)
    for place, touches in (
        ((0.0, 0.0, 0.66), True),
        ((0.25, -0.55, 0.3), True),
        ((0.0, 0.0, 0.3), False),
    ):
        data.joint("ball/free").qpos[:3] = place
        mujoco.mj_forward(model, data)
        assert bool(data.ncon) == touches, place


@pytest.mark.parametrize(
    ("first", "second", "collide"),
    [
        ("robot_1/link5_upper_collision", "robot_2/link5_upper_collision", True),
        ("robot_1/link5_upper_collision", "robot_1/link2_collision", True),
        ("robot_1/hand_collision", "ball/shape", True),
        ("robot_1/left_finger_collision", "ball/shape", False),
        ("robot_1/left_finger_collision", "floor", True),
        ("ball/shape", "floor", True),
        ("robot_1_stand/table_top_collision", "floor", False),
    ],
)
def test_collision_bits(first, second, collide):
    scene = Scene()
    for agent, y in (("robot_1", -1), ("robot_2", 1)):
        scene.add_robot(agent, get_robot("panda"), placement=Placement((0, y, 0.7)))
    scene.add("ball", ball(), position=(0, 0, 1.0))
    model = scene.compile()
    a, b = _geom(model, first), _geom(model, second)
    bits = (model.geom_contype, model.geom_conaffinity)
    meet = (bits[0][a] & bits[1][b]) | (bits[0][b] & bits[1][a])
    assert bool(meet) == collide


def _geom(model, name):
    found = [i for i in range(model.ngeom) if model.geom(i).name.startswith(name)]
    assert found, [model.geom(i).name for i in range(model.ngeom)]
    return found[0]


def test_things_are_placed_by_name(scene):
    sim = CpuSim(scene.compile(), 3, 1)
    places = np.array([[0.5, 0.0, 1.0], [0.6, 0.0, 1.0]])
    scene.place(sim, [0, 2], name="ball", position=places, quat=[0.0, 0.0, 0.0, 1.0])
    scene.place(sim, [0, 2], name="goal", position=[0.1, 0.2, 0.3])
    sim.forward()
    np.testing.assert_allclose(sim.pose("ball/centre")[0][[0, 2]], places)
    np.testing.assert_allclose(sim.pose("ball/centre")[1][0], [0, 0, 0, 1])
    np.testing.assert_allclose(sim.pose("ball/centre")[0][1], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(scene.targets(sim)["goal"][2], [0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match=r"no movable object 'bal'.*mean 'ball'"):
        scene.place(sim, [0], name="bal", position=[0.0, 0.0, 0.0])


def test_a_grip_tells_where_it_holds(scene):
    sim = CpuSim(scene.compile(), 3, 1)
    assert scene.holds(sim, "robot_1").tolist() == [False] * 3
    sim.eq_active[1] = 1
    assert scene.holds(sim, "robot_1").tolist() == [False, True, False]
    with pytest.raises(ValueError, match="robot_2 has no grip; give it one by add_gr"):
        scene.holds(sim, "robot_2")


def test_a_name_that_names_nothing_fails_where_it_is_given(scene):
    with pytest.raises(ValueError, match=r"no site 'ball/center'.*'ball/centre'"):
        scene.add_grip("robot_1", "ball/center", threshold=0.03, width=0.04)
    with pytest.raises(ValueError, match=r"no arm 'robot_3'.*add_robot comes first"):
        scene.add_grip("robot_3", "ball/centre", threshold=0.03, width=0.04)
    with pytest.raises(ValueError, match="no site 'bal'"):
        scene.add_pose_sensor("ball", "bal")


def test_a_world_without_a_camera_gets_one(scene):
    assert scene.compile_to_draw().ncam == 0
    scene.compile()
    assert scene.compile_to_draw().camera("overview").id == 0
