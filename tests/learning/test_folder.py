"""One run at a time in a folder, whatever became of earlier ones."""

import os
import signal
import subprocess
import sys

import pytest

from collaborative_gym.learning.folder import LAST, LOCK, claimed

HOLD = """
import sys, time
from pathlib import Path
from collaborative_gym.learning.folder import claimed

with claimed(Path(sys.argv[1])):
    print("claimed", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    """Return a process that holds the folder `tmp_path / "run"`."""
    arguments = [sys.executable, "-c", HOLD, str(tmp_path / "run")]
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "claimed\n"
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_folder_is_one_processs_until_it_is_gone(holder, tmp_path):
    folder = tmp_path / "run"
    beside = pytest.raises(BlockingIOError, match=f"process {holder.pid} is .*{folder}")
    with beside, claimed(folder):
        pass
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with claimed(folder):
        assert (folder / LOCK).read_text() == f"process {os.getpid()}"
        beside = pytest.raises(BlockingIOError, match="let it end, or choose another")
        with beside, claimed(folder):
            pass
    with claimed(folder):
        pass


def test_nothing_is_trained_beside_a_live_run(train_tiny, hashes, tmp_path):
    folder = train_tiny().folder
    arguments = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        try:
            process.stdout.readline()
            before = hashes(folder)
            for where in ({"resume": folder}, {"output": folder}):
                with pytest.raises(BlockingIOError, match=f"process {process.pid} "):
                    train_tiny(**where)
            assert hashes(folder) == before
        finally:
            process.kill()


def test_what_was_half_written_is_removed_and_nothing_else(tmp_path):
    for name in (".last.abc.partial", ".policy.x.partial", ".film.abc.partial"):
        (tmp_path / name).mkdir()
        (tmp_path / name / LAST).write_bytes(b"half")
    with claimed(tmp_path):
        names = {each.name for each in tmp_path.iterdir()}
    assert names == {".film.abc.partial", LOCK}


def test_what_is_wanted_must_be_there(tmp_path):
    missing = pytest.raises(FileNotFoundError, match=f"no checkpoint .*{LAST}")
    with missing, claimed(tmp_path / "nowhere", LAST):
        pass
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "run"
    with pytest.raises(OSError, match=f"cannot write {folder}"), claimed(folder):
        pass
