"""An arm that is not ours, `examples/own_arm.py`, in all tasks."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_arm.py"
TEAMS = "Poke", "Lift", "Balance", "BalancePath", "Pass"


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


@pytest.mark.parametrize("task", TEAMS)
@pytest.mark.parametrize("pair", [("own", "own"), ("sawyer", "own"), ("own", "jaco")])
def test_the_arm_goes_into_every_task(own, task, pair):
    report = cg.evaluate(cg.task(task, pair), "expert", episodes=3, num_threads=1)
    assert report.completion.mean == 1.0


def test_the_arm_pulls_a_bar_and_is_too_short_for_hockey(own):
    report = cg.evaluate(
        cg.task("Tug", (own, own)), "expert", episodes=3, num_threads=1
    )
    scores = [side.score.mean for side in report.sides.values()]
    assert sum(scores) == 1.0
    with pytest.raises(ValueError, match=r"own cannot bring its tcp .* folds farther"):
        cg.make("Hockey", robots=(own, own))


def test_an_arm_of_five_joints_is_told_what_it_lacks(edited):
    joint = '<joint name="joint_6" axis="0 1 0" range="-6.2832 6.2832"\n'
    drive = '                    actuatorfrcrange="-24 24"/>'
    arm = edited(
        (joint + drive, ""),
        joints=tuple(f"joint_{i}" for i in range(1, 6)),
        home=(0.0, -0.3, 1.9, 0.0, -1.57),
        velocity_limits=(1.8, 1.6, 2.2, 3.0, 3.0),
        torque_limits=(),
    )
    message = "reach, or one of 6 joints: 5 do not take every pose"
    with pytest.raises(ValueError, match=message):
        cg.make("Pass", robots=(arm, "panda"))


def test_arms_of_six_and_of_seven_joints_play_hockey(tmp_path):
    panda = cg.get_robot("panda")
    file, text = tmp_path / "arm.xml", panda.model_file.read_text()
    file.write_text(re.sub(r'<joint name="joint3"[^>]*/>', "", text))
    fields = ("joints", "home", "velocity_limits", "torque_limits")
    fields += ("armature", "damping", "stiffness")
    left = {name: getattr(panda, name) for name in fields}
    left = {name: (*each[:2], *each[3:]) for name, each in left.items()}
    arm = replace(panda, name="six", model_file=file, **left)
    for robots in ((arm, "sawyer"), ("sawyer", arm)):
        report = cg.evaluate(
            cg.task("Hockey", robots), "expert", episodes=2, num_threads=1
        )
        assert set(report.sides) == {"side_1", "side_2"}


def test_both_model_files_are_the_same_arm(own, from_urdf, compiled):
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


@pytest.mark.parametrize("task", [*TEAMS, "Tug"])
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


def test_an_arm_needs_no_fingers(own, edited, in_a_world):
    text = EXAMPLE.with_suffix(".xml").read_text()
    start = text.index('<body name="left_finger"')
    end = text.index("</body>", text.index('<body name="right_finger"')) + len(
        "</body>"
    )
    arm = edited((text[start:end], ""), gripper=cg.Gripper())
    scene, model = in_a_world(arm)
    assert model.nu == 6
    assert scene.arms["arm"].fingers == slice(0, 0)
    report = cg.evaluate(
        cg.task("Pass", (arm, own)), "expert", episodes=2, num_threads=1
    )
    assert report.completion.mean == 1.0


def test_an_arm_may_call_its_hand_a_palm(own, edited):
    arm = edited(('<body name="hand"', '<body name="palm"'))
    env = cg.make_vec("Pass", 1, robots=(arm, own), num_threads=1)
    assert env.model.body("robot_1/palm").id == env.scene.arms["robot_1"].hand


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
    for way in env.task.ways.values():
        assert way.approach[2] < -0.3
        for posture in way.angles:
            for arm in env.scene.arms.values():
                data.qpos[arm.qpos] = posture
            mujoco.mj_forward(env.model, data)
            arms = [env.model.body(f"{agent}/base").id for agent in env.agents]
            for geoms in data.contact.geom:
                roots = env.model.body_rootid[env.model.geom_bodyid[geoms]]
                assert not (table in geoms and set(roots) & set(arms))


def test_a_home_that_looks_away_is_named_where_another_would_do(own):
    """Mounted nearer it would fail as well, so that must not be the advice."""
    away = replace(own, home=(3.0, -0.3, 1.9, 0.0, -1.57, 0.0), damping=(), armature=())
    with pytest.raises(ValueError) as caught:
        cg.make("Poke", robots=(away, away))
    told = str(caught.value)
    assert "do it, such as [" in told and "choose a home" in told
    assert "mount it nearer" not in told
    miss = re.search(r"the best try was (\S+) mm and (\S+) rad away; 1 mm and", told)
    assert float(miss[1]) > 1.0 or float(miss[2]) > 0.01


def test_an_arm_that_does_not_come_to_lifts_pot_is_refused(edited):
    """It is always stretched out, so nothing is well within its reach."""
    stretched = edited(
        ('range="-2.2 2.2"', 'range="1.4 2.2"'),
        ('range="-2.7 2.7"', 'range="-0.1 0.1"'),
        home=(0.0, 1.5, 0.0, 0.0, 0.0, 0.0),
    )
    with pytest.raises(ValueError, match=r"own does not come to \[0.54, 0.0, 0.3\]"):
        cg.make("Lift", robots=(stretched, "panda"))
