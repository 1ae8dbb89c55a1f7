"""Any arm's model file is prepared for any world."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.scene import Scene
from collaborative_gym.timing import SIM_DT


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
def test_the_tcp_may_be_a_body(edited, suffix, compiled):
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


def test_links_float_and_fingers_do_not(from_urdf, compiled):
    model, _ = compiled(from_urdf)
    for name in ("shoulder", "wrist_3", "hand"):
        assert model.body_gravcomp[model.body(name).id] == 1
    assert model.body_gravcomp[model.body("left_finger").id] == 0


def test_light_fingers_are_kept_stable(edited, in_a_world):
    own = edited(('mass="0.08"', 'mass="0.001"'))
    scene, model = in_a_world(own)
    arm, data = scene.arms["arm"], mujoco.MjData(model)
    data.qpos[arm.qpos] = data.act[:] = own.home
    for position in (0.039, 0.0, 0.039):
        data.ctrl[arm.fingers] = position
        mujoco.mj_step(model, data, nstep=100)
        for finger in own.gripper.joints:
            assert data.joint(f"arm/{finger}").qpos[0] == pytest.approx(
                position, abs=2e-3
            )


def test_what_the_world_decides_is_left_out_of_the_file(
    edited, monkeypatch, tmp_path, in_a_world
):
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
    # Each joint has a servo, and so has each finger.
    assert model.nu == 6 + 2
    assert model.nkey == 0
    assert model.opt.timestep == SIM_DT
    assert model.opt.gravity[2] == pytest.approx(-9.81)
    assert model.nlight == Scene().spec.compile().nlight
    assert len(scene.arms) == 1


def test_a_finger_that_holds_is_turned_by_its_joint_alone(edited, in_a_world):
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


RIGHT = '<joint name="right_finger" class="finger" axis="0 -1 0"/>'


@pytest.mark.parametrize(
    "right", ['axis="0 1 0" range="-0.04 0"', 'axis="1 0 0" range="-1 0" type="hinge"']
)
def test_a_finger_may_count_its_way_with_the_other_sign(edited, in_a_world, right):
    arm = edited((RIGHT, f'<joint name="right_finger" {right}/>'))
    scene, model = in_a_world(arm)
    data = mujoco.MjData(model)
    for position in (0.039, 0.0):
        data.ctrl[scene.arms["arm"].fingers] = position
        mujoco.mj_step(model, data, nstep=200)
        for side in "left", "right":
            own = data.joint(f"arm/{side}_finger").qpos[0]
            assert own == pytest.approx(position, abs=3e-3)
    low, high = model.joint("arm/right_finger").range
    assert low == 0.0 and high > 0.0


def test_a_mirrored_finger_may_be_in_degrees(edited, in_a_world):
    degrees = [
        (f'range="-{x} {x}"', f'range="-{np.degrees(x)} {np.degrees(x)}"')
        for x in (6.2832, 2.2, 2.7, 3.4)
    ]
    hinge = '<joint name="right_finger" axis="1 0 0" range="-57 0"/>'
    arm = edited(
        (' angle="radian"', ""),
        ('"-1.5707963 0 0"', '"-90 0 0"'),
        (RIGHT, hinge),
        *degrees,
    )
    _, model = in_a_world(arm)
    np.testing.assert_allclose(
        model.joint("arm/right_finger").range, (0.0, np.radians(57)), atol=1e-9
    )


def test_what_follows_a_mirrored_finger_keeps_its_way(edited, in_a_world):
    """A third part follows the right finger, which counts its way downwards."""
    mirrored = RIGHT, '<joint name="right_finger" axis="0 1 0" range="-0.04 0"/>'
    part = (
        '<body name="right_finger" pos="0 0 0.06">',
        '<body name="slider" pos="0 0 0.2"><joint name="slider" type="slide"/>'
        '<geom size="0.01 0.01" mass="0.1"/></body>'
        '<body name="right_finger" pos="0 0 0.06">',
    )
    follows = (
        '<equality><joint joint1="slider" joint2="right_finger"'
        ' polycoef="0.01 2 3 0 0"/></equality>'
    )
    arm = edited(mirrored, part, ("</worldbody>", "</worldbody>" + follows))
    _, held = in_a_world(arm, holds=0.04)
    way = -arm.gripper.position(0.04)
    expected = 0.2 + 0.01 + 2 * way + 3 * way**2
    np.testing.assert_allclose(held.body("arm/slider").pos[2], expected, atol=1e-9)


def test_torque_limits_may_be_those_of_actuators(own, edited):
    limits = ' actuatorfrcrange="-70 70"'
    for actuator, torque in (
        ('<position joint="joint_3" kp="9" forcerange="-70 70"/>', 70.0),
        ('<motor joint="joint_3" forcerange="-7 9" gear="-5"/>', 35.0),
        ('<motor joint="joint_3" ctrlrange="-8 8" gear="5"/>', 40.0),
    ):
        arm = edited(
            ("\n             " + limits, ""),
            ("</worldbody>", f"</worldbody><actuator>{actuator}</actuator>"),
            torque_limits=(),
        )
        assert arm.torque_limits[2] == torque
        assert arm.torque_limits[:2] == own.torque_limits[:2]
    # Limits of a joint count for more, and a position servo's range is of angles.
    more = edited(
        (
            "</worldbody>",
            '</worldbody><actuator><motor joint="joint_3"'
            ' forcerange="-9 9"/></actuator>',
        ),
        torque_limits=(),
    )
    assert more.torque_limits == own.torque_limits
    with pytest.raises(ValueError, match="no torque limit for joint 'joint_3'"):
        edited(
            ("\n             " + limits, ""),
            (
                "</worldbody>",
                '</worldbody><actuator><position joint="joint_3"'
                ' ctrlrange="-2 2"/></actuator>',
            ),
            torque_limits=(),
        )


def test_a_finger_may_mimic_another(edited, in_a_world):
    mimic = 'joint="left_finger"/>', 'joint="left_finger" multiplier="0.5"/>'
    gripper = cg.Gripper(("left_finger",), 0.039, 0.0, 0.078, 0.0, 60.0)
    arm = edited(mimic, suffix=".urdf", gripper=gripper)
    scene, model = in_a_world(arm)
    assert model.nu == 6 + 1
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


def test_fingers_that_mimic_and_have_servos_are_not_tied_besides(from_urdf, in_a_world):
    _, model = in_a_world(from_urdf)
    assert model.neq == 0
    assert model.nu == 6 + 2


def test_visual_meshes_are_drawn_and_change_no_bit(tmp_path):
    panda = cg.get_robot("panda")
    text = Path(panda.model_file).read_text()
    corners = ("v 0 0 0", "v .1 0 0", "v 0 .1 0", "v 0 0 .1")
    faces = ("f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4")
    (tmp_path / "cowl.obj").write_text("\n".join((*corners, *faces)))
    shape = '<geom class="visual" type="mesh" mesh="cowl"/>'
    text = text.replace("<asset>", '<asset><mesh name="cowl" file="cowl.obj"/>', 1)
    text = re.sub(r'<geom class="visual" size="0.0545"[^>]*/>', shape, text, count=1)
    file = tmp_path / "panda.xml"
    file.write_text(text)
    played = []
    for arm in panda, replace(panda, name="meshed", model_file=file):
        env = cg.make_vec("Lift", 1, robots=(arm, "panda"), num_threads=1)
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.expert())
        played.append(env.sim.qpos.copy())
    drawn = env.world.drawn_model
    names = [drawn.mesh(i).name for i in range(drawn.nmesh)]
    assert any("cowl" in name for name in names) and env.model.nmesh == 0
    np.testing.assert_array_equal(*played)
