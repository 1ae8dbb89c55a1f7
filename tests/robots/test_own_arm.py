"""An arm that is not ours, `examples/own_arm.py`, and what else users may bring."""

import ast
import itertools
import runpy
import struct
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import robots
from collaborative_gym.control import CONTROL_DT, MAX_CHANGE
from collaborative_gym.scene import SIM_DT, Scene

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_arm.py"
COMPUTED = {"armature": (), "damping": (), "stiffness": ()}


@pytest.fixture
def example(monkeypatch):
    """Return what the example defines; what it registers is forgotten afterwards."""
    monkeypatch.setattr(robots, "_ROBOTS", dict(robots._ROBOTS))
    return runpy.run_path(str(EXAMPLE))


@pytest.fixture
def own(example):
    """Return the example's arm."""
    return example["OWN"]


@pytest.fixture
def from_urdf(own):
    """Return the example's arm with all that its URDF file can say taken from there."""
    urdf = EXAMPLE.with_suffix(".urdf")
    return replace(own, model_file=urdf, torque_limits=(), **COMPUTED)


@pytest.fixture
def edited(own, tmp_path):
    """Return a function that makes the arm from a model file in which text differs."""

    def make(*edits, suffix=".xml", **fields):
        text = EXAMPLE.with_suffix(suffix).read_text()
        for old, new in edits:
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / f"arm{suffix}"
        file.write_text(text)
        return replace(own, **{"model_file": file, **COMPUTED, **fields})

    return make


def compiled(robot):
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    for joint, angle in zip(robot.joints, robot.home, strict=True):
        data.joint(joint).qpos = angle
    mujoco.mj_forward(model, data)
    return model, data


def in_a_world(robot, holds=None):
    scene = Scene()
    scene.add_robot("arm", robot, cg.Placement((0, 0, 1)), holds=holds)
    return scene, scene.compile()


def dofs(robot, model):
    return [int(model.joint(name).dofadr[0]) for name in robot.joints]


def test_the_value_has_at_most_twenty_lines():
    (value,) = (
        node
        for node in ast.parse(EXAMPLE.read_text()).body
        if isinstance(node, ast.Assign) and node.targets[0].id == "OWN"
    )
    assert value.end_lineno - value.lineno + 1 <= 20


@pytest.mark.parametrize("model", ["xml", "urdf"])
def test_the_example_runs(example, capsys, tmp_path, model):
    picture = tmp_path / "own.png"
    example["main"](env="Poke", model=model, episodes=2, picture=picture)
    printed = capsys.readouterr().out
    assert "Poke with own and panda: 100% completed" in printed
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize("task", cg.list_tasks())
@pytest.mark.parametrize("pair", [("own", "own"), ("sawyer", "own"), ("own", "jaco")])
def test_the_arm_goes_into_every_task(own, task, pair):
    report = cg.evaluate(task, "expert", 3, robots=pair, num_threads=1)
    assert report.completion.mean == 1.0


def test_both_model_files_are_the_same_arm(own, from_urdf):
    for field in ("torque_limits", "armature", "damping", "stiffness"):
        np.testing.assert_allclose(getattr(from_urdf, field), getattr(own, field))
    rng = np.random.default_rng(0)
    for angles in rng.uniform(-2.0, 2.0, (5, 6)):
        seen = []
        for robot in (own, from_urdf):
            model, data = compiled(replace(robot, home=angles))
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, full)
            tcp = data.site("tcp")
            seen.append((tcp.xpos, tcp.xmat, full, data.qfrc_bias, data.qfrc_gravcomp))
        for first, second in zip(*seen, strict=True):
            np.testing.assert_allclose(first, second, atol=1e-9)


@pytest.mark.parametrize("task", cg.list_tasks())
def test_both_model_files_play_the_same(own, from_urdf, task):
    angles = []
    for robot in (own, from_urdf):
        env = cg.make_vec(task, 1, robots=(robot, "panda"), num_threads=1)
        env.reset(seed=0)
        for _ in range(10):
            env.step(env.expert())
        angles.append(np.array(env.sim.qpos[:, env.scene.arms["robot_1"].qpos]))
        env.close()
    np.testing.assert_allclose(angles[0], angles[1], atol=1e-6)


