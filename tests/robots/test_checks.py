"""Wrong definitions of an arm say what to change."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg

COMPUTED = {"armature": (), "damping": (), "stiffness": ()}


def test_neighbours_may_overlap_at_home(own, from_urdf, in_a_world):
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


WRONG_VALUES = [
    ({"name": ""}, "name must not be empty"),
    ({"name": "my arm"}, "name must be one word of letters, digits .*got 'my arm'"),
    ({"stand": "desk"}, "no stand 'desk'.*; stands: none, pedestal, table"),
    ({"joints": ()}, "joints must name each joint once"),
    ({"joints": ("joint_1",) * 6}, "joints must name each joint once"),
    ({"home": (0.0,) * 5}, "has 6 joints but 5 values in home; give one per joint"),
    (
        {"home": (0.0, 3.0, 0, 0, 0, 0)},
        "home puts joint 'joint_2' at 3, outside of its",
    ),
    ({"home": (0, -45.0, 0, 0, 0, 0)}, "give angles in rad, not in degrees"),
    ({"home": (np.nan, 0, 0, 0, 0, 0)}, r"home\[0\] must be finite, got nan"),
    (
        {"home": (0, 0, 2.69, 0, -1.57, 0)},
        "bodies 'upper_arm' and 'left_finger' touch at home; give a home where they do",
    ),
    ({"velocity_limits": ()}, "has 6 joints but 0 values in velocity_limits"),
    (
        {"velocity_limits": (0.0,) + (1.0,) * 5},
        "velocity_limits of joint 'joint_1' must be",
    ),
    ({"velocity_limits": (120.0,) * 6}, "to 30 rad/s, got 120; give rad/s, not"),
    ({"torque_limits": (-5.0,) + (1.0,) * 5}, "torque_limits of joint 'joint_1' must"),
    ({"damping": (np.inf,) + (1.0,) * 5}, r"damping\[0\] must be finite, got inf"),
    ({"armature": (-1.0,) + (1.0,) * 5}, "must be 0 to 1000 kg m2, got -1"),
    ({"stiffness": (1e300,) + (1.0,) * 5}, "stiffness of joint 'joint_1' must be"),
    ({"payload": 0.0}, "robot .*: payload must be above 0, got 0.0"),
    ({"payload": 5000.0}, "payload of 5000 kg weighs 49050.0 N, but its gripper's hol"),
    ({"reach": -1.0}, "reach must be above 0, got -1.0"),
    ({"reach": 900.0}, "its reach is 900 m, but .* 0.95 m away from the axis of its f"),
    ({"reach": 1.7}, "its reach is 1.7 m, but .* give the reach in m, from the shoul"),
    ({"reach": 0.35}, "its reach is 0.35 m, but .* 0.95 m away from the axis"),
    ({"reach": float("inf")}, "reach must be finite, got inf"),
    (
        {"joints": tuple(f"joint{i}" for i in range(6))},
        "no joint 'joint0' .did .*; joints: ",
    ),
    ({"tcp": "tpc"}, "own_arm.xml has no frame 'tpc' .did you mean 'tcp'.*; frames: "),
    ({"tcp": "forearm"}, "its body 'forearm' is not carried by 'wrist_3'; list joints"),
    (
        {"joints": tuple(f"joint_{i}" for i in (2, 1, 3, 4, 5, 6))},
        "its body 'shoulder' is not carried by 'upper_arm'; list joints from the base",
    ),
    (
        {"joints": tuple(f"joint_{i}" for i in range(1, 6)), "home": (0.0,) * 5}
        | {"velocity_limits": (1.0,) * 5},
        "a joint 'joint_6' that nothing would drive; name an arm's in joints and a ",
    ),
]


@pytest.mark.parametrize(("fields", "message"), WRONG_VALUES)
def test_wrong_values_are_refused(own, fields, message):
    with pytest.raises(ValueError, match=message):
        replace(own, **{"torque_limits": (), **COMPUTED, **fields})


WRONG_FILES = [
    (
        (' range="-2.2 2.2"', ' range="-126 126"'),
        "'joint_2' has the range -126 to 126; give rad, not degrees, and two turns",
    ),
    (
        (
            '<body name="forearm" pos="0 -0.11 0.42">',
            '<body name="forearm" pos="0 -110 420">',
        ),
        "the way along its joints to the tcp is 435 m long; give m, not mm",
    ),
    (
        ('size="0.012 0.006 0.035"', 'size="12 6 35"'),
        "a shape of its body 'left_finger' is 75 m wide; give m, not mm; a mesh in mm",
    ),
    ((' range="-2.2 2.2"', ' range="2.2 -2.2"'), "its range the wrong way round, 2.2"),
    ((' range="-2.2 2.2"', ""), "joint 'joint_2' has no range; give it one in the mod"),
    (
        ('<joint name="joint_4"', '<joint name="joint_4" type="slide"'),
        "'joint_4' is a s",
    ),
    (
        ('    actuatorfrcrange="-70 70"', ""),
        "no torque limit for joint 'joint_3'; pass",
    ),
    (
        ('<body name="base">', '<body name="base" pos="0 0 0.7">'),
        "its base is 0.70 m away from the origin of the model file, too far for a reac",
    ),
    (
        ('<body name="shoulder" pos="0 0 0.15">', '<body name="shoulder" pos="2 0 0">'),
        "its axis of the first joint is 2.00 m away from the origin",
    ),
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
    (
        ('mass="3.6"', 'mass="0"'),
        "mass and inertia.*, Element name 'shoulder', .*; give it a mass in kg and an",
    ),
    (
        ("0.00845 0.007605 0.00845", "0.00845 7605 0.00845"),
        "Element name 'shoulder', .*; no body has this inertia: give it in kg m2",
    ),
    (
        ('name="joint_5"', 'name="joint_4"'),
        "cannot be loaded: repeated name 'joint_4' in joint, Element 'joint', line ",
    ),
    (("</worldbody>", ""), "robot 'own': arm.xml cannot be loaded: "),
    (
        ('<body name="base">', '<body name="base"><freejoint/>'),
        "a joint without a name, of body 'base', that nothing",
    ),
]


def in_joint(attribute):
    return '<joint name="joint_1"', f'<joint {attribute} name="joint_1"'


# A world with any of these would diverge at every step.
WRONG_NUMBERS = [
    (in_joint('frictionloss="nan"'), "joint 'joint_1' must be finite, got nan"),
    (in_joint('armature="-1"'), "joint 'joint_1' must be 0 to 1000 kg m2"),
    (in_joint('damping="1e300"'), "joint 'joint_1' must be 0 to 100000 N m s/rad"),
    (in_joint('stiffness="-5"'), "joint 'joint_1' must be 0 to"),
    (in_joint('springref="inf"'), "joint 'joint_1' must be finite, got inf"),
    (in_joint('solreflimit="nan 1"'), "joint 'joint_1' must be finite, got nan"),
    (in_joint('pos="0 0 nan"'), "must be finite, got nan"),
    (('mass="3.6"', 'mass="1e300"'), "body 'shoulder' must be 0 to 10000 kg, got 1e"),
    (('mass="3.6"', 'mass="inf"'), "body 'shoulder' must be finite, got inf"),
    (("0 0 -0.0108", "0 0 1e9"), "ipos of body 'shoulder' must be -10 to 10 m, got 1e"),
    (("0 0 -0.0108", "0 0 nan"), "ipos of body 'shoulder' must be finite"),
    (
        ('size="0.012 0.006 0.035"', 'size="0.012 0.006 0.035" friction="nan 1 1"'),
        "geom .* must be finite, got nan",
    ),
    (("-70 70", "-1e300 1e300"), "torque_limits of joint 'joint_3' must be"),
]


@pytest.mark.parametrize(("edit", "message"), WRONG_NUMBERS)
def test_numbers_that_no_arm_can_have_are_refused(edited, edit, message):
    with pytest.raises(ValueError, match=message):
        edited(edit, torque_limits=())


@pytest.mark.parametrize(("edit", "message"), WRONG_FILES)
def test_wrong_model_files_are_refused(edited, edit, message):
    with pytest.raises(ValueError, match=message):
        edited(edit, torque_limits=())


def test_an_arm_may_stand_on_a_column(edited, compiled):
    """A joint's anchor may lie anywhere on its axis."""
    for suffix, old, new in (
        (".xml", 'name="shoulder" pos="0 0 0.15"', 'name="shoulder" pos="0 0 0.6"'),
        (".urdf", '<origin xyz="0 0 0.15"/>', '<origin xyz="0 0 0.6"/>'),
    ):
        _, data = compiled(edited((old, new), suffix=suffix))
        assert data.body("shoulder").xpos[2] == pytest.approx(0.6)


