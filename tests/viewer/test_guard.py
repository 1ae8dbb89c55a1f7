"""What a page's server answers to strangers, and which messages it heeds."""

import random
import resource
import socket
import sys
from contextlib import closing
from http.client import HTTPConnection

import msgspec
import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

import viser
from websockets.asyncio import server as websockets
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.sync.client import connect

from collaborative_gym.viewer import guard

PROTOCOL = f"viser-v{viser.__version__}"
REFUSED = ConnectionClosed, ConnectionError, InvalidHandshake, TimeoutError
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [3.6, 0, 2.1],
    "fov": 0.8,
    "near": 0.01,
    "far": 1000,
    "image_height": 480,
    "image_width": 640,
    "look_at": [0, 0, 0.5],
    "up_direction": [0, 0, 1],
}


@pytest.fixture
def page(make_page):
    return make_page()


def port_of(page):
    return int(page.url.rsplit(":", 1)[1])


def statuses(page, headers):
    """Return what a request and a WebSocket with these headers are answered."""
    answers = []
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Protocol": PROTOCOL,
    }
    for more in ({}, upgrade):
        web = HTTPConnection("127.0.0.1", port_of(page), timeout=10)
        web.putrequest("GET", "/", skip_host=True)
        for name, value in [*headers, *more.items()]:
            web.putheader(name, value)
        web.endheaders()
        answers.append(web.getresponse().status)
        web.close()
    return answers


@pytest.mark.parametrize(
    "host", ["localhost", "LocalHost", "127.0.0.1", "127.0.0.2", "[::1]"]
)
@pytest.mark.parametrize("port", ["", ":8080", ":1"])
def test_its_own_page_is_answered_at_every_port(page, host, port):
    host += port
    assert statuses(page, [("Host", host)]) == [200, 101]
    assert statuses(page, [("Host", host), ("Origin", f"http://{host}")]) == [200, 101]


@pytest.mark.parametrize(
    "host",
    [
        "evil.com",
        "evil.com:8080",
        "localhost.evil.com",
        "127.0.0.1.evil.com",
        "evil.com:80@127.0.0.1",
        "192.168.1.1",
        "[::2]:8080",
        "0.0.0.0",
        "localhost:x",
        "localhost:",
        "",
        "\xe9:80",
        "[127.0.0.1",
    ],
)
def test_another_name_is_refused_even_where_the_origin_agrees(page, host):
    assert statuses(page, [("Host", host)]) == [403, 403]
    both = [("Host", host), ("Origin", f"http://{host}")]
    assert statuses(page, both) == [403, 403]


@pytest.mark.parametrize(
    "origin",
    [
        "null",
        "",
        "http://evil.com",
        "http://127.0.0.1",
        "http://127.0.0.1:1",
        "https://127.0.0.1:{port}",
        "http://localhost:{port}",
        "http://127.0.0.1:{port}.evil.com",
        "http://127.0.0.1:{port}/",
        "file://",
        "chrome-extension://abc",
    ],
)
def test_another_origin_is_refused(page, origin):
    host = ("Host", f"127.0.0.1:{port_of(page)}")
    origin = origin.format(port=port_of(page))
    assert statuses(page, [host, ("Origin", origin)]) == [403, 403]


def test_no_host_two_hosts_and_two_origins_are_refused(page):
    host = ("Host", f"127.0.0.1:{port_of(page)}")
    origin = ("Origin", page.url)
    for headers in ([], [host, host], [host, origin, origin]):
        assert statuses(page, headers) == [403, 403]


def test_open_to_others_it_answers_to_addresses_and_its_own_names(make_page):
    page = make_page(host="0.0.0.0")
    name = socket.gethostname()
    for host in (
        "192.168.1.1:8080",
        "[fe80::1]:80",
        "localhost",
        name,
        f"{name}.local",
    ):
        own = ("Host", host), ("Origin", f"http://{host}")
        assert statuses(page, own) == [200, 101]
        foreign = ("Host", host), ("Origin", "http://192.168.1.2:8080")
        assert statuses(page, foreign) == [403, 403]
    for host in ("evil.com", f"{name}.evil.com"):
        assert statuses(page, [("Host", host)]) == [403, 403]


@pytest.mark.skipif(not socket.has_ipv6, reason="there is no IPv6")
def test_its_page_at_an_ipv6_address_is_answered(make_page):
    page = make_page(host="::1")
    tab = join(page)
    tab.close()


