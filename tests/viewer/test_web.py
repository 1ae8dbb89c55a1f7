import html
import socket
import sys
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from collaborative_gym.viewer.menu import Menu
from collaborative_gym.viewer.stage import _linear
from collaborative_gym.viewer.web import Page

only_linux = pytest.mark.skipif(
    sys.platform != "linux", reason="elsewhere 127.0.0.2 is no address of the machine"
)


@pytest.fixture
def watch():
    """Return a function that connects to a page as a browser's tab does."""

    def watch(page):
        return connect(
            page.url.replace("http", "ws"),
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        )

    return watch


def port_of(page):
    return int(page.url.rsplit(":", 1)[1])


def receives(tab, count):
    """Return how many bytes come in that many messages."""
    return sum(len(tab.recv(timeout=10)) for _ in range(count))


@only_linux
def test_it_listens_on_this_machine_alone(make_session, make_page):
    page = make_page(make_session())
    assert page.url == f"http://127.0.0.1:{port_of(page)}"
    assert not page.is_public
    socket.create_connection(("127.0.0.1", port_of(page))).close()
    with pytest.raises(ConnectionRefusedError):  # Also this machine, by another name.
        socket.create_connection(("127.0.0.2", port_of(page)))


@only_linux
def test_it_listens_for_others_where_told_so(make_session, make_page):
    page = make_page(make_session(), host="0.0.0.0")
    assert page.url == f"http://localhost:{port_of(page)}"
    assert page.is_public
    socket.create_connection(("127.0.0.2", port_of(page))).close()


def test_two_pages_beside_each_other_have_two_ports(make_session, make_page):
    first = make_page(make_session())
    second = make_page(make_session(), port=port_of(first))
    assert port_of(second) > port_of(first)


def test_it_says_nothing_by_itself(make_session, make_page, capfd):
    make_page(make_session()).close()
    assert capfd.readouterr() == ("", "")


def test_two_tabs_watch_and_a_closed_one_stops_nothing(
    make_session, make_page, start, watch, wait_until
):
    session = make_session(max_episode_steps=1000)
    page = make_page(session)
    end = start(session, page.refresh)
    with closing(watch(page)) as one, closing(watch(page)) as other:
        assert receives(one, 5) > 100_000  # The scene, and what moves.
        assert receives(other, 5) > 100_000
        one.close()
        before = session.reading.time
        assert receives(other, 50) > 0
        wait_until(lambda: session.reading.time > before + 0.2)
    before = session.reading.time
    wait_until(lambda: session.reading.time > before + 0.2)
    with closing(watch(page)) as late:
        assert receives(late, 5) > 100_000
    end()


def test_closed_it_leaves_its_tabs_and_its_port(
    make_session, make_page, watch, wait_until
):
    page = make_page(make_session())
    with closing(watch(page)) as tab:
        receives(tab, 1)
        page.close()
        with pytest.raises(ConnectionClosed):
            receives(tab, 1000)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port_of(page)))


def test_every_body_is_where_the_world_has_it(make_session, make_page):
    session = make_session("random")
    page = make_page(session)
    for _ in range(3):
        session.env.step(session.env.expert())
    page.refresh()
    data = session.env.sim.data(0)
    assert len(page._stage._bodies) > 15
    for body, nodes in page._stage._bodies.items():
        for node in nodes:
            [place], [turn] = node.batched_positions, node.batched_wxyzs
            np.testing.assert_allclose(place, data.xpos[body], atol=1e-4)
            np.testing.assert_allclose(turn, data.xquat[body], atol=1e-4)


