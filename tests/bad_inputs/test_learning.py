"""Bad inputs to what plays, measures, films and learns."""

from dataclasses import fields

import numpy as np
import pytest
from judging import Case, accepted, fault, table
from values import NO_COUNT, NO_NAME, NO_NUMBER, NO_NUMBERS, NO_PATH, THING

import collaborative_gym as cg
from collaborative_gym.certificate.budget import QUICK
from collaborative_gym.evaluation.speed import benchmark
from collaborative_gym.evaluation.table11 import reproduce_table11
from collaborative_gym.learning.config import Hyperparameters, Resources
from collaborative_gym.pictures.recording import record

ENV = "PokeTaskSawyers-v0"
NO_ROBOTS = (3, "panda", {"panda"}, THING, [], ["panda"], ["panda", "x"])
NO_RANDOMIZATION = (3, [], {}, THING, "", "papr", True)
NO_CALLBACK = (3, "print", [], THING)
NO_FLAG = (1, 0, "yes", [], THING)
NO_GUESTS = (
    3,
    THING,
    "",
    [""],
    [3],
    ["idle", "idle"],
    {"robot_9": "idle"},
    {"robot_1": 3},
    {3: "idle"},
    "idel",
    "robot_9=idle",
    "nowhere.safetensors",
    ".",
    "\0",
    "LiftTaskSawyers-v0",
)
TINY = {
    "total_steps": 32,
    "num_envs": 2,
    "rollout_steps": 4,
    "minibatch_size": 4,
    "epochs": 1,
    "hidden_sizes": (4,),
    "validation_interval": 0,
    "validation_episodes": 1,
}


def _load(shared, value):
    cg.load_policy(value, shared.single)


def _file(content):
    """Return a call that loads a policy file with this content."""

    def call(shared, name):
        path = shared.folder / name
        path.write_bytes(content)
        cg.load_policy(path, shared.single)

    return call


def _player(shared, name):
    """Load a player of a league without a main policy, whose only file is damaged."""
    players = shared.folder / "league" / "players"
    players.mkdir(parents=True, exist_ok=True)
    (players / "main-1.safetensors").write_bytes(b"x" * 99)
    cg.load_policy(shared.folder / "league" / name, shared.single)


LOAD = [
    *table("policies", "league", _player, ["main-1", "main-9", "", "a/b", "players"]),
    *table("policies", "policy", _load, NO_NAME, [None]),
    *table("policies", "policy", _load, ["nowhere.safetensors", "a/b", ".", "/", "\0"]),
    *table(
        "policies", "env", lambda s, v: cg.load_policy("expert", v), [None, 3, "Lift"]
    ),
    *table(
        "policies", "env", lambda s, v: cg.load_policy("random", v), [THING, [], {}]
    ),
    *table("policies", "broken", _file(b""), ["broken_1.safetensors"]),
    *table("policies", "broken", _file(b"x" * 99), ["broken_2.safetensors"]),
    *table(
        "policies",
        "broken",
        _file(b"\x02\0\0\0\0\0\0\0{}"),
        ["broken_3.safetensors"],
    ),
    *table("policies", "policy file", _file(b"x"), ["last.pt", "mine.onnx", "mine"]),
    *table("policies", "sizes", _load, ["LiftTaskSawyers-v0"]),
]


def _evaluate(name):
    def call(shared, value):
        given = {"env": "Poke", "policy": "random", "episodes": 1, "num_threads": 1}
        cg.evaluate(**{**given, "on_progress": accepted, name: value})

    return call


def _tournament(name):
    def call(shared, value):
        given = {"env": "Poke", "policies": ["idle", "random"], "episodes": 1}
        given |= {"num_threads": 1, "on_progress": accepted}
        cg.tournament(**{**given, name: value})

    return call


def _report_card(name):
    def call(shared, value):
        given = {"env": "Poke", "policies": ["idle"], "episodes": 1, "disturbed": 0}
        given |= {"num_threads": 1, "on_progress": accepted}
        cg.report_card(**{**given, name: value})

    return call