def test_no_foreign_page_may_frame_it(page):
    web = HTTPConnection("127.0.0.1", port_of(page), timeout=10)
    for path in ("/", "/missing"):
        web.request("GET", path)
        answer = web.getresponse()
        answer.read()
        policy = answer.headers["Content-Security-Policy"]
        assert policy == "frame-ancestors 'none'"
        web.close()


def test_a_page_of_another_version_is_told_to_reload(page, capfd):
    for protocols in ([], ["viser-v0.0.1"], ["viser-v0.0.1", PROTOCOL]):
        with pytest.raises(InvalidStatus) as refused:
            connect(page.url.replace("http", "ws"), subprotocols=protocols or None)
        assert refused.value.response.status_code == 400
    assert capfd.readouterr() == ("", "")


def test_a_viser_that_starts_otherwise_is_refused(make_session, monkeypatch):
    def serve_otherwise(host, port, verbose):
        return closing_like

    class Stopped:
        has_stopped = False

        def stop(self):
            self.has_stopped = True

    closing_like = Stopped()
    monkeypatch.setattr(viser, "ViserServer", serve_otherwise)
    before = websockets.serve
    with pytest.raises(RuntimeError, match="cannot be guarded from foreign pages"):
        guard.start_server("127.0.0.1", 0, links="/play/", on_link=pytest.fail)
    assert closing_like.has_stopped
    assert websockets.serve is before


@pytest.fixture
def tab(page):
    """Return a connection as that of a tab that has shown where it looks from."""
    with closing(join(page)) as tab:
        yield tab


def join(page):
    tab = connect(
        page.url.replace("http", "ws"),
        origin=page.url,
        subprotocols=[PROTOCOL],
        max_size=None,
    )
    send(tab, CAMERA)
    return tab


def send(tab, message):
    tab.send(msgspec.msgpack.encode(message))


def update(handle, updates):
    uuid = handle._impl.uuid
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}


def test_clicks_ticks_and_speeds_arrive(page, tab, wait_until):
    session = page._session
    send(tab, update(page._panel._play, {"value": True}))
    wait_until(lambda: session.is_paused)
    send(tab, update(page._panel._speed, {"value": 2}))
    wait_until(lambda: session.speed == 2)


def test_names_that_are_offered_arrive(page, tab, wait_until):
    panel = page._panel
    send(tab, update(panel._view, {"value": "above"}))
    wait_until(lambda: panel.view == "above")
    send(tab, update(panel._moves, {"value": "Step"}))
    wait_until(lambda: page._session.is_paused)
    send(tab, update(panel._looks["forces"], {"value": True}))
    wait_until(lambda: panel.looks["forces"])


def drag(page, **changes):
    node = next(
        name
        for name, node in page._server.scene._handle_from_node_name.items()
        if name.startswith("/cube cube/")
    )
    return {
        "type": "SceneNodeDragMessage",
        "phase": "start",
        "name": node,
        "instance_index": 0,
        "start_position": [0, 0, 0.5],
        "start_screen_pos": [0.5, 0.5],
        "end_position": [0, 0, 1],
        "end_screen_pos": [0.5, 0.4],
        "button": "left",
        "modifier": "cmd/ctrl",
        "owner": "",
        **changes,
    }


def test_a_drag_pulls_until_its_end_or_the_tab_closes(page, wait_until, capfd):
    session = page._session
    with closing(join(page)) as tab:
        send(tab, drag(page, phase="update"))
        send(tab, drag(page))
        wait_until(lambda: session.perturb is not None)
        send(tab, drag(page, phase="update", end_position=[0, 0, 2]))
        wait_until(lambda: session.perturb.refselpos[2] == 2)
        send(tab, drag(page, phase="end"))
        wait_until(lambda: session.perturb is None)
        send(tab, drag(page, phase="end"))
        send(tab, drag(page))
        wait_until(lambda: session.perturb is not None)
    wait_until(lambda: session.perturb is None)
    assert capfd.readouterr() == ("", "")


