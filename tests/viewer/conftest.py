"""A small world that is played in a thread, as a viewer plays it."""

import threading
import time

import numpy as np
import pytest

from collaborative_gym.policies import load_policy
from collaborative_gym.viewer.session import FASTEST, Session


@pytest.fixture
def make_session(make_env):
    """Return a function that makes a session of the small task."""

    def make(policy="expert", **settings):
        env = make_env(auto_reset=False, **settings)
        policies = dict.fromkeys(env.agents, policy)
        session = Session(env, load_policy(policy, env), print, policies=policies)
        session.speed = FASTEST
        return session

    return make


@pytest.fixture
def start():
    """Return a function that plays a session in a thread, which ends with the test."""
    ends = []

    def start(session, show=lambda: None):
        """Return a function that ends it."""
        thread = threading.Thread(target=session.run, args=[show])
        thread.start()

        def end():
            session.end()
            thread.join(timeout=10)
            assert not thread.is_alive()

        ends.append(end)
        return end

    yield start
    for end in ends:
        end()


@pytest.fixture
def wait_until():
    """Return a function that waits until something is so."""

    def wait_until(is_so, timeout=10.0):
        deadline = time.monotonic() + timeout
        while not is_so():
            assert time.monotonic() < deadline, "it has not come about"
            time.sleep(0.01)

    return wait_until


@pytest.fixture
def unwatched(make_env):
    """Return a function: positions of an episode after each step, without a viewer."""

    def unwatched(steps, policy="expert", **settings):
        env = make_env(**settings)
        act = load_policy(policy, env)
        observations, _ = env.reset()
        rows = [env.sim.qpos[0].copy()]
        for _ in range(steps):
            observations, *_ = env.step(act(observations))
            rows.append(env.sim.qpos[0].copy())
        return np.array(rows)

    return unwatched


@pytest.fixture
def make_page(make_session):
    """Return a function that serves a session on a free port, and stop it after."""
    from collaborative_gym.viewer.menu import Menu
    from collaborative_gym.viewer.web import Page

    pages = []

    def make(session=None, host="127.0.0.1", port=0):
        session = session or make_session()
        menu = Menu(session.env, session.policies)
        page = Page(session, menu, host, port)
        pages.append(page)
        return page

    yield make
    for page in pages:
        page.close()