def test_an_arm_is_asked_for_by_name_once_it_is_registered(own):
    assert cg.get_robot("own") is own
    assert "own" in cg.list_robots()
    env = cg.make_vec("Poke", 1, robots=("own", "panda"), num_threads=1)
    assert env.single_action_spaces["robot_1"].shape == (6,)
    for taken in (own, replace(own, name="panda")):
        with pytest.raises(ValueError, match=f"'{taken.name}' is registered already; "):
            cg.register_robot(taken)


def test_what_is_left_out_is_filled_in(own):
    assert own.title == "own"
    assert (own.stand, own.tcp) == ("table", "tcp")
    assert own.torque_limits == (105, 105, 70, 24, 24, 24)
    bare, data = compiled(own)
    full = np.zeros((bare.nv, bare.nv))
    mujoco.mj_fullM(bare, data, full)
    links = np.diag(full)[dofs(own, bare)]
    rotors = np.array(own.armature)
    # But for the fingers, which are open when it is computed.
    np.testing.assert_allclose(own.damping, (links + rotors) / SIM_DT, rtol=3e-3)
    np.testing.assert_allclose(own.stiffness, 8.0 * np.array(own.damping))
    speed = np.minimum(own.velocity_limits, MAX_CHANGE / CONTROL_DT)
    push = np.array(own.torque_limits) / speed
    np.testing.assert_allclose(
        rotors, np.maximum(0.02 * push - links, 0.01 * push), rtol=3e-3
    )


