"""The whole control step runs on arrays that refuse to become NumPy's."""

from collections.abc import Mapping
from dataclasses import replace

import array_api_compat.numpy as numpy_api
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.envs import world
from collaborative_gym.sim.cpu import CpuSim

ARRAYS = [
    "time",
    "qpos",
    "qvel",
    "act",
    "ctrl",
    "eq_active",
    "userdata",
    "mocap_pos",
    "xfrc_applied",
    "sensordata",
]
SCALARS = (bool, int, float)


class Strict:
    """An array of another library: numbers in a NumPy array that nobody is given.

    It takes Python's numbers and its own kind. NumPy's integers may name rows.
    """

    __array_ufunc__ = None

    def __init__(self, data):
        self._data = np.asarray(data)

    def __array__(self, *_, **__):
        raise TypeError("this array does not become NumPy's")

    def __array_namespace__(self, api_version=None):
        return XP

    shape = property(lambda self: self._data.shape)
    dtype = property(lambda self: self._data.dtype)
    ndim = property(lambda self: self._data.ndim)

    def __len__(self):
        return len(self._data)

    def __iter__(self):
        return map(Strict, self._data)

    def __bool__(self):
        return bool(self._data)

    def __int__(self):
        return int(self._data)

    def __float__(self):
        return float(self._data)

    def __getitem__(self, key):
        return Strict(self._data[bare(key)])

    def __setitem__(self, key, value):
        self._data[bare(key)] = own(value)


def bare(key):
    """Return an index without the masks and ids of this library."""
    parts = key if isinstance(key, tuple) else (key,)
    parts = tuple(each._data if isinstance(each, Strict) else each for each in parts)
    return parts if isinstance(key, tuple) else parts[0]


def own(value):
    """Return the numbers of an array of this library, of a list of them, or a number.

    Raises:
      TypeError: if it is NumPy's.
    """
    if isinstance(value, Strict):
        return value._data
    if isinstance(value, (list, tuple)):
        return type(value)(own(each) for each in value)
    if isinstance(value, np.ndarray):
        raise TypeError("a NumPy array among another library's; call asarray once")
    return value


def operator(name):
    def apply(self, other=None):
        if other is None:
            return Strict(getattr(self._data, name)())
        if not isinstance(other, (Strict, *SCALARS)):
            return NotImplemented
        return Strict(getattr(self._data, name)(own(other)))

    return apply


for each in [
    "add",
    "sub",
    "mul",
    "truediv",
    "pow",
    "floordiv",
    "mod",
    "and",
    "or",
    "xor",
]:
    for name in (f"__{each}__", f"__r{each}__"):
        setattr(Strict, name, operator(name))
for each in ["neg", "invert", "abs", "lt", "le", "gt", "ge", "eq", "ne"]:
    setattr(Strict, f"__{each}__", operator(f"__{each}__"))


class Namespace:
    """The array API's functions, for arrays of this library alone."""

    def __getattr__(self, name):
        found = getattr(numpy_api, name)
        if isinstance(found, type) or not callable(found):
            return found

        def apply(*values, **options):
            if name != "asarray":
                values = own(values)
            elif isinstance(values[0], Strict):
                values = (values[0]._data,)
            result = found(*values, **options)
            many = isinstance(result, tuple)
            return tuple(map(Strict, result)) if many else Strict(result)

        return apply


XP = Namespace()


class StrictSim(CpuSim):
    """The CPU's worlds as a library of its own would show them."""

    def __init__(self, *args):
        super().__init__(*args)
        self.xp = XP
        for name in ARRAYS:
            setattr(self, name, Strict(getattr(self, name)))
        names = "strays", "too_deep", "too_fast", "stop"
        rules = {name: self._ruled(getattr(self.refinement, name)) for name in names}
        self.refinement = replace(self.refinement, **rules)

    def _ruled(self, rule):
        return lambda *found: own(rule(*map(Strict, found)))

    def step(self, controls, records=None, breaks=None, env_ids=None):
        judge = breaks and self._ruled(breaks)
        controls = np.ascontiguousarray(own(controls))
        super().step(controls, records, judge, env_ids)

    def forward(self, env_ids=None):
        super().forward(bare(env_ids))

    def reset(self, env_ids=None):
        super().reset(bare(env_ids))

    def get_state(self, env_ids=None):
        return Strict(super().get_state(bare(env_ids)))

    def set_state(self, state, env_ids=None):
        super().set_state(own(state), bare(env_ids))

    def expand(self, name):
        return Strict(super().expand(name))

    def pose(self, name):
        return tuple(map(Strict, super().pose(name)))

    def velocity(self, name):
        return tuple(map(Strict, super().velocity(name)))


@pytest.mark.parametrize(
    "mix",
    [
        np.asarray,
        lambda array: np.ones(3) + array,
        lambda array: array < np.ones(3),
        lambda array: XP.stack([array, np.ones(3)]),
        lambda array: array.__setitem__(0, np.ones(1)),
    ],
)
def test_an_array_of_another_library_refuses_numpy(mix):
    with pytest.raises(TypeError):
        mix(Strict(np.ones(3)))


def plain(value):
    """Return nested results with NumPy's arrays in them."""
    if isinstance(value, Mapping):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, tuple):
        return tuple(map(plain, value))
    return value._data if isinstance(value, Strict) else value


@pytest.mark.parametrize(
    ("env_id", "action"),
    [
        *((env_id, "joints") for env_id in cg.list_envs()),
        *(("LiftTaskJacos-v0", mode) for mode in ("tcp", "torques", "impedance")),
    ],
)
def test_a_step_runs_on_other_arrays_to_the_same_bits(env_id, action, monkeypatch):
    options = {"num_threads": 1, "max_episode_steps": 4, "action": action}
    usual = cg.make_vec(env_id, num_envs=3, **options)
    monkeypatch.setattr(world, "CpuSim", StrictSim)
    other = cg.make_vec(env_id, num_envs=3, **options)
    expected, seen = [usual.reset(seed=0)], [other.reset(seed=0)]
    for step in range(6):
        actions = usual.expert()
        if step == 4:
            actions = usual.idle()
        expected.append(usual.step(actions))
        given = {agent: XP.asarray(rows) for agent, rows in actions.items()}
        seen.append(other.step(given))
    for one, another in zip(expected, seen, strict=True):
        np.testing.assert_equal(plain(another), plain(one))
