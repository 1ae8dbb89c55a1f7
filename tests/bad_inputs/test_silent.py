"""Bad inputs that did nothing, or something else than was asked for."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import control
from collaborative_gym.certificate.budget import Budget
from collaborative_gym.pictures.recording import record
from collaborative_gym.policies import as_policy
from collaborative_gym.tournaments.play import enter


def with_nan(state):
    memory = dict(state.memory)
    name = next(n for n, array in memory.items() if array.dtype.kind == "f")
    return replace(state, memory=memory | {name: np.full_like(memory[name], np.nan)})


@pytest.fixture(scope="module")
def env():
    with closing(cg.make_vec("BalancePath", 2, num_threads=1)) as env:
        env.reset(seed=0)
        yield env


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda env: as_policy("idle", env, any_env="x"), TypeError, "any_env must be"),
        (
            lambda env: env.set_state(env.get_state(), from_another="x"),
            TypeError,
            "from_another must be True or False",
        ),
        (
            lambda env: env.set_state(with_nan(env.get_state())),
            ValueError,
            "memory .* is not finite",
        ),
        (lambda env: env.idle("x"), TypeError, "grips must be True or False"),
        (lambda env: env.idle({"robot_1": "x"}), TypeError, "grips must be True or"),
        (lambda env: env.expert(pace=-1), ValueError, "pace must be 0 to 1"),
        (lambda env: env.expert(pace=np.nan), ValueError, "pace must be finite"),
        (lambda env: cg.Motion(3), TypeError, "change must be an array"),
        (
            lambda env: cg.Motion(np.zeros((2, 7)), mass=-1.0),
            ValueError,
            "mass must be",
        ),
        (lambda env: cg.Motion(np.zeros((2, 7)), mass="x"), ValueError, "mass must be"),
        (
            lambda env: control.register_mode("x", 3),
            TypeError,
            "subclass of ActionMode",
        ),
        (lambda env: cg.evaluate(env, "idle"), TypeError, "give env.task"),
        (lambda env: cg.Placement((0, 0, 1e300)), ValueError, r"position\[2\] must be"),
        (lambda env: record("Poke", "a\0.gif"), ValueError, "output must be a path"),
        (lambda env: Budget(fractions=()), ValueError, "fractions must have a share"),
        (
            lambda env: cg.make_vec("Lift", 1, success_tilt=10.0),
            ValueError,
            "success_tilt must be",
        ),
        (
            lambda env: enter({"x" * 3000: "idle", "b": "idle"}, env),
            ValueError,
            "1 to 200 letters",
        ),
    ],
    ids=lambda given: given if isinstance(given, str) else "",
)
def test_what_was_silent_is_refused(env, call, error, message):
    with pytest.raises(error, match=message):
        call(env)
