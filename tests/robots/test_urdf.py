"""URDF files are read as makers give them."""

import itertools
import struct
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_arm.py"
COMPUTED = {"armature": (), "damping": (), "stiffness": ()}


def test_a_urdf_keeps_its_looks_and_hides_what_collides(from_urdf, in_a_world):
    scene, model = in_a_world(from_urdf)
    drawn = scene.compile_to_draw()
    body = drawn.body("arm/forearm").id
    groups = sorted(drawn.geom_group[drawn.geom_bodyid == body].tolist())
    assert groups == [2, 2, 3, 3]
    assert (model.geom_bodyid == model.body("arm/forearm").id).sum() == 2


def test_a_prefix_need_not_be_declared(edited):
    arm = edited(
        ('<joint name="joint_1" ', '<joint name="joint_1" drake:rotor="1" '),
        ('<link name="tcp"/>', '<link name="tcp"><drake:shape/></link>'),
        suffix=".urdf",
    )
    assert len(arm.spec().joints) == 8
    with pytest.raises(ValueError, match="it is not XML: mismatched tag: line "):
        edited(("</robot>", "</robots>"), suffix=".urdf")


def test_a_continuous_joint_makes_two_turns(edited, compiled):
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


def test_meshes_of_a_package_are_found(meshed, tmp_path, compiled, in_a_world):
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


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (('<link name="forearm"', '<link name="hand"'), "it has 2 links 'hand'; give"),
        (
            ('<joint name="joint_5"', '<joint name="joint_4"'),
            "it has 2 joints 'joint_4'; give each of them a name of its own",
        ),
        (
            ('<parent link="forearm"', '<parent link="forarm"'),
            "parent of joint 'joint_4': no link 'forarm' .did you mean 'forearm'",
        ),
        (
            ('<mimic joint="left_finger"', '<mimic joint="left"'),
            "mimic of joint 'right_finger': no joint 'left' .did you mean 'left_fing",
        ),
        (('upper="2.7"', 'upper="2.7rad"'), "joint 'joint_3': bad format in .*'upper'"),
        (
            ('<joint name="joint_3" type="revolute"', '<joint name="joint_3" type="?"'),
            "joint 'joint_3': invalid joint type",
        ),
        (('<mass value="2.8"/>', '<mass value=""/>'), "link 'forearm': .*'mass'"),
    ],
)
def test_the_link_or_joint_that_is_wrong_is_named(edited, edit, message):
    with pytest.raises(
        ValueError, match=f"'own': arm.urdf cannot be loaded: {message}"
    ):
        edited(edit, suffix=".urdf")
