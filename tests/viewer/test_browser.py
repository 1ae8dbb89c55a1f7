"""The page in a real browser, which draws it and whose mouse and buttons are used."""

import io
import shutil
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")
pytest.importorskip("playwright", reason="no playwright to drive a browser with")

from PIL import Image
from playwright.sync_api import expect, sync_playwright

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.pictures.rendering import CAMERA, overview
from collaborative_gym.policies import load_policy
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.viewer.menu import Menu
from collaborative_gym.viewer.session import FASTEST, Session
from collaborative_gym.viewer.web import Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WIDTH, HEIGHT = 1240, 520
REBOUND = "rebound.test"  # A stranger's name that now leads to this machine.
PATIENCE = 120.0  # s; without a graphics card a picture may take seconds
ENVS = (
    "LiftTaskSawyers-v0",
    "PokeTaskPandaSawyer-v0",
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        CHROMIUM is None, reason="no Chromium; 'apt-get install chromium' brings it"
    ),
]


@pytest.fixture(scope="module")
def browser():
    """Return a browser that draws without a graphics card."""
    arguments = [
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        f"--host-resolver-rules=MAP {REBOUND} 127.0.0.1",
    ]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=arguments, timeout=60_000
        )
        yield browser
        browser.close()


@pytest.fixture
def serve(start):
    """Return a function that plays an environment and serves it."""
    served = []

    def serve(env_id, policy="expert", num_envs=1):
        task = make_task(env_id)
        env = VectorEnv(task, num_envs, num_threads=1, auto_reset=False)
        policies = dict.fromkeys(env.agents, policy)
        session = Session(env, load_policy(policy, env), print, policies=policies)
        session.pause()
        page = Page(session, Menu(env, policies), "127.0.0.1", 0)
        served.append((start(session, page.refresh), page))
        return session, page

    yield serve
    for end, page in served:
        end()
        page.close()


@pytest.fixture
def open_tab(browser):
    """Return a function that opens a page in a tab, and waits until it is drawn."""
    tabs = []

    def open_tab(page, link="", width=WIDTH, height=HEIGHT):
        tab = browser.new_page(
            viewport={"width": width, "height": height}, device_scale_factor=0.5
        )
        tab.set_default_timeout(PATIENCE * 1000)
        tabs.append(tab)
        tab.asked, tab.errors = [], []
        tab.on("request", lambda request: tab.asked.append(request.url))
        tab.on("pageerror", lambda error: tab.errors.append(str(error)))
        tab.goto(page.url + link)
        tab.get_by_text("episode of seed 0").wait_for(state="attached")
        # Where there is no graphics card, the tab does without shadows by itself.
        shadows = tab.get_by_label("Shadows", exact=True)
        expect(shadows).not_to_be_checked(timeout=PATIENCE * 1000)
        # Where there is no graphics card the page says so, in front of the scene.
        notice = tab.locator(".mantine-Notification-closeButton")
        notice.first.click()
        notice.first.wait_for(state="detached")
        return tab

    yield open_tab
    for tab in tabs:
        tab.close()


def press(tab, name):
    tab.get_by_role("button", name=name, exact=True).click()


def canvas(tab):
    """Return where the scene is in the tab: left, top, width and height."""
    box = tab.locator("canvas").first.bounding_box()
    return [round(box[side]) for side in ("x", "y", "width", "height")]


def drawn(tab):
    left, top, width, height = canvas(tab)
    clip = {"x": left, "y": top, "width": width, "height": height}
    picture = Image.open(io.BytesIO(tab.screenshot(clip=clip)))
    return np.asarray(picture.convert("RGB"))


def likeness(one, other):
    """Return how alike two pictures are: 1 for the same, 0 for unrelated ones.

    It is the correlation of small versions, so that what counts is where things are
    and what colour they have, not how bright the light is.
    """
    flat = []
    for picture in (one, other):
        small = Image.fromarray(picture).resize((96, 64), Image.Resampling.BOX)
        colors = np.asarray(small, float)
        flat.append((colors - colors.mean(axis=(0, 1))).ravel())
    return float(np.dot(*flat) / np.prod([np.linalg.norm(each) for each in flat]))


