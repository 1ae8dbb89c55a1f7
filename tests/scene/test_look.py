"""Arms drawn with the shapes of another model of them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.cli.main import main
from collaborative_gym.tasks.identity import Identity

PANDA = cg.get_robot("panda")
RED = "1 0 0 1"


@pytest.fixture
def look(tmp_path):
    """Return a function that writes Panda's model with changes, and names the file."""

    def write(*changes):
        text = PANDA.model_file.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "look.xml"
        path.write_text(text)
        return path

    return write


def drawn(robot):
    """Return the drawn model of a pair of Pandas, and where its geoms are, by body."""
    env = cg.make_vec("Pass", 1, robots=(robot, PANDA), num_threads=1)
    env.reset(seed=0)
    model = env.world.drawn_model
    data = mujoco.MjData(model)
    data.qpos[:] = env.sim.qpos[0]
    mujoco.mj_kinematics(model, data)
    return model, data


def seen(model, agent):
    """Return the geoms of an arm that are drawn."""
    names = [model.body(model.geom_bodyid[g]).name for g in range(model.ngeom)]
    group = model.geom_group
    return [
        g for g, name in enumerate(names) if name.startswith(agent) and group[g] < 3
    ]


def test_shapes_of_the_look_are_where_those_of_the_arm_were(look):
    red = look(("0.88 0.89 0.9 1", RED))
    model, data = drawn(replace(PANDA, look=red))
    usual, before = drawn(PANDA)
    own, other = seen(model, "robot_1"), seen(usual, "robot_1")
    assert len(own) == len(other) > 40
    # What is fixed to a link is drawn on the link.
    wearers = [usual.body(usual.geom_bodyid[g]).name for g in other]
    wearers = [name.replace("/hand", "/link7") for name in wearers]
    assert [model.body(model.geom_bodyid[g]).name for g in own] == wearers
    np.testing.assert_allclose(data.geom_xpos[own], before.geom_xpos[other], atol=1e-6)
    turns = data.geom_xmat[own], before.geom_xmat[other]
    np.testing.assert_allclose(*turns, atol=1e-6)
    assert (model.geom_rgba[own] == [1, 0, 0, 1]).all(axis=1).any()
    partner = seen(model, "robot_2")
    assert len(partner) == len(own)
    assert not (model.geom_rgba[partner] == [1, 0, 0, 1]).all(axis=1).any()


def test_meshes_are_copied_and_a_hand_that_the_file_lacks_stays(look):
    text = PANDA.model_file.read_text()
    hand = text[text.index('<frame quat="0.92387953') : text.index("</frame>") + 8]
    contact = text[text.index("<contact>") : text.index("</contact>") + 10]
    cube = " ".join(
        f"{x} {y} {z}" for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)
    )
    mesh = f'<mesh name="cube" vertex="{cube}"/>'
    part = '<geom class="visual" type="cylinder" size="0.044" fromto="0 0 0.055 0 0'
    shown = '<geom type="mesh" mesh="cube" contype="0" conaffinity="0"/>' + part
    changes = (hand, ""), (contact, ""), ("<asset>", "<asset>" + mesh), (part, shown)
    model, data = drawn(replace(PANDA, look=look(*changes)))
    body = model.body("robot_1/link7").id
    found = [g for g in seen(model, "robot_1") if model.geom_dataid[g] >= 0]
    assert [model.geom_bodyid[g] for g in found] == [body]
    asset = model.mesh(model.geom_dataid[found[0]])
    first, count = asset.vertadr[0], asset.vertnum[0]
    turn = data.geom_xmat[found[0]].reshape(3, 3)
    corners = data.geom_xpos[found[0]] + model.mesh_vert[first : first + count] @ turn.T
    in_body = (corners - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
    np.testing.assert_allclose(in_body.min(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(in_body.max(axis=0), [0.1, 0.2, 0.3], atol=1e-6)
    bodies = {model.body(model.geom_bodyid[g]).name for g in seen(model, "robot_1")}
    assert {"robot_1/hand", "robot_1/left_finger"} <= bodies


def test_a_look_changes_neither_physics_nor_identity(look):
    dressed = replace(PANDA, look=look(("0.88 0.89 0.9 1", RED)))
    tasks = [cg.task("Lift", robots=(robot, PANDA)) for robot in (PANDA, dressed)]
    assert Identity.of(tasks[0]) == Identity.of(tasks[1])
    hashes = []
    for task in tasks:
        env = cg.VectorEnv(task, 2, num_threads=1)
        env.reset(seed=3)
        for _ in range(5):
            observations = env.step(env.expert())[0]
        hashes.append([rows.tobytes() for rows in observations.values()])
    assert hashes[0] == hashes[1]


def test_what_is_no_model_of_the_arm_is_refused(look, tmp_path):
    elsewhere = look(
        ('name="link1" pos="0 0 0.333"', 'name="link1" pos="0 0.02 0.333"')
    )
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    fixed = tmp_path / "fixed.xml"
    fixed.write_text("<mujoco/>")
    for file, kind, reason in (
        (cg.get_robot("sawyer").model_file, ValueError, "axis of 'joint2' .* 83 mm"),
        (elsewhere, ValueError, "axis of 'joint1' .* 20 mm and 0 degrees apart"),
        (fixed, ValueError, "fixed.xml has 0 joints, and the arm 7"),
        (broken, ValueError, "cannot compile its look broken.xml"),
        (tmp_path / "none.xml", FileNotFoundError, "there is no look .*none.xml"),
    ):
        env = cg.make_vec("Pass", 1, robots=(replace(PANDA, look=file), PANDA))
        with pytest.raises(kind, match=reason):
            _ = env.world.drawn_model
    with pytest.raises(TypeError, match="look must be a path"):
        replace(PANDA, look=3)


@pytest.mark.parametrize(
    ("word", "reason"),
    (
        ("panda", "--look takes the arm before"),
        ("sawyr=x.xml", "no robot 'sawyr'"),
    ),
)
def test_the_command_line_says_how_looks_are_named(word, reason, capsys, tmp_path):
    video = str(tmp_path / "film.mp4")
    words = ["record", "PassTaskSawyers-v0", "--look", word, "--output", video]
    assert main(words) != 0
    assert reason in " ".join(capsys.readouterr().err.split())
