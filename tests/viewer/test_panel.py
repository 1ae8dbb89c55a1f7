"""What the panel offers and says, and what becomes of what its users choose."""

import html
import re
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

from collaborative_gym.envs.make import make_vec
from collaborative_gym.policies import load_policy
from collaborative_gym.viewer.menu import Menu
from collaborative_gym.viewer.session import Session
from collaborative_gym.viewer.stage import NEWTONS_PER_METRE, _arrows, _rows
from collaborative_gym.viewer.web import Page


def choose(page, label, value, tab=None):
    """Do what viser does when a tab chooses from a list."""
    box = offers(page)[label]
    assert value in box.options
    box._impl.value = value
    event = SimpleNamespace(client=tab or object(), target=box)
    for callback in box._impl.update_cb:
        callback(event)


def offers(page):
    boxes = page._panel._offers
    return {box.label: box for box in boxes if hasattr(box, "options")}


@pytest.fixture
def show(start):
    """Return a function that returns a paused session and its page."""
    shown = []

    def show(env_id, **policies):
        env = make_vec(env_id, 1, num_threads=1)
        policies = dict.fromkeys(env.agents, "idle") | policies
        session = Session(
            env, load_policy(policies, env), pytest.fail, policies=policies
        )
        session.pause()
        page = Page(session, Menu(env, policies), "127.0.0.1", 0)
        shown.append((start(session, page.refresh), page))
        return session, page

    yield show
    for end, page in shown:
        end()
        page.close()


@pytest.fixture
def poke(show):
    """Return a paused session of Poke and its page."""
    return show("PokeTaskSawyers-v0", robot_1="expert")


def test_what_is_chosen_plays_without_a_restart(poke, wait_until):
    session, page = poke
    wait_until(lambda: "Environment" in offers(page))
    before = {label: box.value for label, box in offers(page).items()}
    assert before == {
        "Task": "Poke",
        "Environment": "PokeTaskSawyers-v0",
        "Starts": "default",
        "robot_1, arm": "sawyer",
        "robot_1, policy": "expert",
        "robot_2, arm": "sawyer",
        "robot_2, policy": "idle",
    }
    first = session.env
    session.pause()
    choose(page, "robot_2, policy", "random")
    wait_until(lambda: session.policies["robot_2"] == "random")
    wait_until(lambda: not session.is_paused)
    assert session.env is first
    choose(page, "robot_1, policy", "baseline")
    wait_until(lambda: session.policies["robot_1"] == "baseline")
    choose(page, "robot_1, arm", "jaco")
    wait_until(lambda: page._stage.env is not first, timeout=120)
    assert session.env.task.robots["robot_1"].name == "jaco"
    wait_until(lambda: offers(page)["robot_1, arm"].value == "jaco")
    wait_until(lambda: "baseline" not in offers(page)["robot_1, policy"].options)
    said = "the expert plays in place of baseline"
    wait_until(lambda: said in page._panel._heading.content)
    assert "HockeyPandas-v0" not in offers(page)["Environment"].options
    choose(page, "Task", "Hockey")
    wait_until(lambda: page._stage.env.task.name == "HockeyPandas-v0", timeout=120)
    wait_until(lambda: "Score more goals" in page._panel._heading.content)
    assert said not in page._panel._heading.content
    block = "<span style=display:inline-block>robot_{} {}</span>".format
    sides = map(block, (1, 2), ("(red) baseline <b>0</b>", "(blue) expert <b>0</b>"))
    assert " : ".join(sides) in page._panel._heading.content
    wait_until(lambda: "HockeyPandas-v0" in page._panel._script.content)
    titles = {"reward of robot_1", "reward of robot_2", "measured in s"}
    plots = page._panel._plots
    wait_until(lambda: titles <= {title for title, *_ in list(plots._charts)})


def test_other_tabs_are_told_of_a_choice(poke, wait_until):
    session, page = poke
    wait_until(lambda: "Environment" in offers(page))
    told = []
    tabs = [
        SimpleNamespace(add_notification=lambda *said, i=i, **_: told.append((i, said)))
        for i in range(2)
    ]
    page._panel._tabs = lambda: dict(enumerate(tabs))
    choose(page, "robot_2, policy", "random", tabs[0])
    wait_until(lambda: session.policies["robot_2"] == "random")
    news = "PokeTaskSawyers-v0: expert, random"
    assert told == [(1, ("Another tab chose", news))]


def test_a_team_is_chosen_at_once_or_one_by_one(show, wait_until):
    session, page = show("ReachPandas4-v0")
    wait_until(lambda: "All policies" in offers(page))
    assert list(offers(page))[:6] == [
        "Task",
        "Environment",
        "Starts",
        "All arms",
        "All policies",
        "robot_1, arm",
    ]
    choose(page, "All policies", "expert")
    wait_until(lambda: set(session.policies.values()) == {"expert"})
    done = re.compile(r">expert, \d+ % done<")
    wait_until(lambda: done.search(page._panel._heading.content))
    wait_until(lambda: offers(page)["robot_4, policy"].value == "expert")
    choose(page, "robot_4, policy", "random")
    wait_until(lambda: offers(page)["All policies"].value == "mixed", timeout=60)
    assert list(session.policies.values()) == ["expert"] * 3 + ["random"]
    assert offers(page)["All arms"].value == "panda"
    choose(page, "All arms", "ur5e")
    arms = {"ur5e"}
    wait_until(lambda: {r.name for r in session.env.task.robots.values()} == arms, 120)