def pixel_of(tab, page, body, place=0.0):
    """Return where the middle of a body is in the tab, as all tabs see it.

    `place` is where its world stands.
    """
    data, model = page._stage._data, page._stage._model
    left, top, width, height = canvas(tab)
    camera = next(iter(page._server.get_clients().values())).camera
    forward = camera.look_at - camera.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    away = data.body(body).xpos + place - camera.position
    scale = height / 2 / np.tan(np.radians(model.camera(CAMERA).fovy[0]) / 2)
    scale /= away @ forward
    column, row = scale * (away @ right), scale * (away @ np.cross(right, forward))
    return left + width / 2 + column, top + height / 2 - row


def off_screen(session, width, height):
    """Return a picture of the world, once the session's thread is out of it."""
    while True:
        with suppress(RuntimeError):
            return session.env.render(width=width, height=height)
        time.sleep(0.01)


@pytest.mark.parametrize("env_id", ENVS)
def test_the_scene_is_drawn_as_off_screen(serve, open_tab, wait_until, env_id):
    session, page = serve(env_id)
    tab = open_tab(page)
    # The page's own camera steps back until the arms fit. A tab that is exactly on the
    # first camera is put back to its own, so this one stands 2 cm above it.
    camera = next(iter(page._server.get_clients().values())).camera
    eye, target = overview(page._stage._model, page._stage._data)
    camera.position, camera.look_at = eye + np.array([0.0, 0.0, 0.02]), target
    _, _, *size = canvas(tab)
    at_start = off_screen(session, *size)
    wait_until(lambda: likeness(drawn(tab), at_start) > 0.9, timeout=PATIENCE)
    for _ in range(12):
        session.step()
    session.speed = FASTEST
    wait_until(lambda: session.reading.time > 1.15)
    now = off_screen(session, *size)
    assert likeness(now, at_start) < 0.99
    wait_until(lambda: likeness(drawn(tab), now) > 0.9, timeout=PATIENCE)
    wait_until(
        lambda: likeness(drawn(tab), now) > likeness(drawn(tab), at_start) + 0.005
    )
    assert tab.errors == []
    # Nothing comes from anywhere else: it works without the internet.
    assert {url.split(":")[0] for url in tab.asked if page.url not in url} <= {"data"}


def test_the_buttons_work(serve, open_tab, wait_until):
    session, page = serve(ENVS[0], "baseline")
    tab = open_tab(page)
    press(tab, "Step")
    wait_until(lambda: session.reading.time == pytest.approx(0.1))
    tab.get_by_text("0.1 s").wait_for()
    for agent, terms in session.reading.rewards.items():
        tab.get_by_text(f"reward of {agent}").wait_for()
        for name, term in terms.items():
            row = tab.locator("tr", has_text=name).filter(has_text=f"{term:z.3f}")
            assert row.count() >= 1
    press(tab, "Play")
    wait_until(lambda: session.reading.time > 0.5)
    assert not session.is_paused
    press(tab, "Pause")
    wait_until(lambda: session.is_paused)
    press(tab, "Reset")
    wait_until(lambda: session.reading.time == 0)
    assert session.reading.episode == 0
    press(tab, "Next")
    wait_until(lambda: session.reading.episode == 1)
    tab.keyboard.press("Space")  # Though `Next` has been pressed last.
    wait_until(lambda: not session.is_paused)
    assert session.reading.episode == 1
    tab.keyboard.press("Space")
    wait_until(lambda: session.is_paused)
    time_before = session.reading.time
    tab.keyboard.press("ArrowRight")
    wait_until(lambda: session.reading.time == pytest.approx(time_before + 0.1))
    tab.keyboard.press("Backspace")
    wait_until(lambda: session.reading.time == 0)
    tab.keyboard.press("Enter")
    wait_until(lambda: session.reading.episode == 2)
    tab.get_by_role("tab", name="Look").click()
    speed = tab.get_by_role("textbox").nth(1)
    speed.fill("2.5")
    speed.press("Enter")
    wait_until(lambda: session.speed == 2.5)