def test_the_wrist_is_where_its_axes_meet(edited):
    """The last joint has its anchor beyond the tcp, so z seems to point back."""
    anchor = '<joint name="joint_6"', '<joint name="joint_6" pos="0 0.4 0"'
    edited(anchor)
    with pytest.raises(ValueError, match="where now its -z axis"):
        edited(anchor, ('<site name="tcp"', '<site name="tcp" euler="3.1416 0 0"'))


def test_what_may_touch_in_an_xml_cannot_be_told_in_a_urdf(edited):
    home = (0, 0, 2.69, 0, -1.57, 0)
    with pytest.raises(ValueError, match="or let them pass one another: <contact><ex"):
        edited(home=home)
    with pytest.raises(ValueError, match=r"leave out a <collision> of one of them$"):
        edited(suffix=".urdf", home=home)


def test_parts_of_a_gripper_may_touch(edited):
    """As those of a linkage do, which have joints between them."""
    knuckles = (
        '<geom type="box" size="0.012 0.006 0.035" pos="0 0.006 0.035"',
        '<body name="knuckle"><joint name="knuckle" class="finger" axis="0 1 0"/>'
        '<geom size="0.005" fromto="0 0 0.03 0 -0.09 0.03" mass="0.01"/></body>'
        '<geom type="box" size="0.012 0.006 0.035" pos="0 0.006 0.035"',
    )
    follows = '<equality><joint joint1="knuckle" joint2="left_finger"/></equality>'
    arm = edited(knuckles, ("</worldbody>", "</worldbody>" + follows))
    touching = {(e.bodyname1, e.bodyname2) for e in arm.spec().excludes}
    assert ("knuckle", "right_finger") in touching