def test_what_is_given_is_kept(edited):
    rotor = ('range="-3.4 3.4"', 'range="-3.4 3.4" armature="0.7"')
    arm = edited(rotor, torque_limits=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    assert arm.armature[3] == pytest.approx(0.7)
    assert arm.damping[3] > 70.0
    assert arm.torque_limits == (1, 2, 3, 4, 5, 6)
    given = edited(stiffness=(900.0,) * 6, damping=(90.0,) * 6, armature=(0.4,) * 6)
    assert given.stiffness == (900.0,) * 6
    _, model = in_a_world(given)
    np.testing.assert_allclose(model.dof_armature[:6], 0.4)
    np.testing.assert_allclose(model.actuator("arm/joint_1").gainprm[0], 900.0)


def test_the_files_torque_limits_do_not_bind_those_that_are_given(edited):
    model, _ = compiled(edited(torque_limits=(500.0,) * 6))
    assert not model.jnt_actfrclimited.any()


@pytest.mark.parametrize("name", ["own", "sawyer", "panda", "jaco"])
def test_computed_gains_follow_commands(own, make_env, name):
    robot = replace(cg.get_robot(name), **COMPUTED)
    count = len(robot.joints)
    apart = (cg.Placement((0, -3, 2)), cg.Placement((0, 3, 2)))
    still = cg.Randomization(joint_noise=0.0)
    env = make_env(
        2 * count, robots=(robot, robot), placements=apart, randomization=still
    )
    env.reset(seed=0)
    arm, speeds = env.scene.arms["robot_1"], []
    env.watch(lambda: speeds.append(np.abs(env.sim.qvel[:, arm.dof])), env.substeps)
    # Each world turns one joint, one way or the other.
    joints = np.concatenate([np.eye(count), -np.eye(count)])
    idle = np.zeros((2 * count, 1))
    scale = np.minimum(MAX_CHANGE, CONTROL_DT * np.array(robot.velocity_limits))
    turned = []
    for turn in (1.0, 1.0, -1.0):
        before = env.sim.qpos[:, arm.qpos].copy()
        action = np.concatenate([turn * joints, idle], axis=1)
        env.step(dict.fromkeys(env.agents, action))
        turned.append(turn * ((env.sim.qpos[:, arm.qpos] - before) / scale * joints))
    shares = np.sum(turned, axis=2)
    assert (shares[0] > 0.85).all()
    assert (np.abs(shares[1] - 1.0) < 0.02).all()
    peak = np.max(speeds, axis=(0, 1)) / robot.velocity_limits
    assert (peak < 1.12).all()


def test_an_arm_needs_no_fingers(own, edited):
    text = EXAMPLE.with_suffix(".xml").read_text()
    start = text.index('<body name="left_finger"')
    end = text.index("</body>", text.index('<body name="right_finger"')) + len(
        "</body>"
    )
    arm = edited((text[start:end], ""), gripper=cg.Gripper())
    scene, model = in_a_world(arm)
    assert model.nu == 6
    assert scene.arms["arm"].fingers == slice(0, 0)
    report = cg.evaluate("Pass", "expert", 2, robots=(arm, own), num_threads=1)
    assert report.completion.mean == 1.0


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
def test_the_tcp_may_be_a_body(edited, suffix):
    link = '<link name="tcp"/>', '<link name="tip"/>'
    edits = {
        ".xml": [('<site name="tcp" pos="0 0 0.115"/>', '<body name="tip"/>')],
        ".urdf": [link, ('<child link="tcp"/>', '<child link="tip"/>')],
    }
    arm = edited(*edits[suffix], suffix=suffix, tcp="tip")
    model, data = compiled(arm)
    assert model.body(model.site("tip").bodyid[0]).name == "hand"
    np.testing.assert_allclose(data.site("tip").xpos, data.body("tip").xpos, atol=1e-12)
    np.testing.assert_allclose(data.site("tip").xmat, data.body("tip").xmat, atol=1e-9)


def test_links_float_and_fingers_do_not(from_urdf):
    model, _ = compiled(from_urdf)
    for name in ("shoulder", "wrist_3", "hand"):
        assert model.body_gravcomp[model.body(name).id] == 1
    assert model.body_gravcomp[model.body("left_finger").id] == 0


def test_light_fingers_are_kept_stable(edited):
    own = edited(('mass="0.08"', 'mass="0.001"'))
    scene, model = in_a_world(own)
    arm, data = scene.arms["arm"], mujoco.MjData(model)
    data.qpos[arm.qpos] = data.act[arm.act] = own.home
    for position in (0.039, 0.0, 0.039):
        data.ctrl[arm.fingers] = position
        mujoco.mj_step(model, data, nstep=100)
        for finger in own.gripper.joints:
            assert data.joint(f"arm/{finger}").qpos[0] == pytest.approx(
                position, abs=2e-3
            )


def test_what_the_world_decides_is_left_out_of_the_file(edited, monkeypatch, tmp_path):
    extra = """
      <option timestep="0.002" integrator="RK4" gravity="0 0 -5" cone="elliptic"/>
      <visual><map znear="0.5"/></visual>
      <size memory="1M"/>
      <actuator><position name="own" joint="joint_1" kp="99"/></actuator>
      <sensor><actuatorfrc actuator="own"/></sensor>
      <keyframe><key qpos="0 0 0 0 0 0 0 0" ctrl="0"/></keyframe>
      <worldbody><light pos="0 0 3"/></worldbody>
    </mujoco>"""
    arm = edited(("</mujoco>", extra))
    # MuJoCo logs its warnings where it runs, such as those of settings in conflict.
    monkeypatch.chdir(tmp_path)
    scene, model = in_a_world(arm)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert model.nu == 6 + 2
    assert model.nkey == 0
    assert model.opt.timestep == SIM_DT
    assert model.opt.gravity[2] == pytest.approx(-9.81)
    assert model.nlight == Scene().spec.compile().nlight
    assert len(scene.arms) == 1


def test_neighbours_may_overlap_at_home(own, from_urdf):
    for robot in (own, from_urdf):
        _, model = in_a_world(robot)
        names = {model.body(name).id for name in ("arm/base", "arm/shoulder")}
        pairs = [{int(s) >> 16, int(s) & 0xFFFF} for s in model.exclude_signature]
        assert pairs == [names]
    for name in ("sawyer", "panda", "jaco"):
        count = len(
            mujoco.MjSpec.from_file(str(cg.get_robot(name).model_file)).excludes
        )
        assert len(cg.get_robot(name).spec().excludes) == count


def test_a_finger_that_holds_is_turned_by_its_joint_alone(edited):
    """Its body's orientation may be given in other ways too, such as Euler angles."""
    turned = (
        '<body name="right_finger" pos="0 0 0.06">',
        '<body name="right_finger" pos="0 0 0.06" euler="0 0 3.14159265">',
    )
    hinge = 'axis="0 -1 0"', 'axis="1 0 0" type="hinge"'
    _, model = in_a_world(edited(turned, hinge), holds=0.05)
    held = model.body("arm/right_finger")
    np.testing.assert_allclose(held.pos, (0, 0, 0.06), atol=1e-9)
    half = 0.025 / 2
    expected = (0, 0, np.sin(half), np.cos(half))
    np.testing.assert_allclose(held.quat, expected, atol=1e-6)


def test_a_finger_may_mimic_another(edited):
    mimic = 'joint="left_finger"/>', 'joint="left_finger" multiplier="0.5"/>'
    gripper = cg.Gripper(("left_finger",), 0.039, 0.0, 0.078, 0.0, 60.0)
    arm = edited(mimic, suffix=".urdf", gripper=gripper)
    scene, model = in_a_world(arm)
    assert model.nu == 7
    data = mujoco.MjData(model)
    data.ctrl[scene.arms["arm"].fingers] = 0.03
    mujoco.mj_step(model, data, nstep=200)
    driver, follower = (
        data.joint(f"arm/{side}_finger").qpos for side in ("left", "right")
    )
    np.testing.assert_allclose(driver, 0.03, atol=3e-3)
    np.testing.assert_allclose(follower, driver / 2, atol=1e-3)
    _, held = in_a_world(arm, holds=0.05)
    assert held.neq == 0
    assert held.nv == 6
    np.testing.assert_allclose(held.body("arm/left_finger").pos[1], 0.025)
    np.testing.assert_allclose(held.body("arm/right_finger").pos[1], -0.0125)


def test_fingers_that_mimic_and_have_servos_are_not_tied_besides(from_urdf):
    _, model = in_a_world(from_urdf)
    assert model.neq == 0
    assert model.nu == 8


def test_a_urdf_keeps_its_looks_and_hides_what_collides(from_urdf):
    scene, model = in_a_world(from_urdf)
    drawn = scene.compile_to_draw()
    body = drawn.body("arm/forearm").id
    groups = sorted(drawn.geom_group[drawn.geom_bodyid == body].tolist())
    assert groups == [2, 2, 3, 3]
    assert (model.geom_bodyid == model.body("arm/forearm").id).sum() == 2


def test_a_continuous_joint_makes_two_turns(edited):
    limits = 'lower="-6.2832" upper="6.2832" effort="105" velocity="1.8"'
    arm = edited(
        (limits, 'effort="105" velocity="1.8"'),
        ('name="joint_1" type="revolute"', 'name="joint_1" type="continuous"'),
        suffix=".urdf",
    )
    model, _ = compiled(arm)
    np.testing.assert_allclose(model.joint("joint_1").range, (-2 * np.pi, 2 * np.pi))


def tetrahedron(path):
    """Write a small mesh."""
    corners = 0.05 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = list(itertools.combinations(range(4), 3))
    rows = [struct.pack("<12fH", 0, 0, 0, *corners[list(f)].ravel(), 0) for f in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + b"".join(rows))


@pytest.fixture
def meshed(own, tmp_path):
    """Return a function that makes the arm of a ROS package whose hand is a mesh."""

    def make(visual, collision):
        text = EXAMPLE.with_suffix(".urdf").read_text()
        start = text.index('<geometry><box size="0.06 0.1 0.06"/>')
        first, second = (
            f'<geometry><mesh filename="{name}"/></geometry>'
            for name in (visual, collision)
        )
        shape = '<geometry><box size="0.06 0.1 0.06"/></geometry>'
        text = text[:start] + text[start:].replace(shape, first, 1)
        text = text.replace(shape, second, 1)
        file = tmp_path / "ws" / "own_description" / "urdf" / "own.urdf"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return replace(own, model_file=file, **COMPUTED)

    return make


def test_meshes_of_a_package_are_found(meshed, tmp_path):
    folder = tmp_path / "ws" / "own_description" / "meshes"
    tetrahedron(folder / "visual" / "hand.stl")
    tetrahedron(folder / "collision" / "hand.STL")
    tetrahedron(tmp_path / "ws" / "other_description" / "hand.stl")
    here = "package://own_description/meshes"
    for visual, collision in (
        (f"{here}/visual/hand.stl", f"{here}/collision/hand.STL"),
        ("../meshes/visual/hand.stl", "package://other_description/hand.stl"),
        (f"file://{folder}/visual/hand.stl", f"{folder}/collision/hand.STL"),
    ):
        model, _ = compiled(meshed(visual, collision))
        assert model.nmesh == 2
    # What MuJoCo cannot draw is drawn as it collides.
    scene, model = in_a_world(meshed(f"{here}/hand.dae", f"{here}/visual/hand.stl"))
    drawn = scene.compile_to_draw()
    (geom,) = np.flatnonzero(drawn.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    assert drawn.geom_group[geom] < 3
    # Meshes that nothing collides with take no time from the physics.
    _, model = in_a_world(
        meshed(f"{here}/visual/hand.stl", f"{here}/collision/hand.STL")
    )
    assert model.nmesh == 1


def test_meshes_that_cannot_be_read_are_refused(meshed, tmp_path):
    folder = tmp_path / "ws" / "own_description"
    tetrahedron(folder / "hand.stl")
    there, missing = "package://own_description/hand.stl", "package://gone/hand.stl"
    with pytest.raises(FileNotFoundError, match=r"'own': own\.urdf.* gone/hand|gone/h"):
        meshed(missing, there)
    with pytest.raises(ValueError, match=r"collision mesh .*dae; convert it to STL"):
        meshed(there, "package://own_description/hand.dae")
    (folder / "hand.stl").write_bytes(b"nothing")
    with pytest.raises(
        ValueError, match=r"robot 'own': MuJoCo cannot compile own\.urd"
    ):
        meshed(there, there)


WRONG_VALUES = [
    ({"name": ""}, "robot '': give it a name"),
    ({"stand": "desk"}, "no stand 'desk'; stands: none, pedestal, table"),
    ({"joints": ()}, "joints must name each arm joint once"),
    ({"joints": ("joint_1",) * 6}, "joints must name each arm joint once"),
    ({"home": (0.0,) * 5}, "has 6 joints but 5 values in home; give one per joint"),
    (
        {"home": (0.0, 3.0, 0, 0, 0, 0)},
        "home puts joint 'joint_2' at 3, outside of its",
    ),
    ({"home": (np.nan, 0, 0, 0, 0, 0)}, "home of joint 'joint_1' must be finite, got"),
    (
        {"home": (0, 0, 2.69, 0, -1.57, 0)},
        "bodies 'upper_arm' and 'left_finger' touch at home; give a home where they do",
    ),
    ({"velocity_limits": ()}, "has 6 joints but 0 values in velocity_limits"),
    ({"velocity_limits": (0.0,) + (1.0,) * 5}, "must be finite and above 0, got 0.0"),
    ({"torque_limits": (-5.0,) + (1.0,) * 5}, "torque_limits of joint 'joint_1' must"),
    ({"damping": (np.inf,) + (1.0,) * 5}, "damping of joint 'joint_1' must be finite"),
    ({"armature": (-1.0,) + (1.0,) * 5}, "finite and at least 0, got -1.0"),
    ({"payload": 0.0}, "payload must be above 0, got 0.0"),
    ({"reach": -1.0}, "reach must be above 0, got -1.0"),
    ({"reach": float("inf")}, "reach must be above 0, got inf"),
    (
        {"joints": tuple(f"joint{i}" for i in range(6))},
        "no joint 'joint0'; joints: .*did",
    ),
    ({"tcp": "tpc"}, "own_arm.xml has no frame 'tpc'; frames: .*did you mean 'tcp'"),
    ({"tcp": "forearm"}, "its body 'forearm' is not carried by 'wrist_3'; list joints"),
    (
        {"joints": tuple(f"joint_{i}" for i in (2, 1, 3, 4, 5, 6))},
        "its body 'shoulder' is not carried by 'upper_arm'; list joints from the base",
    ),
    (
        {"joints": tuple(f"joint_{i}" for i in range(1, 6)), "home": (0.0,) * 5}
        | {"velocity_limits": (1.0,) * 5},
        "a joint 'joint_6' that nothing would drive; name it in joints or in gripper",
    ),
    (
        {"reach": 0.2},
        r"first joint is at \[0.0, 0.0, 0.15\].*; move the base to the ori",
    ),
]


@pytest.mark.parametrize(("fields", "message"), WRONG_VALUES)
def test_wrong_values_are_refused(own, fields, message):
    with pytest.raises(ValueError, match=message):
        replace(own, **{"torque_limits": (), **COMPUTED, **fields})


WRONG_FILES = [
    ((' range="-2.2 2.2"', ""), "joint 'joint_2' has no range; give it one in the mod"),
    (
        ('<joint name="joint_4"', '<joint name="joint_4" type="slide"'),
        "'joint_4' is a s",
    ),
    (
        ('    actuatorfrcrange="-70 70"', ""),
        "no torque limit for joint 'joint_3'; pass",
    ),
    (('<body name="base">', '<body name="base" pos="0 0 0.7">'), "first joint is at"),
    (('<body name="base">', '<body name="base" pos="2 0 0">'), "first joint is at"),
    (
        ("<worldbody>", '<worldbody><geom name="floor" size="1 1 1"/>'),
        "geom 'floor' ou",
    ),
    (
        ('<site name="tcp"', '<site name="tcp" euler="0 1.57 0"'),
        "where now its -x axis",
    ),
    (
        ('<site name="tcp"', '<site name="tcp" euler="0 0 1.57"'),
        "close along x of its t",
    ),
    (('mass="3.6"', 'mass="-3.6"'), "robot 'own': MuJoCo cannot compile arm.xml: "),
    (("</worldbody>", ""), "robot 'own': arm.xml cannot be loaded: "),
    (
        ('<body name="base">', '<body name="base"><freejoint/>'),
        "a joint '' that nothing",
    ),
]


@pytest.mark.parametrize(("edit", "message"), WRONG_FILES)
def test_wrong_model_files_are_refused(edited, edit, message):
    with pytest.raises(ValueError, match=message):
        edited(edit, torque_limits=())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "arm.urdf cannot be loaded: it is not XML"),
        ("<mujoco/>", "a URDF file begins with <robot>, this one with <mujoco>"),
        (
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
            "it is a xacro file; expand it first",
        ),
    ],
)
def test_what_is_no_urdf_is_refused(own, tmp_path, text, message):
    file = tmp_path / "arm.urdf"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        replace(own, model_file=file)


