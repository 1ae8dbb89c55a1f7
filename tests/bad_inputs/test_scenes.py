"""Bad inputs to what a user builds: scenes, objects, arms, tasks and ids."""

import math
from dataclasses import replace

import pytest
from judging import Case, fault, table
from values import NO_NAME, NO_NUMBER, NO_NUMBERS, NO_PATH, THING

import collaborative_gym as cg
from collaborative_gym import objects

PANDA = cg.get_robot("panda")
HOME = cg.Placement((0.0, 0.0, 0.65))
BELOW, HUGE = (-1, -1e-9), (1e300, 10**400)


def _scene():
    scene = cg.Scene()
    scene.add_robot("robot_1", PANDA, placement=HOME)
    scene.add("cube", objects.cube())
    return scene


def _in_scene(method, argument, /, *first, **rest):
    """Return a call of a scene's method with a bad value for one argument."""

    def call(shared, value):
        shared.scene.__getattribute__(method)(*first, **{**rest, argument: value})

    return call


def _attached():
    """Return an object that is in a scene."""
    child = objects.cube()
    cg.Scene().add("cube", child)
    return child


GRIP = {"agent": "robot_1", "site": "cube/centre", "threshold": 0.1, "width": 0.04}
TARGET = {"name": "goal", "radius": 0.1}
ADD = {"name": "box", "child": None}


def _added(name):
    def call(shared, value):
        child = objects.cube()
        _scene().add(**{"name": "box", "child": child, name: value})

    return call


def _robot_added(name):
    def call(shared, value):
        given = {"agent": "robot_2", "robot": PANDA, "placement": HOME, name: value}
        _scene().add_robot(**given)

    return call


SCENE = [
    *table("scene", "robot", _robot_added("robot"), [None, "panda", 3, THING]),
    *table("scene", "placement", _robot_added("placement"), [None, (0, 0, 0), 3]),
    *table("scene", "agent", _robot_added("agent"), [None, 3, "", [], "robot_1"]),
    *table("scene", "holds", _robot_added("holds"), NO_NUMBER[:6], [-1]),
    *table("scene", "stand", _robot_added("stand"), ["yes", 1, THING]),
    *table("scene", "name", _added("name"), [None, 3, "", [], "cube"]),
    *table("scene", "child", _added("child"), [None, 3, "cube", THING, _attached()]),
    *table("scene", "position", _added("position"), NO_NUMBERS, [(0, 0, math.nan)]),
    *table("scene", "quat", _added("quat"), NO_NUMBERS, [(1, 0, 0, math.inf)]),
    *table("scene", "name", _in_scene("add_target", "name", radius=0.1), [None, 3, ""]),
    *table(
        "scene",
        "radius",
        _in_scene("add_target", "radius", name="goal"),
        NO_NUMBER,
        BELOW,
        [0],
    ),
    *table(
        "scene", "arm", _in_scene("add_grip", "agent", **GRIP), ["robot_9", None, 3]
    ),
    *table("scene", "site", _in_scene("add_grip", "site", **GRIP), ["cube", None, 3]),
    *table(
        "scene",
        "threshold",
        _in_scene("add_grip", "threshold", **GRIP),
        NO_NUMBER,
        BELOW,
        [30.0],
    ),
    *table(
        "scene",
        "width",
        _in_scene("add_grip", "width", **GRIP),
        NO_NUMBER,
        BELOW,
        [40.0],
    ),
    *table(
        "scene", "site", _in_scene("add_weld", "site", other="cube/centre"), ["x", 3]
    ),
    *table(
        "scene", "site", _in_scene("add_weld", "other", site="cube/centre"), ["x", 3]
    ),
    *table("scene", "site", _in_scene("add_pose_sensor", "site", "a"), ["x", None]),
    *table("scene", "site", _in_scene("add_velocity_sensor", "site", "a"), ["x", None]),
    *table(
        "scene",
        "arm",
        lambda s, v: s.scene.add_tool(v, "stick", child=objects.stick()),
        ["robot_9", None, 3],
    ),
    *table(
        "scene",
        "child",
        lambda s, v: s.scene.add_tool("robot_1", "t", child=v),
        [None, "a", _attached()],
    ),
    *table(
        "scene",
        "movable object",
        lambda s, v: s.env.scene.place(s.env.sim, [0], name=v, position=(0, 0, 1)),
        ["no such", None, 3],
    ),
    *table(
        "scene",
        "position",
        lambda s, v: s.env.scene.place(s.env.sim, [0], name="pot", position=v),
        ["a", (0, 0), THING],
    ),
    *table(
        "scene", "grip", lambda s, v: s.env.scene.holds(s.env.sim, v), ["robot_9", None]
    ),
    *table("scene", "pose", lambda s, v: s.env.sim.pose(v), ["no such", None, 3]),
    *table("scene", "velocity", lambda s, v: s.env.sim.velocity(v), ["no such", None]),
]

SIZES = [
    (objects.ball, "mass"),
    (objects.board, "mass"),
    (objects.board, "marked_radius"),
    (objects.cube, "size"),
    (objects.cube, "mass"),
    (objects.pot, "mass"),
    (objects.pot, "balance"),
    (objects.table, "length"),
    (objects.table, "width"),
    (objects.table, "height"),
    (objects.pedestal, "height"),
]


def _object(make, name):
    mass = {"mass": 1.0} if make is objects.pot else {}
    return lambda shared, value: make(**{**mass, name: value})


