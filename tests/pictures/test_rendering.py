"""Drawing in threads, in forked processes, and at the end of a process."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from collaborative_gym.pictures.rendering import Camera

WORLDS = """
import gc, os, sys, threading, time
import mujoco
import numpy as np
from collaborative_gym.pictures.rendering import Camera

def world(color):
    spec = mujoco.MjSpec()
    box = spec.worldbody.add_body(name="box")
    box.add_freejoint()
    box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2] * 3, rgba=[*color, 1])
    spec.worldbody.add_camera(name="overview", pos=[0, 0, 2])
    spec.worldbody.add_light(pos=[0, 0, 3], castshadow=False)
    return spec.compile()

still = [0, 0, 0, 1, 0, 0, 0], np.zeros((0, 3))
models = [world(color) for color in ([1, 0, 0], [0, 1, 0])]
cameras = [Camera(model, 64, 48) for model in models]
expected = [camera.picture(*still) for camera in cameras]
assert expected[0].std() > 10 and (expected[0] != expected[1]).any()
"""

THREADS = """
failed = []

def draw(camera, picture):
    for _ in range(50):
        if (camera.picture(*still) != picture).any():
            failed.append(camera)

pairs = [*zip(cameras, expected), *zip(cameras, expected)]
threads = [threading.Thread(target=draw, args=pair) for pair in pairs]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert not failed

# One is closed, and one given up, in another thread than the one that made it.
del thread, threads, pairs
first, cameras[:] = cameras[0], cameras[1:]
for end in (first.close, cameras.clear):
    thread = threading.Thread(target=end)
    thread.start()
    thread.join()
gc.collect()
again = Camera(models[0], 64, 48)  # It stays open to the end of the process.
assert (again.picture(*still) == expected[0]).all()
print("done")
"""

FORK = """
child = os.fork()
if child == 0:
    for draw in (cameras[0].picture, lambda *_: Camera(models[0], 64, 48)):
        try:
            draw(*still)
        except RuntimeError as error:
            print(error, flush=True)
    cameras[0].close()
    cameras.clear()
    gc.collect()
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
assert (cameras[0].picture(*still) == expected[0]).all()
"""

ENDS = """
def draw():
    while children is not None:
        Camera(models[0], 64, 48).close()

children = []
thread = threading.Thread(target=draw)
thread.start()
for _ in range(5):
    child = os.fork()
    if child == 0:
        children = None
        sys.exit(0)
    children.append(child)
    time.sleep(0.01)
