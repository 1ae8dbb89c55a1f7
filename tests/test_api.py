"""What `import collaborative_gym` offers."""

import dataclasses
import inspect
import os
import subprocess
import sys

import gymnasium
import pytest

import collaborative_gym as cg
from collaborative_gym import motion, objects
from collaborative_gym.tasks.registry import get_env


def run(code, **variables):
    """Run Python code in a fresh process and return what it prints."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **variables}
    environment = {name: value for name, value in environment.items() if value}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def test_every_public_name_is_there():
    for name in cg.__all__:
        assert getattr(cg, name) is not None
    assert dir(cg) == sorted(cg.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'mak'"):
        cg.mak  # noqa: B018


def test_the_import_is_light():
    code = "import sys, collaborative_gym; print(*sys.modules)"
    loaded = set(run(code).split())
    assert not loaded & {"torch", "imageio", "PIL", "rich", "tyro", "OpenGL.GL"}


def test_egl_is_chosen_without_a_display():
    code = (
        "import collaborative_gym, mujoco;"
        "print(mujoco.Renderer.__init__ and mujoco.GLContext.__module__)"
    )
    nothing = {"MUJOCO_GL": "", "DISPLAY": "", "WAYLAND_DISPLAY": ""}
    assert run(code, **nothing) == "mujoco.egl"
    assert run(code, **{**nothing, "MUJOCO_GL": "glfw"}) == "mujoco.glfw"


def test_every_id_is_known_to_gymnasium():
    for env_id in cg.list_envs():
        spec = gymnasium.spec(env_id)
        assert spec.kwargs == {"env_id": env_id}


def test_an_unknown_id_is_refused_with_the_nearest(carry_id):
    with pytest.raises(KeyError) as caught:
        cg.make("CarryPanda-v0")
    message = str(caught.value)
    hint = f"no environment 'CarryPanda-v0' (did you mean '{carry_id}'?); environments:"
    assert message.startswith(hint)
    assert message.endswith(
        "for one of your own, load its file (--module FILE, cg.load_module)"
    )
    with pytest.raises(KeyError, match="did you mean 'Carry'"):
        cg.make("Carri")


@pytest.mark.parametrize(
    ("error", "arguments", "message"),
    [
        (KeyError, {"robots": ("panda", "jacko")}, "no robot 'jacko' .*mean 'jaco'"),
        (KeyError, {"heigt": 1.0}, "no option 'heigt' .*mean 'height'.*; options: "),
        (KeyError, {"robot": "panda"}, "no option 'robot' .*mean 'robots'"),
        (
            KeyError,
            {"randomization": "papr"},
            "no randomization 'papr' .*mean 'paper'.*: default, hard, lost, paper,",
        ),
        (ValueError, {"robots": ("panda",) * 3}, r"needs 2 robots, got 3 \(3 panda"),
        (KeyError, {"robots": "pandas"}, "no robot 'pandas'"),
        (ValueError, {"num_robots": 3}, r"needs 2 robots, got 3 \(3 panda"),
        (ValueError, {"num_robots": 0}, "num_robots must be at least 1"),
        (
            ValueError,
            {"num_robots": 2, "robots": ("panda", "jaco")},
            "num_robots=2 needs one kind of robot, got panda, jaco",
        ),
        (TypeError, {"robots": 3}, "sequence of names, got 3"),
        (ValueError, {"max_episode_steps": 0}, "max_episode_steps must be at least 1"),
    ],
)
def test_wrong_options_are_refused(carry_id, error, arguments, message):
    with pytest.raises(error, match=message):
        cg.make(carry_id, **arguments)
    with pytest.raises(error, match=message):
        cg.make_vec(carry_id, 1, **arguments)
    with pytest.raises(error, match=message):
        gymnasium.make_vec(carry_id, **arguments)


def test_what_others_take_is_refused_with_their_name(carry_id):
    with pytest.raises(KeyError, match=r"no option 'seed'.*; reset\(\) takes it"):
        cg.make(carry_id, seed=0)
    with pytest.raises(KeyError, match=r"option 'num_envs'.*; cg\.make_vec takes it"):
        cg.make(carry_id, num_envs=4)


def test_one_name_stands_for_all_robots(carry_id):
    for given in ({"robots": "jaco"}, {"robots": ["jaco"], "num_robots": 2}):
        robots = cg.task(carry_id, **given).robots
        assert [robot.name for robot in robots.values()] == ["jaco", "jaco"]


def test_a_tasks_name_is_no_environments_id(carry_id):
    with pytest.raises(KeyError, match=f"no environment 'Carry' .*mean '{carry_id}'"):
        get_env("Carry")


def test_make_vec_makes_a_batch(carry_id):
    envs = cg.make_vec(carry_id, 2, seed=5, num_threads=1, max_episode_steps=3)
    assert isinstance(envs, cg.VectorEnv)
    assert envs.num_envs == 2
    envs.reset()
    assert envs.progress["seed"].tolist() == [5, 5]
    assert envs.task.config.max_episode_steps == 3


def test_names_are_taken_once(carry_id):
    spec = cg.EnvSpec(carry_id, cg.Task, ("panda", "panda"))
    with pytest.raises(ValueError, match=f"'{carry_id}' is registered already"):
        cg.register_env(spec)
    with pytest.raises(ValueError, match="'Carry' is registered already"):
        cg.register_task("Carry", cg.Task)
    assert "Carry" in cg.list_tasks()
    assert carry_id in cg.list_envs()
    for wrong in ("Carry it!-v0", "Carry", "Carry-v", "Carry-v1.2"):
        with pytest.raises(ValueError, match="is not a name and a version"):
            cg.register_env(cg.EnvSpec(wrong, cg.Task, ("panda", "panda")))
        assert wrong not in cg.list_envs()


def test_arguments_after_the_second_go_by_name():
    rooms = cg, motion, objects
    things = {
        f"{room.__name__}.{name}": getattr(room, name)
        for room in rooms
        for name in room.__all__
    }
    for name, thing in things.items():
        if dataclasses.is_dataclass(thing) or not callable(thing):
            continue
        kinds = [each.kind for each in inspect.signature(thing).parameters.values()]
        assert kinds.count(inspect.Parameter.POSITIONAL_OR_KEYWORD) <= 2, name


@pytest.mark.parametrize("kind", [cg.Scene, cg.Task])
def test_arguments_after_the_second_are_named(kind):
    for name, method in inspect.getmembers(kind, inspect.isfunction):
        given = inspect.signature(method).parameters.values()
        placed = [each for each in given if each.kind is each.POSITIONAL_OR_KEYWORD]
        assert name.startswith("_") or len(placed) <= 3, name
