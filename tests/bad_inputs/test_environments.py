"""Bad inputs to environments: how they are made, reset, stepped, saved and drawn."""

import math
from dataclasses import fields, replace

import gymnasium
import numpy as np
import pytest
from judging import Case, fault, table
from values import (
    DATE,
    NO_COUNT,
    NO_NAME,
    NO_NUMBER,
    NO_NUMBERS,
    ODD,
    STRUCTURED,
    THING,
)

import collaborative_gym as cg

ENV = "LiftTaskSawyers-v0"
ONE = {"num_envs": 1, "num_threads": 1}
NO_ROBOTS = (3, 1.5, "pandas", b"panda", {}, {"panda"}, THING, [], ["panda"])
NO_ROBOTS = (*NO_ROBOTS, ["panda", 3], ["panda", "x"], ["panda"] * 3, [[], "panda"])
NO_RANDOMIZATION = (3, [], {"joint_noise": 0.1}, {}, THING, "", "papr", True, 0.0)
NO_PLACEMENTS = (3, "ab", [], {}, THING, ["a", "b"], [cg.Placement((0, 0, 0))], [1, 2])
NO_FLAG = (1, 0, "yes", [], THING, 1.0)
NO_IDS = ("0", 0.5, [0.5], [2], [-3], [0, 0], {}, {0}, THING, ["a"], [True] * 3, DATE)
BELOW, HUGE = (-1, -0.1, -1e-9), (1e300, 2**63)


def _make(shared, robots=None, env_id="Poke", **settings):
    return cg.make_vec(env_id, robots=robots, **{**ONE, **settings})


def _setting(task, name):
    return lambda shared, value: _make(shared, None, task, **{name: value})


def _randomized(name):
    return lambda shared, value: cg.Randomization(**{name: value})


MAKE = [
    *table("make", "environment", lambda s, v: cg.make(v), [*NO_NAME, None, "Lif"]),
    *table("make", "environment", lambda s, v: cg.make_vec(v, 1), ["no such", None]),
    *table("make", "robots", lambda s, v: _make(s, robots=v), NO_ROBOTS),
    *table(
        "make",
        "randomization",
        lambda s, v: _make(s, randomization=v),
        NO_RANDOMIZATION,
    ),
    *table("make", "render mode", lambda s, v: cg.make("Poke", render_mode=v), NO_NAME),
    *table(
        "make", "render mode", lambda s, v: cg.make("Poke", render_mode=v), ["human"]
    ),
    *table(
        "make", "num_envs", lambda s, v: _make(s, num_envs=v), NO_COUNT, [0, -1, 2**63]
    ),
    *table(
        "make",
        "num_threads",
        lambda s, v: _make(s, num_threads=v),
        NO_COUNT,
        [-1, 10**6, 2**63],
    ),
    *table("make", "seed", lambda s, v: _make(s, seed=v), NO_COUNT, [-1]),
    *table("make", "colour", lambda s, v: _make(s, colour=v), [1, None]),
    *table("make", "task", lambda s, v: cg.VectorEnv(v, 1), [None, "Lift", 3, THING]),
    *table(
        "make",
        "auto_reset",
        lambda s, v: cg.VectorEnv(s.task, 1, num_threads=1, auto_reset=v),
        NO_FLAG,
    ),
    *table(
        "make",
        "strain",
        lambda s, v: cg.VectorEnv(s.task, 1, num_threads=1, strain=v),
        NO_FLAG,
    ),
    *table(
        "make",
        "environment",
        lambda s, v: gymnasium.make("PokeTaskSawyers-v0", env_id=v),
        ["no such", 3],
    ),
    *table(
        "make",
        "robots",
        lambda s, v: gymnasium.make("PokeTaskSawyers-v0", robots=v),
        NO_ROBOTS[:4],
    ),
    *table(
        "make",
        "num_envs",
        lambda s, v: gymnasium.make_vec("PokeTaskSawyers-v0", num_envs=v),
        [0, -1, "two", 1.5],
    ),
]

