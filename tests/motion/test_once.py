import numpy as np
import pytest

from collaborative_gym.motion.once import found_once
from collaborative_gym.robots import get_robot
from collaborative_gym.scene import Placement, Scene

SOUTH = Placement((0.0, -1.0, 0.7))


def compiled(place=SOUTH, robot="panda", pedestal=True, sensed=False):
    scene = Scene()
    scene.add_robot("robot_1", get_robot(robot), placement=place, stand=pedestal)
    if sensed:
        scene.spec.worldbody.add_site(name="first of all sites")
        scene.add_pose_sensor("more", "robot_1/tcp")
    model = scene.compile()
    return model, scene.arms["robot_1"]


@pytest.fixture
def search():
    """Return a search that counts how often it is done."""

    def count(model, arm, *, goal):
        count.done += 1
        return count.done, np.array(goal, float)

    count.done = 0
    return found_once(count)


def test_a_search_is_done_once_for_the_same_arm_and_shapes(search):
    first, goal = search(*compiled(), goal=[1, 2])
    goal[:] = 9.0  # Nobody else's.
    for world in (compiled(), compiled(sensed=True)):
        again, goal = search(*world, goal=[1, 2])
        assert again == first and goal.tolist() == [1.0, 2.0]


def test_a_search_is_done_again_where_anything_differs(search):
    worlds = [
        compiled(),
        compiled(Placement((0.0, -1.0, 0.71))),
        compiled(robot="sawyer"),
        compiled(pedestal=False),
    ]
    found = [search(*world, goal=[1, 2])[0] for world in worlds]
    found.append(search(*worlds[0], goal=[1, 3])[0])
    model, arm = compiled()
    model.site_pos[arm.tcp] += 0.01
    found.append(search(model, arm, goal=[1, 2])[0])
    assert found == [1, 2, 3, 4, 5, 6]


def test_a_search_that_fails_is_done_again():
    calls = []

    @found_once
    def fail(model, arm):
        calls.append(arm)
        raise ValueError("no posture")

    for _ in range(2):
        with pytest.raises(ValueError, match="no posture"):
            fail(*compiled())
    assert len(calls) == 2