def _certify(name):
    def call(shared, value):
        given = {"env": "Poke", "budget": QUICK, "num_threads": 1}
        cg.certify(**{**given, "on_progress": accepted, name: value})

    return call


def _budget(name):
    return lambda shared, value: cg.Budget(**{name: value})


def _played(shared, value):
    """Play a policy that returns the value."""
    cg.evaluate("Poke", policy=lambda observations: value, episodes=1, num_threads=1)


def _one_action(shared, value):
    good = {agent: np.zeros((1, 7)) for agent in ("robot_1", "robot_2")}
    _played(shared, {**good, "robot_2": value})


EVALUATE = [
    *table("evaluate", "environment", _evaluate("env"), NO_NAME, [None]),
    *table("evaluate", "policy", _evaluate("policy"), NO_NAME, [None]),
    *table("evaluate", "episodes", _evaluate("episodes"), NO_COUNT, [0, -1, None]),
    *table("evaluate", "seed", _evaluate("seed"), NO_COUNT, [-1, None]),
    *table("evaluate", "delay", _evaluate("delay"), NO_COUNT, [-1, 101, None]),
    *table("evaluate", "num_envs", _evaluate("num_envs"), NO_COUNT, [0, -1, 2**63]),
    *table("evaluate", "num_threads", _evaluate("num_threads"), NO_COUNT, [-1, 2**63]),
    *table(
        "evaluate",
        "policy",
        lambda shared, value: _evaluate("policy")(shared, {"robot_1": value}),
        NO_NAME,
        ["idle"],
    ),
    *table(
        "evaluate", "agent", _evaluate("policy"), [{}, {"robot_9": "idle"}, {3: "idle"}]
    ),
    *table("card", "environment", _report_card("env"), NO_NAME, [None]),
    *table("card", "policies", _report_card("policies"), [3, THING, [], "idle", None]),
    *table("card", "policy", lambda s, v: _report_card("policies")(s, [v]), NO_NAME),
    *table("card", "episodes", _report_card("episodes"), NO_COUNT, [0, -1, None]),
    *table("card", "disturbed", _report_card("disturbed"), NO_COUNT, [-1, None]),
    *table("card", "paired", _report_card("paired"), NO_COUNT, [-1, None]),
    *table("card", "seed", _report_card("seed"), NO_COUNT, [-1, None]),
    *table("card", "num_envs", _report_card("num_envs"), NO_COUNT, [0, 2**63]),
    *table("card", "on_progress", _report_card("on_progress"), NO_CALLBACK),
    *table("tournament", "environment", _tournament("env"), NO_NAME, [None]),
    *table(
        "tournament",
        "policies",
        _tournament("policies"),
        [None, 3, THING, "idle", [], {}, ["idle"], {"a": "idle"}, ["idle", "idle"]],
    ),
    *table(
        "tournament",
        "policy",
        lambda shared, value: _tournament("policies")(shared, ["idle", value]),
        NO_NAME,
        [None, "a/b", {"robot_1": "idle"}, ENV.replace("Poke", "Lift")],
    ),
    *table("tournament", "episodes", _tournament("episodes"), NO_COUNT, [0, -1, None]),
    *table("tournament", "seed", _tournament("seed"), NO_COUNT, [-1, None]),
    *table("tournament", "seat", _tournament("seats"), NO_NAME, [(), ["robot_9"]]),
    *table("tournament", "groups", _tournament("groups"), [3, "idle", THING]),
    *table("tournament", "groups", _tournament("groups"), [{"a": v} for v in NO_NAME]),
    *table("tournament", "num_envs", _tournament("num_envs"), NO_COUNT, [0, 2**63]),
    *table("tournament", "num_threads", _tournament("num_threads"), NO_COUNT, [-1]),
    *table("tournament", "any_env", _tournament("any_env"), [3, "yes", None]),
    *table("tournament", "output", _tournament("output"), NO_PATH),
    *table("tournament", "on_pairing", _tournament("on_pairing"), NO_CALLBACK),
    *table("tournament", "on_progress", _tournament("on_progress"), NO_CALLBACK),
    *table("certify", "environment", _certify("env"), NO_NAME, [None]),
    *table("certify", "budget", _certify("budget"), [3, "quick", {}, THING]),
    *table("certify", "seed", _certify("seed"), NO_COUNT, [-1, None, 2**41]),
    *table("certify", "num_threads", _certify("num_threads"), NO_COUNT, [-1, 2**63]),
    *table("certify", "output", _certify("output"), NO_PATH),
    *table("certify", "on_trial", _certify("on_trial"), NO_CALLBACK),
    *table("certify", "on_progress", _certify("on_progress"), NO_CALLBACK),
    *table("Budget", "episodes", _budget("episodes"), NO_COUNT, [0, -1, None]),
    *table("Budget", "ppo_steps", _budget("ppo_steps"), NO_COUNT, [-1, None]),
    *table("Budget", "fractions", _budget("fractions"), NO_NUMBERS, [(0,), (1, 2)]),
    *table("evaluate", "on_progress", _evaluate("on_progress"), NO_CALLBACK),
    *table(
        "table11",
        "on_progress",
        lambda s, v: reproduce_table11(1, env_ids=[ENV], on_progress=v),
        NO_CALLBACK,
    ),
    *table(
        "table11",
        "environment",
        lambda s, v: reproduce_table11(1, env_ids=[v]),
        [3, "Lift"],
    ),
    *table(
        "benchmark",
        "on_progress",
        lambda s, v: benchmark([ENV], 1, on_progress=v),
        NO_CALLBACK,
    ),
    *table(
        "benchmark", "num_envs", lambda s, v: benchmark([ENV], v), NO_COUNT, [0, -1]
    ),
    *table(
        "returned", "action", _played, [None, 3, "a", [], {}, THING, np.zeros((2, 7))]
    ),
    *table("returned", "action", _played, [{"robot_1": np.zeros((1, 7))}, {3: 4}]),
    *table(
        "returned",
        "action",
        _one_action,
        [
            None,
            "a",
            [],
            {},
            THING,
            np.zeros(7),
            np.zeros((1, 8)),
            np.full((1, 7), np.nan),
        ],
        [np.full((1, 7), 1j), np.full((1, 7), "a"), np.full((1, 7), None)],
        [np.zeros((1, 7), "datetime64[s]"), np.zeros((1, 7), [("a", float)])],
    ),
]


