"""The example's arm, `examples/own_arm.py`, and arms made from parts of it."""

import runpy
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest

import collaborative_gym as cg
from collaborative_gym import robots
from collaborative_gym.control import JointChanges
from collaborative_gym.scene import Scene

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


@pytest.fixture
def compiled():
    """Return a function that compiles an arm alone and puts it at home."""

    def make(robot):
        model = robot.spec().compile()
        data = mujoco.MjData(model)
        for joint, angle in zip(robot.joints, robot.home, strict=True):
            data.joint(joint).qpos = angle
        mujoco.mj_forward(model, data)
        return model, data

    return make


@pytest.fixture
def in_a_world():
    """Return a function that puts an arm into a world of its own."""

    def make(robot, holds=None):
        scene = Scene()
        scene.add_robot("arm", robot, placement=cg.Placement((0, 0, 1)), holds=holds)
        JointChanges.add_drives(scene)
        return scene, scene.compile()

    return make