def test_worlds_beside_one_another_are_read_one_at_a_time(
    make_session, make_page, start, wait_until
):
    session = make_session("random", num_envs=6, max_episode_steps=1000)
    page = make_page(session)
    end = start(session, page.refresh)
    page._panel._read(4)
    session.pause()
    for _ in range(3):
        session.step()
    wait_until(lambda: all(each.time > 0.25 for each in session.readings))
    wait_until(lambda: page._panel._said is session.reading)
    end()
    assert session.reading.episode == 4
    assert ">4<" in page._panel._table.content
    assert "success in 0 of 6 worlds" in page._panel._heading.content
    assert page._panel._worlds.value == "world 5"
    assert "episode=4" in page._panel._link.content
    places = page._stage._places
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    assert apart[~np.eye(6, dtype=bool)].min() > 1.0
    tab = SimpleNamespace(camera=SimpleNamespace(aspect=1.5, image_height=600))
    for view in "one world", "above":
        eyes = []
        for world in 0, 4:
            session.look(world)
            eyes.append(page._stage.stand(tab, view))
        np.testing.assert_allclose(eyes[1] - eyes[0], places[4], atol=0.5)
    for body, nodes in page._stage._bodies.items():
        for node in nodes:
            for i in range(6):
                at = session.env.sim.data(i).xpos[body] + places[i]
                np.testing.assert_allclose(node.batched_positions[i], at, atol=1e-4)


@pytest.mark.parametrize("aspect", [0.46, 1.2, 2.0])
def test_a_grid_fills_a_window_of_any_shape(make_session, make_page, aspect):
    session = make_session("random", num_envs=16)
    stage = make_page(session)._stage
    eye, target = stage._place("overview", aspect)
    points = stage._poses()[0][:, 1:].reshape(-1, 3)
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.array([-back[1], back[0], 0.0]) / np.hypot(*back[:2])
    away = points - eye
    depth = stage._slope * -(away @ back)
    across = away @ right / depth / aspect
    upward = away @ np.cross(back, right) / depth
    lowest = -0.1 if aspect < 0.75 else -1.0  # A phone's panel covers what is below.
    assert np.abs(across).max() < 1.0
    assert lowest < upward.min() < upward.max() < 1.0
    room = 1.0 - lowest
    assert max(np.ptp(across) / 2, np.ptp(upward) / room) > 0.75
    assert np.ptp(upward) / room > 0.4
    assert 1.0 - upward.max() == pytest.approx(upward.min() - lowest, abs=0.2)


def test_a_page_is_as_bright_as_a_film(make_session, make_page):
    page = make_page(make_session())
    model = page._stage._model
    # A page makes light again of what it is given, by the curve of sRGB.
    linear = np.array([0.001, 0.003, 0.05, 0.5, 1.0])
    curved = np.where(
        linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055
    )
    np.testing.assert_allclose(_linear(curved), linear, rtol=1e-2)
    # What faces up, in the shade of the first light, against what is lit by all.
    down = -model.light_dir[:, 2] / np.linalg.norm(model.light_dir, axis=1)
    head = model.vis.headlight
    for_film = model.light_diffuse.mean(axis=1) * down
    always = head.ambient.mean() + head.diffuse.mean() / 2
    in_film = 1 - for_film[0] / (for_film.sum() + always)
    given = page._server.scene._handle_from_node_name
    ambient = given["/ambient"].intensity
    lights = down * [given[f"/light {i}"].intensity for i in range(model.nlight)]
    lit = ambient + lights.sum()
    assert lit / np.pi == pytest.approx(1.1, abs=0.15)
    assert (1 - lights[0] / lit) ** (1 / 2.2) == pytest.approx(in_film, abs=0.1)


def test_the_panel_says_what_the_reading_says(make_session, make_page):
    session = make_session()
    page = make_page(session)
    page.refresh()
    for name, value in session.reading.rows:
        assert f">{name}<" in page._panel._table.content
        assert html.escape(value) in page._panel._table.content
    assert "stopped" not in page._panel._heading.content
    session.readings = (replace(session.reading, trouble="no <idea>"),)
    page.refresh()
    assert "stopped:</b> no &lt;idea&gt;<br>" in page._panel._heading.content


def test_a_world_that_cannot_be_drawn_leaves_no_server(make_session):
    session = make_session()
    session.env.scene.spec.add_hfield(
        name="hill", nrow=2, ncol=2, size=[1, 1, 1, 1], userdata=[0.0] * 4
    )
    session.env.scene.spec.worldbody.add_geom(type=1, hfieldname="hill")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(ValueError, match="is a HFIELD"):
        Page(session, Menu(session.env, session.policies), "127.0.0.1", port)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))