def malformed(page):
    """Return messages that no page of ours sends."""
    play, speed = page._panel._play, page._panel._speed
    far = [1e9, 0, 0]
    nan = float("nan")
    start = {"source_component_uuid": play._impl.uuid, "transfer_uuid": "a"}
    return [
        update(play, {"props": None}),
        update(play, {"value": True, "props": None}),
        update(play, None),
        update(play, {"value": None}),
        update(play, {"value": "yes"}),
        update(play, {"value": [True]}),
        update(play, {"label": "Pwned"}),
        update(play, {"no": 1}),
        {"type": "GuiUpdateMessage", "uuid": None, "updates": {"value": True}},
        {"type": "GuiUpdateMessage", "uuid": "x" * 300, "updates": {"value": True}},
        {"type": "GuiUpdateMessage", "updates": {"value": True}},
        {**update(play, {"value": True}), "excluded_self_client": 3},
        update(speed, {"value": 1e9}),
        update(speed, {"value": -1}),
        update(speed, {"value": nan}),
        update(speed, {"value": "2"}),
        update(speed, {"value": True}),
        update(page._panel._view, {"value": "nowhere"}),
        update(page._panel._view, {"value": 1}),
        update(page._panel._moves, {"value": "Jump"}),
        update(page._panel._time, {"value": 1e3}),
        update(page._panel._looks["forces"], {"value": "yes"}),
        {"type": "GuiUpdateMessage", "uuid": "none", "updates": {"value": True}},
        update(page._panel._table, {"content": "<script>alert(1)</script>"}),
        {"type": "ShareUrlRequest"},
        {"type": "ShareUrlDisconnect"},
        {"type": "FileTransferStartUpload", **start, "part_count": 0, "size_bytes": 0}
        | {"filename": "a", "mime_type": "b"},
        {"type": "FileTransferPart", "content": b"x" * 999, "part_index": 0, **start},
        {"type": "GuiFormDirtyMessage", "uuid": "a"},
        {"type": "RunJavascriptMessage", "source": "alert(1)"},
        {"type": "SceneNodeUpdateMessage", "name": "/x", "updates": {}, "owner": ""},
        {"type": "Message"},
        {"type": ["GuiUpdateMessage"]},
        {"type": None},
        {},
        [],
        None,
        7,
        b"bytes",
        {**CAMERA, "position": [nan, 0, 0]},
        {**CAMERA, "position": [0, 0]},
        {**CAMERA, "position": "abc"},
        {**CAMERA, "image_width": -1},
        {**CAMERA, "image_width": 2**62},
        {**CAMERA, "fov": None},
        drag(page, end_position=far),
        drag(page, start_position=[nan, 0, 0]),
        drag(page, instance_index=16),
        drag(page, phase="middle"),
        drag(page, button="right"),
        drag(page, modifier="shift"),
        drag(page, owner="7"),
    ]


def test_what_no_page_sends_is_dropped(page, tab, wait_until, capfd):
    session = page._session
    page.refresh()
    label, content = page._panel._play.label, page._panel._table.content
    for message in malformed(page):
        send(tab, message)
    for raw in (b"", b"\xc1", b"\x91" * 9999, b"\xd9\xff\xff", b"\x81\xa4type" * 999):
        tab.send(raw)
    tab.send("text")
    tab.send('{"type": "GuiUpdateMessage"}')
    draw = random.Random(0)
    sane = msgspec.msgpack.encode(update(page._panel._speed, {"value": 1.0}))
    for _ in range(2000):
        damaged = bytearray(sane)
        damaged[draw.randrange(len(sane))] = draw.randrange(256)
        tab.send(bytes(damaged[: draw.randrange(1, 2 * len(sane))]))
    page.refresh()
    assert (page._panel._play.label, page._panel._table.content) == (label, content)
    assert not session.is_paused and session.perturb is None
    send(tab, update(page._panel._play, {"value": True}))  # It is still heard.
    wait_until(lambda: session.is_paused)
    page.refresh()
    assert capfd.readouterr() == ("", "")


def test_a_message_that_says_two_things_says_one(page, tab, wait_until):
    # A map with a key twice, of which two readers may take another.
    pause = update(page._panel._play, {"value": True})
    parts = [msgspec.msgpack.encode(part) for pair in pause.items() for part in pair]
    props = msgspec.msgpack.encode("updates") + msgspec.msgpack.encode({"props": None})
    tab.send(b"\x84" + b"".join(parts[:4]) + props + b"".join(parts[4:]))
    tab.send(b"\x84" + b"".join(parts) + props)
    send(tab, update(page._panel._speed, {"value": 2}))
    wait_until(lambda: page._session.speed == 2)
    page.refresh()  # Which writes to the button.


def test_what_is_too_large_ends_the_connection(page, wait_until):
    with closing(join(page)) as tab, pytest.raises(ConnectionClosed, match="1009"):
        tab.send(b"x" * 2**20)
        for _ in range(1000):
            tab.recv(timeout=10)
    with closing(join(page)) as other:
        send(other, update(page._panel._play, {"value": True}))
        wait_until(lambda: page._session.is_paused)


