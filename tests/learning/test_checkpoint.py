import hashlib
import json
import os
import pickle
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch

from collaborative_gym.blocks import Layout
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.folder import BEST, LAST
from collaborative_gym.learning.settings import Settings
from collaborative_gym.tasks.identity import Identity

FILL_THE_DISK = """
import resource, signal, sys, torch
from dataclasses import replace
from pathlib import Path
from collaborative_gym.learning.checkpoint import Checkpoint

path = Path(sys.argv[1])
checkpoint = Checkpoint.load(path)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
large = {**checkpoint.backend, "more": torch.rand(1_000_000)}
try:
    replace(checkpoint, backend=large).save(path)
except OSError as error:
    print(error)
"""


@pytest.fixture
def settings(carry, tiny):
    """Return what a run may be started with."""
    sizes = {"robot_1": 3, "robot_2": 2}
    return Settings(
        identity=Identity.of(carry()),
        mode="independent",
        seed=3,
        backend="skrl",
        layout=Layout.of_sizes(sizes, sizes),
        hyperparameters=tiny(hidden_sizes=(8, 4)),
    )


@pytest.fixture
def saved(settings, tmp_path):
    """Return a small checkpoint's path."""
    state = {"steps": 2**40, "weights": torch.arange(3.0), "none": []}
    rows = [{"steps": 32, "return": 0.1}]
    path = tmp_path / "run" / LAST
    Checkpoint(settings, state, rows, {"steps": 32}, 1.5).save(path)
    return path


def test_a_checkpoint_comes_back_whole(saved, settings, same):
    loaded = Checkpoint.load(saved)
    assert loaded.settings == settings
    assert isinstance(loaded.settings.hyperparameters.hidden_sizes, tuple)
    state = {"steps": 2**40, "weights": torch.arange(3.0), "none": []}
    assert same(loaded.backend, state)
    assert loaded.rows == [{"steps": 32, "return": 0.1}]
    assert (loaded.best, loaded.seconds) == ({"steps": 32}, 1.5)
    assert [entry.name for entry in saved.parent.iterdir()] == [LAST]


def test_settings_are_plain(settings):
    plain = json.loads(json.dumps(settings.to_dict()))
    assert Settings.from_dict(plain) == settings


class Bomb:
    def __reduce__(self):
        return Path.touch, (Path("ran"),)


def rewritten(path, change):
    """Write a checkpoint whose content was changed, with a digest of its own."""
    whole = path.read_bytes()
    start = whole.index(b"\n") + 1
    content = torch.load(BytesIO(whole[start + 32 :]), weights_only=True)
    change(content)
    rest = BytesIO()
    torch.save(content, rest)
    digest = hashlib.sha256(rest.getvalue()).digest()
    path.write_bytes(whole[:start] + digest + rest.getvalue())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.write_bytes(b""), "no checkpoint of this version"),
        (lambda path: path.write_text("steps,return\n"), "of this version, or damaged"),
        (lambda path: torch.save({"step": 3}, path), "of this version, or damaged"),
        (lambda path: path.write_bytes(pickle.dumps(Bomb())), "of this version"),
        (
            lambda path: rewritten(path, lambda all: all.update(rows=Bomb())),
            "version (",
        ),
        (lambda path: rewritten(path, lambda all: all.pop("best")), "'best'"),
        (
            lambda path: rewritten(
                path, lambda all: all["settings"]["hyperparameters"].update(warmth=1.0)
            ),
            "'warmth'",
        ),
    ],
)
def test_another_file_is_refused_and_runs_no_code(
    saved, spoil, message, tmp_path, monkeypatch, hashes
):
    monkeypatch.chdir(tmp_path)
    spoil(saved)
    before = hashes(tmp_path)
    with pytest.raises(ValueError, match=rf"{LAST} is no checkpoint") as error:
        Checkpoint.load(saved)
    assert message in str(error.value) and "\n" not in str(error.value)
    assert hashes(tmp_path) == before


def test_no_bit_can_flip_unseen(saved):
    whole = saved.read_bytes()
    rng = np.random.default_rng(0)
    places = [*range(64), *rng.integers(64, len(whole), 300), len(whole) - 1]
    for place in places:
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        saved.write_bytes(damaged)
        with pytest.raises(ValueError, match=f"{saved} is .*damaged.* copy {BEST}"):
            Checkpoint.load(saved)
    for length in (0, 1, 40, 62, 700, len(whole) - 100, len(whole) - 1):
        saved.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=f"{saved} is .*damaged"):
            Checkpoint.load(saved)
    saved.write_bytes(whole)
    Checkpoint.load(saved)


def test_a_missing_file_is_named(tmp_path):
    for path in (tmp_path / LAST, tmp_path):
        with pytest.raises(FileNotFoundError, match=f"no checkpoint {path}"):
            Checkpoint.load(path)


def test_a_full_disk_leaves_the_earlier_checkpoint(saved, hashes):
    before = hashes(saved.parent)
    arguments = [sys.executable, "-c", FILL_THE_DISK, str(saved)]
    printed = subprocess.run(arguments, capture_output=True, text=True, check=True)
    assert printed.stdout == f"cannot write {saved}: File too large\n"
    assert hashes(saved.parent) == before
    assert Checkpoint.load(saved).best == {"steps": 32}


def test_an_interruption_leaves_the_earlier_checkpoint(saved, hashes, monkeypatch):
    before = hashes(saved.parent)
    checkpoint = Checkpoint.load(saved)

    def interrupted(file):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(saved)
    assert hashes(saved.parent) == before
    assert [entry.name for entry in saved.parent.iterdir()] == [LAST]
