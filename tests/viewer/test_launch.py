import os
import shutil
import signal
import subprocess
import sys

import pytest

from collaborative_gym.viewer import launch, window
from collaborative_gym.viewer.launch import HERE

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


class Face:
    """A viewer that ends what it shows."""

    url, is_public, was_closed = "http://somewhere:8080", False, False

    def __init__(self, session):
        self.session, self.refresh = session, session.end

    def close(self):
        self.was_closed = True


@pytest.fixture
def opened(monkeypatch):
    """Return what is opened, and with what, in place of windows and pages."""
    opened = []

    def open_window(session):
        opened.append(("window", Face(session)))
        return opened[-1][1]

    def open_page(session, *arguments):
        opened.append(("page", Face(session), *arguments))
        return opened[-1][1]

    monkeypatch.setattr(window, "Window", open_window)
    monkeypatch.setattr(launch, "_page", open_page)
    return opened


def test_it_opens_a_window(carry_id, opened):
    told = []
    launch.view(carry_id, told.append, warn=told.append)
    assert [kind for kind, *_ in opened] == ["window"]
    assert opened[0][1].was_closed
    assert len(told) == 1 and "building the world" in told[0]


def test_where_no_window_opens_it_serves_a_page_and_says_so(
    carry_id, opened, monkeypatch
):
    def fail(session):
        raise RuntimeError("there is no display")

    monkeypatch.setattr(window, "Window", fail)
    told = []
    launch.view(
        carry_id,
        told.append,
        warn=pytest.fail,
        policy="expert",
    )
    assert opened[0][0] == "page" and opened[0][1].was_closed
    assert opened[0][2:] == (False, *HERE)
    assert told[1:] == [
        "there is no display; showing it in the browser instead",
        "open http://somewhere:8080 in a browser; Ctrl-C ends it",
    ]


def test_a_page_for_all_the_world_comes_with_a_warning(carry_id, opened, monkeypatch):
    monkeypatch.setattr(Face, "is_public", True)
    warned = []
    told = warned.append
    launch.view(carry_id, told, warn=warned.append, address=("0.0.0.0", 8080))
    assert [kind for kind, *_ in opened] == ["page"]
    assert warned[1].startswith("WARNING: the viewer listens on 0.0.0.0. Everyone who")


def test_a_port_that_is_in_use_is_named(carry_id, opened):
    said = []
    launch.view(carry_id, said.append, warn=pytest.fail, address=("127.0.0.1", 8079))
    assert said[-1].startswith("port 8079 is in use; open http://somewhere:8080 in")


@pytest.mark.parametrize("given", [{"address": ("::1", 1234)}, {"num_envs": 3}])
def test_an_address_and_several_worlds_need_a_page(carry_id, opened, given):
    launch.view(carry_id, str, warn=str, **given)
    [(kind, face, _, *address)] = opened
    assert kind == "page" and tuple(address) == given.get("address", HERE)
    assert len(face.session.readings) == given.get("num_envs", 1)


def test_too_many_worlds_are_refused_before_they_are_built(carry_id, opened):
    with pytest.raises(ValueError, match="num_envs must be at most 16, got 17"):
        launch.view(carry_id, pytest.fail, warn=pytest.fail, num_envs=17)


def test_each_robot_may_have_a_policy_of_its_own(carry_id, opened):
    policy = {"robot_1": "idle", "robot_2": "random"}
    launch.view(carry_id, str, warn=pytest.fail, policy=policy, address=HERE)
    assert opened[0][1].session.policies == policy


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window may open")
def test_without_a_display_no_window_opens(make_session, monkeypatch):
    for variable in DISPLAYS:
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(RuntimeError, match="no display to open a window on"):
        window.Window(make_session())
    monkeypatch.setenv("DISPLAY", ":9999")
    with pytest.raises(RuntimeError, match="no window can be opened on the display"):
        window.Window(make_session())


@pytest.mark.parametrize(
    ("sent", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
def test_a_signal_ends_a_page_and_leaves_no_process(sent, status):
    pytest.importorskip("viser", reason="the extra `view` is not installed")
    from websockets.sync.client import connect

    module = [sys.executable, "-m", "collaborative_gym", "view", "PokeTaskSawyers-v0"]
    process = subprocess.Popen(
        [*module, "--web", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    try:
        assert "building the world" in process.stdout.readline()
        line = process.stdout.readline()
        assert line.startswith("open http://127.0.0.1:") and "Ctrl-C ends it" in line
        url = line.split()[1].replace("http", "ws")
        with connect(url, max_size=None, subprotocols=[f"viser-v{version()}"]) as tab:
            tab.recv(timeout=10)
            os.kill(process.pid, sent)
            output, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    # Where Ctrl-C meets an import, Python ends by the signal itself; to a shell that is
    # the same status.
    assert process.returncode in (status, -sent)
    assert output == errors == ""
    with pytest.raises(ProcessLookupError):  # Its group had nobody else.
        os.killpg(process.pid, 0)


def version():
    import viser

    return viser.__version__


@pytest.fixture
def display(tmp_path, monkeypatch):
    """Set up a display in memory."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb to open a window on; 'apt-get install xvfb' brings it")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        yield f":{number}"
    finally:
        server.kill()
        server.wait()


WINDOWED = """
from collaborative_gym.envs.make import make_vec
from collaborative_gym.policies import load_policy
from collaborative_gym.viewer.session import Session
from collaborative_gym.viewer.window import Window

env = make_vec("PokeTaskSawyers-v0", 1, num_threads=1)
session = Session(env, load_policy("expert", env), print)
window = Window(session)
space, right, backspace, enter, up, down = 32, 262, 259, 257, 265, 264
keys = [up, up, down, space, enter, right, right]

def show():
    window.refresh()
    if keys:
        window._press(keys.pop(0))
    elif session.reading.episode == 1 and session.reading.time > 0.15:
        window._window.close()  # As its user does.

session.run(show)
window.close()
print(session.is_paused, session.speed, session.reading.time)
"""


@pytest.mark.slow
def test_a_window_heeds_keys_until_it_is_closed(display):
    result = subprocess.run(
        [sys.executable, "-c", WINDOWED],
        env={**os.environ, "DISPLAY": display, "MUJOCO_GL": "glfw"},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout == "True 1.25 0.2\n"