ends = [os.waitpid(child, 0)[1] for child in children]
children = None
thread.join()
assert not any(ends)
"""


def world(bodies):
    """Return a model of these bodies, seen from 3 m along x."""
    return mujoco.MjModel.from_xml_string(
        f"""
        <mujoco>
          <worldbody>
            <camera name="overview" pos="3 0 0" xyaxes="0 1 0 0 0 1"/>
            {bodies}
          </worldbody>
        </mujoco>
        """
    )


def run(script):
    """Return what a process prints that runs a script."""
    arguments = [sys.executable, "-c", WORLDS + script]
    process = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    assert process.returncode == 0, process.stderr
    return process.stdout


def test_threads_draw_and_free_without_a_crash():
    assert run(THREADS) == "done\n"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="it cannot fork")
def test_a_forked_process_is_told_that_it_cannot_draw():
    lines = run(FORK).splitlines()
    assert len(lines) == 2
    for line in lines:
        assert line.startswith("pictures were drawn before this process was forked")
        assert line.endswith("multiprocessing.get_context('spawn')")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="it cannot fork")
def test_a_forked_process_ends_as_any_other():
    assert run(ENDS) == ""


@pytest.mark.parametrize(
    ("width", "height", "error", "words"),
    [
        (0, 48, ValueError, "width must be at least 1, got 0"),
        (64, -1, ValueError, "height must be at least 1, got -1"),
        (641, 48, ValueError, "width must be at most 640, got 641"),
        (64.0, 48, TypeError, "width must be an integer, got 64.0"),
        (64, True, TypeError, "height must be an integer, got True"),
        ("64", 48, TypeError, "width must be an integer, got '64'"),
        (None, 48, TypeError, "width must be an integer, got None"),
    ],
)
def test_a_size_that_cannot_be_is_refused(width, height, error, words):
    with pytest.raises(error, match=f"^{words}$"):
        Camera(mujoco.MjSpec().compile(), width, height)


def test_sizes_of_numpy_are_sizes():
    camera = Camera(mujoco.MjSpec().compile(), np.int64(64), np.uint8(48))
    assert camera.size == (64, 48)
    camera.close()


def test_what_stands_before_a_close_up_is_cut_away():
    model = world(
        """
          <body name="ball"><geom size="0.1" rgba="1 0 0 1" group="2"/></body>
          <geom type="box" size="0.01 1 1" pos="1 0 0" rgba="0 0 1 1" group="2"/>
        """
    )
    for bodies, channel in ((["ball"], 0), ((), 2)):
        camera = Camera(model, 64, 48, bodies)
        pixel = camera.picture(np.zeros(0), np.zeros((0, 3)))[24, 32]
        assert pixel.argmax() == channel
        camera.close()


def test_a_close_up_looks_past_what_hides_its_body():
    model = world(
        """
          <body name="ball"><geom size="0.05" rgba="1 0 0 1" group="2"/></body>
          <body name="arm"><joint type="slide" axis="0 1 0"/>
            <geom type="box" size=".01 .1 2" pos=".3 0 0" group="3"/>
            <geom type="box" size=".01 .1 2" pos=".3 0 0" group="2" rgba="0 0 1 1"/>
          </body>
        """
    )
    camera = Camera(model, 64, 48, ["ball"])
    pixels = [
        camera.picture([place], np.zeros((0, 3)))[24, 32].argmax()
        for place in (0.0, *[0.25] * 40, *[-0.25] * 80)
    ]
    camera.close()
    assert not any(pixels)  # It cuts to another side at once.


def test_shadows_fade():
    model = mujoco.MjModel.from_xml_string(
        """
        <mujoco>
          <visual><headlight ambient="0.2 0.2 0.2" diffuse="0 0 0"/></visual>
          <worldbody>
            <camera name="overview" pos="0 0 4" xyaxes="1 0 0 0 1 0"/>
            <light type="directional" pos="0 0 3" dir="0.3 0 -1" diffuse="0.6 0.6 0.6"/>
            <geom type="plane" size="4 4 1" group="2"/>
            <geom type="box" size="0.3 0.3 0.01" pos="0 0 1.5" group="2"/>
          </worldbody>
        </mujoco>
        """
    )
    camera = Camera(model, 320, 240)
    picture = camera.picture(np.zeros(0), np.zeros((0, 3)))
    camera.close()
    # From the middle to the right: the box, its shadow, which ends at once if it is
    # drawn with one lamp, and the floor.
    shadow = picture[120, 200:240, 0].astype(int)
    assert shadow.min() < 0.7 * shadow.max()
    steps = np.diff(shadow)
    assert steps.sum() > 50 and steps.max() < 0.5 * np.ptp(shadow)


def test_zoom_takes_a_close_up_nearer():
    model = world(
        """
          <body name="ball"><geom size="0.1" rgba="1 0 0 1" group="2"/></body>
        """
    )
    for bodies, bounds in ((["ball"], (2.5, 4.0)), ((), (0.99, 1.01))):
        camera = Camera(model, 64, 48, bodies)
        far, near = (
            (camera.picture(np.zeros(0), np.zeros((0, 3)), zoom)[..., 0] > 60).sum()
            for zoom in (0.0, 1.0)
        )
        assert bounds[0] < near / far < bounds[1]
        camera.close()


def test_of_several_bodies_the_close_up_shows_the_one_that_hands_are_at():
    model = world(
        """
          <body name="red"><geom size="0.1" rgba="1 0 0 1" group="2"/></body>
          <body name="blue" pos="0 1 0">
            <geom size="0.1" rgba="0 0 1 1" group="2"/></body>
          <body name="robot"><joint type="slide" axis="0 1 0"/>
            <site name="robot_1/tcp"/><geom size="0.01" mass="1" group="4"/></body>
          <body name="mate" pos="0 2 0"><joint type="slide" axis="0 1 0"/>
            <site name="robot_2/tcp"/><geom size="0.01" mass="1" group="4"/></body>
        """
    )
    camera, none = Camera(model, 64, 48, ["red", "blue"]), np.zeros((0, 3))
    # The second hand comes near before the first has left; then that comes back.
    ways = ((0.0, 0.0), (0.1, -0.95), (0.2, -0.95), (0.05, -0.95), (0.0, 0.0))
    seen = [camera.picture(np.array(way), none)[24, 32].argmax() for way in ways]
    assert seen == [0, 0, 2, 2, 0]
    camera.close()


def test_the_close_up_stays_at_what_moves_after_hands_have_left_it():
    bodies = """<body name="red"><joint type="slide" axis="0 0 1"/>
        <geom size="0.1" rgba="1 0 0 1" group="2"/></body>
      <body name="blue" pos="0 1 0"><geom size="0.1" rgba="0 0 1 1" group="2"/></body>
      <body name="robot"><joint type="slide" axis="0 1 0"/>
        <site name="robot_1/tcp"/><geom size="0.01" mass="1" group="4"/></body>"""
    camera, none = Camera(world(bodies), 64, 48, ["red", "blue"]), np.zeros((0, 3))
    # The hand lets go and is at the other thing at once; this one falls, and rests.
    places = [(0.0, 0.0), (-0.05, 1.0), (-0.1, 1.0), *[(-0.1, 1.0)] * 30]
    seen = [camera.picture(np.array(place), none)[24, 32].argmax() for place in places]
    assert seen[:5] == [0] * 5 and seen[-1] == 2
    camera.close()