def _record(name):
    def call(shared, value):
        output = shared.folder / "film.gif"
        given = {"env": "Poke", "output": output, "policy": "random", "size": (64, 48)}
        record(**{**given, "on_progress": accepted, name: value})

    return call


RECORD = [
    *table("record", "environment", _record("env"), [None, 3, "Lif", [], THING]),
    *table("record", "output", _record("output"), [None, 3, [], THING, True, 1.5]),
    *table("record", "format", _record("output"), ["", ".", "film", "film.avi", "gif"]),
    *table(
        "record", "film", _record("output"), ["/dev/null/film.gif", "/proc/film.gif"]
    ),
    *table("record", "policy", _record("policy"), [None, 3, [], "no such", [3], ["x"]]),
    *table("record", "seconds", _record("seconds"), NO_NUMBER, [0, -1]),
    *table("record", "seed", _record("seed"), NO_COUNT, [-1]),
    *table(
        "record",
        "episodes",
        _record("only_episodes"),
        [3, "", [], [-1], [1.5], ["a"], [None], [[1]], [True], THING],
    ),
    *table(
        "record",
        "width",
        _record("size"),
        [
            (0, 0),
            (-2, 4),
            (3, 4),
            (10**6, 2),
            (64.0, 48),
            ("64", 48),
            (True, 2),
        ],
    ),
    *table("record", "height", _record("size"), [(64, None), (64, 0), (64, 3)]),
    *table(
        "record",
        "size",
        _record("size"),
        [3, "64x48", "64", (64,), (64, 48, 3), {}, THING],
    ),
    *table("record", "on_progress", _record("on_progress"), NO_CALLBACK),
]