def test_uploads_fill_no_memory(page, tab, wait_until):
    part = {"type": "FileTransferPart", "content": b"x" * 2**13, "part_index": 0}
    part |= {
        "source_component_uuid": page._panel._play._impl.uuid,
        "transfer_uuid": "a",
    }
    start = {"type": "FileTransferStartUpload", "filename": "a", "mime_type": "b"}
    start |= {"part_count": 9999, "size_bytes": 2**40}
    start |= {key: part[key] for key in ("source_component_uuid", "transfer_uuid")}
    send(tab, start)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for index in range(4000):  # 32 MB.
        send(tab, part | {"part_index": index})
    send(tab, update(page._panel._play, {"value": True}))
    wait_until(lambda: page._session.is_paused)
    assert page._server.gui._current_file_upload_states == {}
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 16 * 1024 * (1 if sys.platform == "linux" else 1024)


def test_connections_beyond_a_number_are_refused(page, monkeypatch):
    monkeypatch.setattr(guard, "_MOST", 2)
    tabs = [join(page) for _ in range(2)]
    with pytest.raises(REFUSED):
        join(page)
    for tab in tabs:
        tab.ping().wait(10)
        tab.close()


def test_silent_connections_lock_no_tab_out(page):
    address = "127.0.0.1", port_of(page)
    silent = [socket.create_connection(address) for _ in range(guard._MOST)]
    with closing(join(page)) as tab:
        assert tab.ping().wait(10)
    for each in silent:
        each.close()


def test_a_tab_without_height_joins(page, wait_until, capfd):
    with closing(join(page)) as tab:
        send(tab, {**CAMERA, "image_height": 0, "image_width": 0})
        wait_until(lambda: page._server.get_clients())
        (client,) = page._server.get_clients().values()
        wait_until(lambda: client.camera.image_height == 1)
    assert "ZeroDivisionError" not in capfd.readouterr().err


@pytest.mark.parametrize("path", ["/" + "x" * 5000, "/%00", "/" + "a/" * 2000])
def test_a_path_that_no_file_can_have_is_missing(page, path):
    assert get(page.url, path) == 404


def test_two_start_at_once_and_both_are_guarded(make_page):
    pages = [make_page() for _ in range(2)]
    for page in pages:
        assert statuses(page, [("Host", "evil.com")]) == [403, 403]


@pytest.fixture
def linked():
    """Return a server whose links lead somewhere, and where its pages were led."""
    led = []

    def read(link):
        if not link.startswith("/play/env="):
            raise KeyError("no such start")
        return lambda: led.append(link)

    server = guard.start_server("127.0.0.1", 0, links="/play/", on_link=read)
    yield f"http://127.0.0.1:{server.get_port()}", led
    server.stop()


def get(url, path, **headers):
    web = HTTPConnection(url.removeprefix("http://"), timeout=10)
    web.request("GET", path, headers=headers)
    answer = web.getresponse()
    answer.read()
    web.close()
    return answer.status


def test_a_link_is_a_page_and_leads_once_that_connects(linked, wait_until):
    url, led = linked
    assert get(url, "/play/env=Lift") == 200
    assert led == []  # A picture in a foreign page could ask for that much.
    path = url.replace("http", "ws") + "/play/env=Lift"
    with closing(connect(path, origin=url, subprotocols=[PROTOCOL], max_size=None)):
        wait_until(lambda: led == ["/play/env=Lift"])


def test_a_link_to_nothing_is_missing(linked):
    url, led = linked
    assert get(url, "/play/nothing") == 404
    assert get(url, "/missing") == 404
    with pytest.raises(InvalidStatus) as refused:
        connect(
            url.replace("http", "ws") + "/play/nothing",
            origin=url,
            subprotocols=[PROTOCOL],
        )
    assert refused.value.response.status_code == 404
    assert b"width=device-width" in refused.value.response.body  # Readable on phones.
    assert led == []


def test_a_foreign_page_follows_no_link(linked):
    url, led = linked
    assert get(url, "/play/env=Lift", Origin="http://evil.com") == 403
    for origin in ("http://evil.com", "null"):
        with pytest.raises(InvalidStatus) as refused:
            connect(
                url.replace("http", "ws") + "/play/env=Lift",
                origin=origin,
                subprotocols=[PROTOCOL],
            )
        assert refused.value.response.status_code == 403
    assert led == []