def test_a_missing_model_file_is_named(own, tmp_path):
    with pytest.raises(
        FileNotFoundError, match="robot 'own': there is no model file /"
    ):
        replace(own, model_file=tmp_path / "arm.xml")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"open_position": 0.0}, "open_position must differ from its closed_position"),
        ({"open_gap": 0.0}, "closed_gap must be at least 0 and below its open_gap"),
        ({"closed_gap": -0.1}, "closed_gap must be at least 0 and below its open_gap"),
        ({"force": 0.0}, "force must be above 0, got 0.0"),
        ({"force": np.nan}, "numbers of a gripper must be finite"),
        ({"joints": "left_finger"}, "joints must be a sequence of names"),
        (
            {"open_position": 0.5},
            "gripper.open_position puts joint 'left_finger' at 0.5",
        ),
        ({"open_position": 0.0, "closed_position": 0.039}, "swap the two"),
        ({"joints": ("left_fingr",)}, "no joint 'left_fingr'; joints: .*did you mean"),
    ],
)
def test_wrong_grippers_are_refused(own, fields, message):
    with pytest.raises((TypeError, ValueError), match=message):
        replace(own, gripper=replace(own.gripper, **fields))


def test_lists_and_text_do_for_tuples_and_paths(own):
    listed = replace(
        own,
        joints=list(own.joints),
        home=np.array(own.home),
        model_file=str(own.model_file),
    )
    assert listed == own
    assert hash(listed) == hash(own)


def test_a_six_joint_arm_lifts_with_its_elbow_up(own):
    env = cg.make_vec("Lift", 1, robots=(own, own), num_threads=1)
    env.reset(seed=0)
    data, table = (
        mujoco.MjData(env.model),
        env.model.geom("table/table_top_collision").id,
    )
    for way in env.task._ways.values():
        assert way.approach[2] < -0.3
        for posture in way.angles:
            for arm in env.scene.arms.values():
                data.qpos[arm.qpos] = posture
            mujoco.mj_forward(env.model, data)
            arms = [env.model.body(f"{agent}/base").id for agent in env.agents]
            for geoms in data.contact.geom:
                roots = env.model.body_rootid[env.model.geom_bodyid[geoms]]
                assert not (table in geoms and set(roots) & set(arms))
