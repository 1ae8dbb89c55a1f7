"""Runs so small that they take a fraction of a second."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import torch

import collaborative_gym as cg
from collaborative_gym.learning.config import Hyperparameters, Resources

TINY = Hyperparameters(
    total_steps=128,
    num_envs=4,
    rollout_steps=8,
    epochs=2,
    minibatch_size=16,
    entropy=0.01,
    grip_persistence=0.5,
    torque_penalty=0.1,
    range_penalty=0.1,
    contact_penalty=0.1,
    action_penalty=0.1,
    delayed=0.5,
    lost_grips=0.1,
    missed_grips=0.2,
    hidden_sizes=(16, 16),
    validation_interval=64,
    validation_episodes=4,
)
"""Four updates after 32 steps each, with a validation after every second one."""

ALONE = Resources(num_threads=1, torch_threads=1)
"""One thread, so that the same run gives the same bits."""


@pytest.fixture
def undrawn(monkeypatch):
    """Leave out the drawing of curves, most of a small run's time."""
    monkeypatch.setattr(
        "collaborative_gym.learning.monitor.draw_curve",
        lambda rows, title, path: path.write_bytes(b"a curve"),
    )
    monkeypatch.setattr(
        "collaborative_gym.learning.league.draw_ratings",
        lambda lines, title, path: path.write_bytes(b"a picture"),
    )


@pytest.fixture
def tiny():
    """Return a function that gives the small runs' hyperparameters, or others."""
    return lambda **changes: replace(TINY, **changes)


@pytest.fixture
def alone():
    """Return the resources with which a run gives the same bits again."""
    return ALONE


@pytest.fixture
def train_tiny(carry, undrawn, tmp_path):
    """Return a function that trains the small task; it may also go on."""

    def train_tiny(output=None, resume=None, seed=None, mode=None, **options):
        if output is None and resume is None:
            output = tmp_path / "run"
        options = {"hyperparameters": TINY, "resources": ALONE} | options
        task = options.pop("task", None) or carry()
        return cg.train(task, mode, seed=seed, output=output, resume=resume, **options)

    return train_tiny


@pytest.fixture(scope="session")
def _trained():
    return {}


@pytest.fixture
def trained(_trained, train_tiny, tmp_path_factory):
    """Return a function that gives a mode's finished run, which must not be changed."""

    def trained(mode):
        if mode not in _trained:
            folder = tmp_path_factory.mktemp(mode) / "run"
            _trained[mode] = train_tiny(folder, mode=mode)
        return _trained[mode]

    return trained


@pytest.fixture
def hashes():
    """Return a function that gives the hash of each file in a folder, by name."""
    return lambda folder: {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


@pytest.fixture
def same():
    """Return a function that tells whether nested values are equal to the bit."""

    def same(one, other):
        if isinstance(one, torch.Tensor):
            one, other = one.numpy(), other.numpy()
        if isinstance(one, np.ndarray):
            return one.dtype == other.dtype and one.tobytes() == other.tobytes()
        if isinstance(one, dict):
            return one.keys() == other.keys() and all(
                same(one[key], other[key]) for key in one
            )
        if isinstance(one, list | tuple):
            return len(one) == len(other) and all(map(same, one, other))
        return one == other

    return same