NUMBERS = [
    ("Lift", "pot_mass", [0, 1e6]),
    ("Lift", "success_radius", []),
    ("Lift", "picking_threshold", []),
    ("Pass", "success_radius", []),
    ("Pass", "picking_threshold", []),
    ("Pass", "handover_threshold", []),
    ("Balance", "success_distance", []),
    ("Balance", "board_height", []),
    ("Balance", "push", []),
    ("BalancePath", "success_distance", [0]),
    ("BalancePath", "path_x", [2]),
    ("BalancePath", "path_y", [2]),
    ("BalancePath", "path_z", [2]),
    ("BalancePath", "lap", [0]),
    ("Hockey", "restitution", [2]),
    ("Hockey", "foul_after", [0]),
    ("Tug", "line", [0.5]),
]

SETTINGS = [
    *(
        case
        for task, name, more in NUMBERS
        for case in table(
            "settings", name, _setting(task, name), NO_NUMBER, BELOW, HUGE, more
        )
    ),
    *table(
        "settings",
        "max_episode_steps",
        _setting("Poke", "max_episode_steps"),
        NO_COUNT,
        [0, -1, 2**63],
    ),
    *table(
        "settings",
        "target",
        _setting("Lift", "target"),
        NO_NUMBERS,
        [(0, 0), (0, 0, 0, 0), (0, 0, math.nan), (0, "a", 1)],
    ),
    *table("settings", "cannot carry", _setting("Lift", "target"), [(9, 9, 9)]),
    *table("settings", "placements", _setting("Poke", "placements"), NO_PLACEMENTS),
    *table(
        "settings",
        "position",
        lambda s, v: cg.Placement(v),
        NO_NUMBERS,
        [(0, 0, math.inf)],
    ),
    *table(
        "settings", "yaw", lambda s, v: cg.Placement((0, 0, 0), v), NO_NUMBER, [90, -90]
    ),
    *(
        case
        for name in (field.name for field in fields(cg.Randomization))
        for case in table(
            "settings", name, _randomized(name), NO_NUMBER, BELOW, HUGE, [None]
        )
    ),
]


def _actions(shared, value):
    shared.env.step(value)


def _action(shared, value):
    good = {
        a: np.zeros((2, *s.shape)) for a, s in shared.env.single_action_spaces.items()
    }
    shared.env.step({**good, "robot_1": value})


def _single_action(shared, value):
    spaces = shared.single.action_spaces
    good = {agent: np.zeros(space.shape) for agent, space in spaces.items()}
    shared.single.step({**good, "robot_1": value})


NO_ACTION = (*ODD, None, True, 0.0, [], [[0.0] * 8] * 3, np.zeros((2, 3)))
NO_ACTION = (
    *NO_ACTION,
    np.zeros((2, 8), complex),
    np.zeros((2, 8), "datetime64[s]"),
    np.zeros((2, 8), "timedelta64[s]"),
    np.full((2, 8), "a"),
    np.full((2, 8), None),
    np.full((2, 8), math.nan),
    np.full((2, 8), -math.inf),
    np.zeros((2, 8), [("a", float)]),
    [[0.0] * 8, [0.0] * 7],
    np.zeros((2, 8), bool),
)

STEP = [
    *table(
        "actions", "action", _actions, ODD, [None, [], {"robot_1": np.zeros((2, 8))}]
    ),
    *table("actions", "action", _actions, [{3: 4, "robot_1": 5}, np.zeros((2, 16))]),
    *table("actions", "action", _action, NO_ACTION),
    *table(
        "actions", "action", _single_action, ODD, [None, np.zeros(3), [math.nan] * 7]
    ),
    *table("actions", "action", lambda s, v: s.single.step(v), [None, 3, [], {"x": 1}]),
    *table(
        "actions",
        "action",
        lambda s, v: s.gymnasium.step(v),
        ODD,
        [None, np.zeros(3), np.full(14, math.nan), np.full(14, "a"), {}],
    ),
    *table(
        "actions",
        "action",
        lambda s, v: s.gymnasium_vector.step(v),
        ODD,
        [None, np.zeros(14), np.full((2, 14), math.inf), np.full((2, 14), 1j)],
    ),
]