def test_motors_too_weak_for_the_payload_are_refused(own):
    torques = tuple(limit / 3 for limit in own.torque_limits)
    with pytest.raises(ValueError, match=r"its greatest torque limit 35 N m; correct"):
        replace(own, torque_limits=torques, payload=60.0, **COMPUTED)


def test_motors_too_weak_for_the_arms_own_weight_are_refused(own):
    # Those of the motors themselves, without their gears, as some files give them.
    torques = tuple(limit / 100 for limit in own.torque_limits)
    told = r"'joint_2' bears 7\.3 N m of the arm's own weight at home, but has a torque"
    with pytest.raises(ValueError, match=told):
        replace(own, torque_limits=torques, **COMPUTED)


def test_a_missing_mesh_is_named(edited):
    asset = ("<asset>", '<asset><mesh name="hand" file="hand.stl"/>')
    geom = ('<site name="tcp"', '<geom type="mesh" mesh="hand"/><site name="tcp"')
    with pytest.raises(FileNotFoundError, match=r"'hand\.stl'; put the mesh beside"):
        edited(asset, geom)


def test_other_formats_are_refused(own, tmp_path):
    file = tmp_path / "arm.sdf"
    file.write_text("<sdf/>")
    with pytest.raises(
        ValueError, match=r"its name must end in \.xml \(MJCF\) or \.urd"
    ):
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
        ({"open_gap": 78.0}, "open_gap must be at most 1 m, got 78; give m, not mm"),
        ({"closed_gap": -0.1}, "closed_gap must be at least 0 and below its open_gap"),
        ({"force": 0.0}, "force must be above 0, got 0.0"),
        (
            {"holding_force": 0.06},
            "of 5 kg weighs 49.1 N, but .* holding_force is 0.06 N",
        ),
        ({"force": np.nan}, "force must be finite, got nan"),
        ({"joints": "left_finger"}, "joints must be a sequence of names"),
        (
            {"open_position": 0.5},
            "gripper.open_position puts joint 'left_finger' at 0.5",
        ),
        ({"open_position": 0.0, "closed_position": 0.039}, "swap the two"),
        (
            {"joints": ("left_fingr",)},
            "no joint 'left_fingr' .did you mean .*; joints: ",
        ),
    ],
)
def test_wrong_grippers_are_refused(own, fields, message):
    with pytest.raises((TypeError, ValueError), match=message):
        replace(own, gripper=replace(own.gripper, **fields))