def test_the_mouse_pulls_until_it_lets_go(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    tab = open_tab(page)
    pot = session.env.model.body("pot/pot").id
    x, y = pixel_of(tab, page, "pot/pot")
    height = session.env.facts.pot[0][0, 2]
    tab.keyboard.down("Control")
    tab.mouse.move(x, y)
    tab.mouse.down()
    for step in range(1, 9):
        tab.mouse.move(x, y - 16 * step)
    wait_until(lambda: session.perturb is not None, timeout=PATIENCE)
    assert session.perturb.select == pot
    wait_until(lambda: session.perturb.refselpos[2] > height + 0.2, timeout=PATIENCE)
    tab.wait_for_timeout(1000)  # Until the last move has arrived.
    for _ in range(5):
        session.step()
    wait_until(lambda: session.reading.time == pytest.approx(0.5))
    assert session.env.facts.pot[0][0, 2] > height + 0.1
    tab.mouse.up()
    tab.keyboard.up("Control")
    wait_until(lambda: session.perturb is None, timeout=PATIENCE)


WATCH = """() => new MutationObserver((changes) => changes.forEach((change) =>
  change.addedNodes.forEach((added) => { window.said = added.textContent; })
)).observe(document.body, {childList: true})"""


def test_a_pull_that_misses_leaves_the_camera(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    tab = open_tab(page)
    camera = next(iter(page._server.get_clients().values())).camera
    before = camera.position.copy()
    tab.evaluate(WATCH)  # What is said may be gone before a slow test looks.

    def drag():
        tab.mouse.move(300, 440)  # The floor.
        tab.mouse.down()
        for step in range(1, 9):
            tab.mouse.move(300 + 16 * step, 440)
        tab.mouse.up()

    tab.keyboard.down("Control")
    drag()
    said = "Nothing to pull here"
    wait_until(lambda: tab.evaluate("window.said") == said, timeout=PATIENCE)
    tab.evaluate("window.said = null")
    tab.wait_for_timeout(2000)
    assert camera.position == pytest.approx(before)
    assert not session.was_pulled
    tab.mouse.move(*pixel_of(tab, page, "pot/pot"))
    tab.mouse.down()
    tab.wait_for_timeout(500)
    assert tab.evaluate("window.said") is None
    tab.mouse.up()
    tab.keyboard.up("Control")
    drag()  # Without Ctrl it turns.
    wait_until(lambda: np.abs(camera.position - before).max() > 0.1, timeout=PATIENCE)


def test_a_pull_in_a_grid_reads_its_world(serve, open_tab, wait_until):
    session, page = serve(ENVS[0], num_envs=3)
    tab = open_tab(page)
    tab.get_by_text("success in 0 of 3 worlds").wait_for()
    place = page._stage._places[2]
    x, y = pixel_of(tab, page, "pot/pot", place)
    tab.keyboard.down("Control")
    tab.mouse.move(x, y)
    tab.mouse.down()
    for step in range(1, 9):
        tab.mouse.move(x, y - 8 * step)
    wait_until(lambda: session.perturb is not None, timeout=PATIENCE)
    assert session.world == 2
    assert session.perturb.select == session.env.model.body("pot/pot").id
    pot = session.env.sim.data(2).body("pot/pot").xpos
    target = session.perturb.refselpos
    assert np.linalg.norm(target - pot) < 1.5  # In the frame of its own world.
    tab.mouse.up()
    tab.keyboard.up("Control")
    wait_until(lambda: session.perturb is None, timeout=PATIENCE)
    tab.get_by_text("episode of seed 0").locator("xpath=..").get_by_text("2").wait_for()


def test_a_tab_that_closes_lets_go_and_another_goes_on(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    tab, other = open_tab(page), open_tab(page)
    x, y = pixel_of(tab, page, "pot/pot")
    tab.bring_to_front()
    tab.keyboard.down("Control")
    tab.mouse.move(x, y)
    tab.mouse.down()
    for step in range(1, 9):
        tab.mouse.move(x, y - 5 * step)
    wait_until(lambda: session.perturb is not None, timeout=PATIENCE)
    tab.close()
    wait_until(lambda: session.perturb is None, timeout=PATIENCE)
    press(other, "Play")
    wait_until(lambda: session.reading.time > 0.5)
    press(other, "Pause")
    wait_until(lambda: session.is_paused)
    wait_until(lambda: f"{session.reading.time:.1f} s" in other.inner_text("table"))


def test_a_tab_has_the_title_of_what_plays(serve, open_tab):
    _, page = serve(ENVS[0])
    tab = open_tab(page)
    assert tab.title() == f"{ENVS[0]}: expert"


def test_a_link_opens_the_same_start(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    link = page._panel._choice.link.replace("episode=0", "episode=4")
    tab = open_tab(page, link.replace(ENVS[0], ENVS[1]).replace("=sawyer", "=panda", 1))
    wait_until(lambda: session.env.task.name == ENVS[1], timeout=PATIENCE)
    assert session.reading.episode == 4
    wait_until(lambda: tab.title().startswith(ENVS[1]), timeout=PATIENCE)
    # viser's page adds "?websocket=..." to the address; it must open the same again.
    wait_until(lambda: "?" not in tab.evaluate("location.href"))
    assert tab.evaluate("location.href").startswith(f"{page.url}/play/env={ENVS[1]}")
    tab.get_by_role("tab", name="Choose").click()
    shown = tab.get_by_role("link", name="link to this start").get_attribute("href")
    assert shown == page._panel._choice.link


def test_a_phone_shows_the_arms_above_the_panel(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    tab = open_tab(page, width=390, height=844)
    for agent in session.env.agents:
        base = f"{agent}/base"
        wait_until(lambda base=base: 20 < pixel_of(tab, page, base)[0] < 370)
    assert not tab.locator(".hint").is_visible()  # A phone has no Ctrl.
    play = tab.get_by_role("button", name="Play")
    play.wait_for()
    plots, thumb = tab.get_by_role("tab", name="Plots"), ".mantine-Slider-thumb"
    for part, least in ((play, 44), (plots, 44), (tab.locator(thumb).first, 28)):
        assert (part.bounding_box() or {})["height"] >= least  # for a thumb
    panel = tab.locator(".mantine-Paper-root").filter(has=play).bounding_box() or {}
    assert panel["height"] <= 0.45 * 844
    # All controls, the tabs and the first lines of one are in view without a scroll.
    shown = play.bounding_box() or {}, plots.bounding_box() or {}
    assert panel["y"] < shown[0]["y"]
    assert shown[1]["y"] + shown[1]["height"] <= 844 - 120
    for agent in session.env.agents:
        assert pixel_of(tab, page, f"{agent}/base")[1] < panel["y"]
    # Nor are names and buttons cut.
    tab.get_by_role("tab", name="Look").click()
    back, moves_on = tab.get_by_text("Reset camera"), tab.get_by_text("Move on")
    assert back.evaluate("e => e.scrollWidth <= e.clientWidth")
    assert moves_on.is_visible()
    tab.get_by_role("tab", name="Now").click()
    # A finger needs no key to pull.
    x, y = pixel_of(tab, page, "pot/pot")
    tab.mouse.move(x, y)
    tab.mouse.down()
    for step in range(1, 9):
        tab.mouse.move(x, y - 8 * step)
    wait_until(lambda: session.perturb is not None, timeout=PATIENCE)
    assert session.perturb.select == session.env.model.body("pot/pot").id
    tab.mouse.up()
    wait_until(lambda: session.perturb is None, timeout=PATIENCE)


def test_a_tab_that_takes_the_first_camera_late_gets_its_own_again(
    serve, open_tab, wait_until
):
    _, page = serve(ENVS[0])
    open_tab(page, width=390, height=800)
    camera = next(iter(page._server.get_clients().values())).camera
    first = page._server.initial_camera
    wait_until(lambda: not np.allclose(camera.position, first.position, atol=0.1))
    time.sleep(2.0)  # The tab has told its size for the last time.
    own = camera.position.copy()
    camera.position, camera.look_at = first.position, first.look_at
    wait_until(lambda: np.allclose(camera.position, own, atol=0.1), timeout=PATIENCE)


def test_a_link_in_another_tab_is_seen_from_its_own_camera(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    open_tab(page)
    open_tab(page, "/play/env=BalanceTaskSawyers-v0")
    assert session.env.task.name == "BalanceTaskSawyers-v0"
    tabs = page._server.get_clients()
    camera = tabs[max(tabs)].camera

    def is_placed():
        eye, _ = page._stage._place("overview", camera.aspect)
        return np.allclose(camera.position, eye, atol=0.02)

    wait_until(is_placed, timeout=PATIENCE)
    time.sleep(2.0)  # The tab has told its size for the last time.
    assert is_placed()


def test_shadows_can_be_had(serve, open_tab, wait_until):
    _, page = serve(ENVS[0])
    tab = open_tab(page)
    assert [light.cast_shadow for light in page._stage._lights] == [False]
    tab.get_by_label("Shadows", exact=True).check()
    wait_until(lambda: page._stage._lights[0].cast_shadow)


def test_keys_that_move_a_slider_leave_the_camera(serve, open_tab, wait_until):
    session, page = serve(ENVS[0])
    tab = open_tab(page)
    session.play()
    wait_until(lambda: len(session.film) > 8, timeout=PATIENCE)
    session.pause()
    slider, now = tab.get_by_role("slider").first, "aria-valuenow"
    # A tab that lags behind shows 0.2 on the way, and a key would move what it shows.
    wait_until(
        lambda: float(slider.get_attribute(now)) == pytest.approx(session.reading.time),
        timeout=PATIENCE,
    )
    session.seek(2)
    expect(slider).to_have_attribute(now, "0.2", timeout=PATIENCE * 1000)
    camera = next(iter(page._server.get_clients().values())).camera
    before = camera.position.copy()
    slider.press("ArrowRight", delay=1000)
    wait_until(lambda: session.reading.time == pytest.approx(0.3), timeout=PATIENCE)
    assert camera.position == pytest.approx(before)
    tab.mouse.click(200, 300)  # On the arms, where keys do move it.
    tab.keyboard.press("ArrowLeft", delay=1000)
    wait_until(lambda: np.abs(camera.position - before).max() > 0.1, timeout=PATIENCE)
    tab.get_by_role("tab", name="Look").click()
    press(tab, "Reset camera")
    # The arms have moved since, and the camera fits what it shows.
    eye, _ = page._stage._place("overview", camera.aspect)
    wait_until(lambda: np.allclose(camera.position, eye, atol=0.01), PATIENCE)
    assert eye == pytest.approx(before, abs=0.1)


ATTACK = """async (url) => {
  const socket = new Promise((answer) => {
    const socket = new WebSocket(url.replace("http", "ws"), PROTOCOL);
    socket.onopen = () => answer("open");
    socket.onerror = () => answer("refused");
  });
  const fetched = fetch(url).then((response) => response.status, () => "refused");
  return [await socket, await fetched];
}"""


@pytest.fixture
def foreign():
    """Return the address of another web page of this machine."""

    class Hello(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<p>hello")

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Hello) as server:
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def visit(browser):
    """Return a function that opens an address and tries from there to reach another."""
    import viser

    attack = ATTACK.replace("PROTOCOL", repr(f"viser-v{viser.__version__}"))
    tabs = []

    def visit(address, target):
        tab = browser.new_page()
        tabs.append(tab)
        answer = tab.goto(address)
        return answer and answer.status, tab.evaluate(attack, target)

    yield visit
    for tab in tabs:
        tab.close()


def test_a_foreign_page_reaches_nothing(serve, visit, foreign):
    _, page = serve(ENVS[0])
    assert visit(page.url, page.url) == (200, ["open", 200])
    refused = ["refused", "refused"]
    assert visit(foreign, page.url) == (200, refused)
    # It comes from the same machine, yet by another name.
    other_name = page.url.replace("127.0.0.1", "localhost")
    assert visit(foreign, other_name) == (200, refused)
    # Such an address has no origin of its own: the browser says `null`.
    assert visit("data:text/html,<p>hello", page.url) == (None, refused)


def test_a_name_that_was_rebound_reaches_nothing(serve, visit):
    _, page = serve(ENVS[0])
    rebound = page.url.replace("127.0.0.1", REBOUND)
    assert visit(rebound, rebound) == (403, ["refused", 403])


def test_a_foreign_page_cannot_frame_it(serve, browser, foreign, wait_until):
    _, page = serve(ENVS[0])
    tab = browser.new_page()
    tab.goto(foreign)
    tab.set_content(f"<iframe src='{page.url}'></iframe>")
    wait_until(lambda: len(tab.frames) == 2, timeout=PATIENCE)
    wait_until(lambda: tab.frames[1].url.startswith("chrome-error:"), timeout=PATIENCE)
    tab.close()