def _hyper(name):
    return lambda shared, value: Hyperparameters(**{**TINY, name: value})


def _resource(name):
    return lambda shared, value: Resources(**{name: value})


COUNTS = {field.name for field in fields(Hyperparameters) if type(field.default) is int}
NUMBERS = [
    field.name for field in fields(Hyperparameters) if type(field.default) is float
]

LEARN = [
    *(
        case
        for name in sorted(COUNTS)
        for case in table("hyperparameters", name, _hyper(name), NO_COUNT, [-1, 2**63])
    ),
    *(
        case
        for name in NUMBERS
        for case in table("hyperparameters", name, _hyper(name), NO_NUMBER, [-1, 1e300])
    ),
    *table(
        "hyperparameters",
        "hidden_sizes",
        _hyper("hidden_sizes"),
        [3, "256", None, [0], [-1], [1.5], ["a"], {}, THING, [True], [2**63]],
    ),
    *table("hyperparameters", "activation", _hyper("activation"), NO_NAME, [None]),
    *table("resources", "device", _resource("device"), NO_NAME[:8], [None]),
    *(
        case
        for name in ("num_threads", "torch_threads")
        for case in table("resources", name, _resource(name), NO_COUNT, [-1, 10**6])
    ),
]


def _many(shared, value):
    cg.train_all(ENV, output=shared.folder / "many", changes=value, on_row=accepted)


LEARN += [
    *table("many", "changes", _many, [3, "fast", [1], THING]),
    *table("many", "hyperparameter", _many, [{"typo": 1}, {3: 1}]),
    *table("many", "epochs", _many, [{"epochs": "two"}, {"epochs": 0}]),
]


def _train(name):
    def call(shared, value):
        given = {"env": "Poke", "output": shared.folder / "run", "on_row": accepted}
        given["hyperparameters"] = Hyperparameters(**TINY)
        cg.train(**{**given, name: value})

    return call


def _resumed(shared, value):
    cg.train("Poke", resume=value, on_row=accepted)


TRAIN = [
    *table("train", "environment", _train("env"), [None, 3, "Lif", [], THING]),
    *table("train", "mode", _train("mode"), [3, "", "sharde", [], THING, True]),
    *table("train", "seed", _train("seed"), NO_COUNT, [-1]),
    *table("train", "output", _train("output"), NO_PATH, ["", "\0"]),
    *table("train", "partner", _train("partner"), NO_GUESTS),
    *table(
        "train",
        "population",
        _train("partner"),
        ["population", ["population"] * 2, ["population", "idle"]],
    ),
    *table(
        "train",
        "seat",
        _train("partner"),
        [{"robot_1": "idle", "robot_2": "idle"}, ["idle", "robot_1=idle"]],
    ),
    *table(
        "train", "opponent", _train("opponent"), NO_GUESTS, ["self", "league", "idle"]
    ),
    *table(
        "train", "hyperparameters", _train("hyperparameters"), [3, "fast", {}, THING]
    ),
    *table("train", "backend", _train("backend"), [3, "", "sb3", [], THING, True]),
    *table("train", "algorithm", _train("algorithm"), [3, "", "td3", [], THING, True]),
    *table("train", "resources", _train("resources"), [3, "cpu", {}, THING]),
    *table(
        "train", "checkpoint_interval", _train("checkpoint_interval"), NO_COUNT, [0, -1]
    ),
    *table("train", "on_row", _train("on_row"), NO_CALLBACK),
    *table("train", "progress", _train("progress"), NO_FLAG),
    *table("train", "resume", _resumed, NO_PATH, ["", "nowhere", "\0"]),
    *table("train", "resume", _train("resume"), ["nowhere"]),
]

CASES: list[Case] = [*LOAD, *EVALUATE, *RECORD, *LEARN, *TRAIN]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_bad_input_meets_a_sentence(case, shared):
    assert not fault(case, shared)