def test_each_side_of_a_game_of_teams_is_chosen_at_once(show, wait_until):
    session, page = show("HockeyDoubles-v0")
    wait_until(lambda: "side_2, policies" in offers(page))
    choose(page, "side_2, policies", "random")
    wait_until(lambda: session.policies["robot_4"] == "random")
    assert list(session.policies.values()) == ["idle", "idle", "random", "random"]


def test_labels_stand_over_the_arms_and_say_who_plays(poke, wait_until):
    session, page = poke
    labels = page._stage._labels
    wait_until(lambda: labels["robot_2"].text == "robot_2: idle")
    data, model = session.env.sim.data(0), session.env.model
    for agent, label in labels.items():
        own = [
            data.xpos[i]
            for i in range(model.nbody)
            if model.body(i).name.startswith(f"{agent}/")
        ]
        assert label.position[2] == pytest.approx(
            max(p[2] for p in own) + 0.2, abs=0.01
        )
    page._panel._looks["labels"].value = False
    wait_until(lambda: not any(label.visible for label in labels.values()))


def test_how_to_pull_is_written_on_the_scene_until_somebody_did(poke, wait_until):
    session, page = poke
    hint = page._panel._hint
    wait_until(lambda: hint.visible)
    session.perturb = mujoco.MjvPerturb()
    session.step()
    wait_until(lambda: session.was_pulled and not hint.visible)


def test_plots_follow_the_episode(poke, wait_until):
    session, page = poke
    for _ in range(3):
        session.step()
    wait_until(lambda: len(session.film) == 4)
    charts = page._panel._plots._charts
    reward = next(key for key in charts if key[0] == "reward of robot_1")
    wait_until(lambda: len(charts[reward].data[0]) == 3)  # A start has none.
    np.testing.assert_allclose(charts[reward].data[0], [0.1, 0.2, 0.3])
    assert reward[1:3] == ("reward per step", "total")
    totals = [sum(f.readings[0].rewards["robot_1"].values()) for f in session.film[1:]]
    np.testing.assert_allclose(charts[reward].data[1], totals)
    for name, curve in zip(reward[3:], charts[reward].data[2:], strict=True):
        terms = [frame.readings[0].rewards["robot_1"][name] for frame in session.film]
        np.testing.assert_array_equal(curve, terms[1:])
    measured = next(key for key in charts if key[0] == "measured in m")
    assert measured[1:3] == ("m", "distance")
    axes = [axis["label"] for axis in charts[measured].axes]
    assert axes == ["time, s", "m"]
    assert [each["label"] for each in charts[measured].series[1:]] == ["distance"]
    wait_until(lambda: len(charts[measured].data[0]) == 4)
    np.testing.assert_allclose(charts[measured].data[0], [0.0, 0.1, 0.2, 0.3])


def test_the_time_shows_and_leads(poke, wait_until):
    session, page = poke
    for _ in range(2):
        session.step()
    wait_until(lambda: page._panel._time.value == pytest.approx(0.2))
    assert page._panel._time.max == pytest.approx(0.2)
    event = SimpleNamespace(client=object(), target=SimpleNamespace(value=0.1))
    for callback in page._panel._time._impl.update_cb:
        callback(event)
    wait_until(lambda: session.reading.time == pytest.approx(0.1))


def test_a_slider_past_what_was_played_comes_back(poke, wait_until):
    session, page = poke
    session.step()
    slider = page._panel._time
    wait_until(lambda: slider.value == pytest.approx(0.1))
    for _ in range(2):  # The second time the world is there already.
        slider._impl.value = 18.0
        event = SimpleNamespace(client=object(), target=slider)
        for callback in slider._impl.update_cb:
            callback(event)
        wait_until(lambda: slider.value == pytest.approx(0.1))
    assert session.reading.time == pytest.approx(0.1)


@pytest.mark.parametrize(("count", "rows"), [(16, [4] * 4), (7, [3, 3, 1]), (1, [1])])
def test_rows_of_worlds_have_no_more_columns_than_they_need(count, rows):
    bodies = np.array([(0.0, -1.3, 0.0), (1.6, 1.3, 0.0)])
    _, found = np.unique(_rows(count, bodies)[:, 0], return_counts=True)
    assert sorted(found, reverse=True) == rows


def test_contact_forces_bear_what_lies_on_the_ground():
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
    body = spec.worldbody.add_body(pos=[0.0, 0.0, 0.1])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1], mass=2.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    mujoco.mj_forward(model, data)
    arrows = _arrows(model, data)
    forces = NEWTONS_PER_METRE * (arrows[:, 1] - arrows[:, 0])
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, 2.0 * 9.81], atol=0.05)
    np.testing.assert_allclose(arrows[:, 0, 2], 0.0, atol=1e-3)


def test_a_link_is_shown_and_plays_its_start(poke, wait_until):
    session, page = poke
    wait_until(lambda: page._panel._offers)
    link = page._panel._choice.link
    wait_until(lambda: html.escape(link) in page._panel._link.content)
    page._open(link.replace("idle", "random"))()
    wait_until(lambda: session.policies["robot_2"] == "random")
    page._open(link.replace("episode=0", "episode=6"))()
    wait_until(lambda: session.reading.episode == 6)
    wait_until(lambda: "episode=6" in page._panel._link.content)
    boxes = page._panel._offers
    session.next()
    wait_until(lambda: "episode=7" in page._panel._link.content)
    assert page._panel._offers is boxes  # A list that somebody has open stays open.