RESET = [
    *table("reset", "seed", lambda s, v: s.env.reset(seed=v), NO_COUNT, [-1]),
    *table("reset", "seed", lambda s, v: s.single.reset(seed=v), NO_COUNT[:6], [-1]),
    *table("reset", "seed", lambda s, v: s.gymnasium.reset(seed=v), NO_COUNT[:6], [-1]),
    *table(
        "reset",
        "seed",
        lambda s, v: s.gymnasium_vector.reset(seed=v),
        [-1, 1.5, "a", {}, [1], [1, "a"], [1, -2], [1, 2, 3]],
    ),
    *table(
        "reset",
        "episodes",
        lambda s, v: s.env.reset(seed=0, episodes=v),
        ODD[:1],
        ODD[4:],
        [3, [1], [1, 2, 3], [0.5, 1], [-1, 0], ["a", "b"], [None, None], [2**64, 0]],
        [np.array([DATE, DATE]), np.zeros(2, complex), [True, False], [[1, 2]]],
    ),
    *table("reset", "episodes", lambda s, v: s.env.reset(episodes=v), [[0, 1]]),
    *table("reset", "stagger", lambda s, v: s.env.reset(seed=0, stagger=v), NO_FLAG),
]


def _with_part(part, name):
    def call(shared, value):
        if name is None:
            return shared.env.set_state(replace(shared.state, **{part: value}))
        rows = {**getattr(shared.state, part), name: value}
        return shared.env.set_state(replace(shared.state, **{part: rows}))

    return call


def _restored(shared, env_ids):
    shared.env.set_state(shared.state, env_ids)


STATES = [
    *table("states", "state", lambda s, v: s.env.set_state(v), ODD, [None, 3]),
    *table(
        "states",
        "physics",
        _with_part("physics", None),
        ODD,
        [None, 3, np.zeros((2, 3)), np.zeros((3, 40)), []],
    ),
    *table("states", "progress", _with_part("progress", None), ODD, [None, {}]),
    *table("states", "memory", _with_part("memory", None), [None, 3, "a", THING]),
    *table(
        "states",
        "step",
        _with_part("progress", "step"),
        [
            [-1, 0],
            np.array([-1, 0]),
            np.zeros(3, int),
            np.full(2, math.nan),
            "ab",
            None,
        ],
        [np.full(2, "a"), np.zeros(2, complex), np.full(2, 10**6), STRUCTURED],
    ),
    *table(
        "states", "seed", _with_part("progress", "seed"), [np.array([-1, 0]), "a", None]
    ),
    *table("states", "episode", _with_part("progress", "episode"), [np.array([-9, 0])]),
    *table("states", "worlds", _restored, NO_IDS, [[0], [0, 1, 2], 5, 2**63]),
    *table("states", "world", lambda s, v: s.env.get_state(v), NO_IDS, [5, 2**63]),
]


def _nan_physics(shared, value):
    physics = shared.state.physics.copy()
    physics[1, 3] = value
    shared.env.set_state(replace(shared.state, physics=physics))


STATES += table("states", "physics", _nan_physics, [math.nan, math.inf])

DRAWING = [
    *table("render", "world", lambda s, v: s.env.render(v), NO_COUNT, [-1, 2, 2**63]),
    *table(
        "render", "width", lambda s, v: s.env.render(width=v), NO_COUNT, [0, -1, 10**6]
    ),
    *table(
        "render",
        "height",
        lambda s, v: s.env.render(height=v),
        NO_COUNT,
        [0, -1, 10**6],
    ),
    *table(
        "watch",
        "shots",
        lambda s, v: s.env.watch(print, v),
        NO_COUNT,
        [0, -1, 3, 2**63],
    ),
    *table("watch", "watcher", lambda s, v: s.env.watch(v), ["a", 3, [], {}, THING]),
    *table(
        "faces",
        "agent",
        lambda s, v: s.single.observation_space(v),
        ["robot_9", 3, None, [], THING],
    ),
    *table(
        "faces",
        "agent",
        lambda s, v: s.single.action_space(v),
        ["robot_9", 3, None, []],
    ),
]

CASES: list[Case] = [*MAKE, *SETTINGS, *STEP, *RESET, *STATES, *DRAWING]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_input_meets_a_sentence(case, shared):
    assert not fault(case, shared)