OBJECTS = [
    case
    for make, name in SIZES
    for case in table(
        "objects", name, _object(make, name), NO_NUMBER, (-1, 1e300), ("", None)
    )
]


def _arm(name):
    return lambda shared, value: replace(PANDA, **{name: value})


def _fingers(name):
    return lambda shared, value: replace(PANDA.gripper, **{name: value})


NO_JOINTS = (150, "150", b"1", [1.0], ["a"] * 7, {}, THING, None, [math.nan] * 7, 0.0)
NO_JOINT_NAMES = (3, "joint1", b"x", {}, THING, None, [3] * 7, ["joint1"] * 7, ["x"])

ROBOTS = [
    *table("robots", "name", _arm("name"), NO_NAME[:9]),
    *table("robots", "model_file", _arm("model_file"), NO_PATH, ["nowhere.xml", None]),
    *table("robots", "joints", _arm("joints"), NO_JOINT_NAMES),
    *table("robots", "payload", _arm("payload"), NO_NUMBER, [0, -1, None]),
    *table("robots", "reach", _arm("reach"), NO_NUMBER, [0, -1, None]),
    *table("robots", "gripper", _arm("gripper"), [None, 3, "hand", {}, THING]),
    *table("robots", "title", _arm("title"), [3, [], THING]),
    *table("robots", "stand", _arm("stand"), NO_NAME),
    *table("robots", "tcp", _arm("tcp"), NO_NAME[:10]),
    *(
        case
        for name in ("home", "velocity_limits", "torque_limits", "armature", "damping")
        for case in table("robots", name, _arm(name), NO_JOINTS)
    ),
    *table("robots", "home", _arm("home"), [[9.0] * 7]),
    *table("robots", "torque_limits", _arm("torque_limits"), [[-1.0] * 7, [0.0] * 7]),
    *table("robots", "stiffness", _arm("stiffness"), NO_JOINTS, [[-1.0] * 7]),
    *table(
        "gripper", "joints", _fingers("joints"), [3, "finger", b"x", None, [3], THING]
    ),
    *(
        case
        for name in (
            "open_position",
            "closed_position",
            "open_gap",
            "closed_gap",
            "force",
        )
        for case in table("gripper", name, _fingers(name), NO_NUMBER, [None])
    ),
    *table("gripper", "force", _fingers("force"), [0, -1]),
    *table("gripper", "holding_force", _fingers("holding_force"), [-1]),
    *table("gripper", "closed_gap", _fingers("closed_gap"), [-1, 10.0]),
    *table("gripper", "gap", lambda s, v: PANDA.gripper.position(v), NO_NUMBER),
    *table("robots", "robot", lambda s, v: cg.get_robot(v), NO_NAME, [None]),
    *table(
        "robots", "robot", lambda s, v: cg.register_robot(v), [None, "panda", 3, PANDA]
    ),
]


def _spec(name):
    good = {"env_id": "New-v0", "task": cg.Task, "robots": ("panda", "panda")}
    return lambda shared, value: cg.register_env(cg.EnvSpec(**{**good, name: value}))


REGISTRY = [
    *table("register", "environment", lambda s, v: cg.register_env(v), [None, "a", 3]),
    *table(
        "register", "id", _spec("env_id"), [None, 3, "", "New", "New-v", b"New-v0", []]
    ),
    *table("register", "registered", _spec("env_id"), ["LiftTaskSawyers-v0"]),
    *table("register", "task", _spec("task"), [None, "Lift", 3, THING, dict]),
    *table(
        "register", "robots", _spec("robots"), [None, "panda", 3, {"panda"}, [3, 4]]
    ),
    *table("register", "settings", _spec("settings"), [None, 3, "a", [1]]),
    *table(
        "register",
        "name",
        lambda s, v: cg.register_task(v, cg.Task),
        [None, 3, "", "New task", [], b"New"],
    ),
    *table(
        "register", "registered", lambda s, v: cg.register_task(v, cg.Task), ["Lift"]
    ),
    *table(
        "register",
        "task",
        lambda s, v: cg.register_task("New", v),
        [None, "Lift", 3, THING, dict],
    ),
]

BROKEN = {
    "syntax": "def f(:\n",
    "missing": "import no_such_module\n",
    "raising": "1 / 0\n",
    "tabs": "if True:\n\tx = 1\n        y = 2\n",
    "null": "x = 1\0\n",
    "latin": b"x = '\xff\xfe'\n",
    "named": "raise KeyError('colour')\n",
}


def _module(shared, value):
    path = shared.folder / f"broken_{value}.py"
    text = BROKEN[value]
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    cg.load_module(str(path))


MODULES = [
    *table("modules", "broken_", _module, ["syntax", "tabs", "null", "latin"]),
    *table(
        "modules",
        "module",
        lambda s, v: cg.load_module(v),
        [
            None,
            3,
            [],
            THING,
            b"a.py",
            "",
            ".",
            "..",
            "nowhere.py",
            "no.such",
            "a b",
            ".py",
        ],
    ),
    *table(
        "modules", "module", lambda s, v: cg.load_module(v), ["numpy.py", "/", "a/b"]
    ),
]

CASES: list[Case] = [*SCENE, *OBJECTS, *ROBOTS, *REGISTRY, *MODULES]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_input_meets_a_sentence(case, shared):
    assert not fault(case, shared)


def test_an_object_that_there_is_not_meets_those_that_are():
    with pytest.raises(AttributeError, match=r"^no object 'bal' .*'ball'.*; objects: "):
        _ = objects.bal
    assert not hasattr(objects, "wall")
