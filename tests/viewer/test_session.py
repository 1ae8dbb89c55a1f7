import threading
import time

import mujoco
import numpy as np
import pytest

from collaborative_gym.policies import load_policy
from collaborative_gym.viewer.session import FASTEST, SLOWEST, Session


def positions(session):
    return session.env.sim.qpos[0].copy()


def steps_done(session):
    return session.env.progress["step"][0]


def test_it_plays_what_is_played_without_a_viewer(
    make_session, start, unwatched, wait_until
):
    session = make_session(max_episode_steps=100)
    expected = unwatched(6, max_episode_steps=100)
    session.pause()
    start(session)
    for step in range(1, 7):
        session.step()
        wait_until(lambda step=step: session.reading.time > 0.1 * step - 0.05)
        np.testing.assert_array_equal(positions(session), expected[step])


def test_paused_it_stands_still_and_is_still_drawn(make_session, start, wait_until):
    session, drawn = make_session(max_episode_steps=1000), []
    start(session, lambda: drawn.append(positions(session)))
    wait_until(lambda: session.reading.time > 0.1)
    session.pause()
    time.sleep(0.2)
    before, pictures = positions(session), len(drawn)
    wait_until(lambda: len(drawn) > pictures + 3)
    np.testing.assert_array_equal(positions(session), before)
    time_then = session.reading.time
    session.play()
    wait_until(lambda: session.reading.time > time_then)


def test_a_second_after_a_success_it_moves_on(make_session, start, wait_until):
    session = make_session(max_episode_steps=1000)
    session.moves_on, session.speed = True, FASTEST
    start(session)
    wait_until(lambda: session.reading.episode == 1)
    assert not session.reading.has_ended
    session.moves_on = False
    wait_until(lambda: session.reading.time > 3.0)
    assert session.reading.episode == 1


def test_a_step_is_one_and_pauses(make_session, start, wait_until):
    session = make_session()
    start(session)
    session.step()
    wait_until(lambda: session.is_paused)
    time.sleep(0.2)
    before = steps_done(session)
    session.step()
    session.step()
    wait_until(lambda: steps_done(session) == before + 2)
    time.sleep(0.2)
    assert steps_done(session) == before + 2


def test_reset_starts_the_same_episode_with_the_same_bits(
    make_session, start, wait_until
):
    session = make_session("random")
    session.pause()
    start(session)
    session.next()
    wait_until(lambda: session.reading.episode == 1)
    rows = {}
    for turn in range(2):
        rows[turn] = [positions(session)]
        for step in range(1, 4):
            session.step()
            wait_until(lambda step=step: steps_done(session) == step)
            rows[turn].append(positions(session))
        session.reset()
        wait_until(lambda: session.reading.time == 0)
        assert session.reading.episode == 1
    np.testing.assert_array_equal(rows[0], rows[1])
    assert not np.array_equal(rows[0][0], rows[0][3])


def test_next_starts_the_episode_that_would_follow(
    make_session, make_env, start, wait_until
):
    session, env = make_session(), make_env()
    start(session)
    session.pause()
    session.reset()
    session.next()
    wait_until(lambda: session.reading.episode == 1)
    env.reset(seed=0, episodes=[1])
    np.testing.assert_array_equal(positions(session), env.sim.qpos[0])


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_it_keeps_the_speed(make_session, start, wait_until, speed):
    session = make_session(max_episode_steps=1000)
    session.speed = speed
    start(session)
    wait_until(lambda: session.reading.time > 0)

    def pace():
        started, before = time.perf_counter(), session.reading.time
        time.sleep(1.5)
        return (session.reading.time - before) / (time.perf_counter() - started)

    # It never goes above what is asked. Below it may, while others use the processor.
    paces = [pace()]
    while paces[-1] < 0.3 * speed and len(paces) < 10:
        paces.append(pace())
    assert max(paces) < 1.15 * speed and paces[-1] > 0.3 * speed


@pytest.mark.parametrize("speed", [0.0, SLOWEST / 2, 2 * FASTEST, float("nan")])
def test_a_speed_out_of_bounds_is_refused(make_session, speed):
    with pytest.raises(ValueError, match=r"0.1 to 4.0, got"):
        make_session().speed = speed


def test_a_request_does_not_wait_for_a_slow_step(make_session, start, wait_until):
    session = make_session()
    session.speed = SLOWEST
    start(session)
    time.sleep(0.1)
    started = time.perf_counter()
    session.next()
    wait_until(lambda: session.reading.episode == 1)
    assert time.perf_counter() - started < 0.5  # A step takes a second.


def test_a_pull_moves_what_is_pulled_until_it_is_let_go(
    make_session, start, wait_until
):
    session = make_session("random", max_episode_steps=1000)
    session.pause()
    cube = session.env.model.body("cube/cube").id
    height = session.reading.measures["height"]
    perturb = mujoco.MjvPerturb()
    perturb.select, perturb.active = cube, mujoco.mjtPertBit.mjPERT_TRANSLATE.value
    perturb.refselpos = session.env.facts.cube[0][0] + [0.0, 0.0, 0.5]
    start(session)
    session.perturb = perturb
    for _ in range(15):
        session.step()
    wait_until(lambda: steps_done(session) == 15)
    assert session.reading.measures["height"] > height + 0.3
    assert session.reading.pull > 5.0
    assert ("your pull", f"{session.reading.pull:.1f} N") in session.reading.rows
    assert perturb.localmass == pytest.approx(1.0, rel=1e-3)
    session.perturb = None
    session.step()
    wait_until(lambda: steps_done(session) == 16)
    assert session.reading.pull == 0.0
    assert not session.env.sim.xfrc_applied.any()


def test_let_go_leaves_no_bit_of_the_pull(make_session, unwatched):
    session = make_session()
    expected = unwatched(1)
    perturb = mujoco.MjvPerturb()
    perturb.select = session.env.model.body("cube/cube").id
    session.perturb = perturb  # It is not active.
    session.pause()
    session.step()
    threading.Timer(0.5, session.end).start()
    session.run(lambda: None)
    np.testing.assert_array_equal(positions(session), expected[1])


def test_a_policy_that_fails_is_told_and_may_go_on(make_env, start, wait_until):
    env, calls, warned = make_env(), [], []

    def fail_once(observations):
        calls.append(None)
        if len(calls) == 3:
            raise ZeroDivisionError("no idea")
        return env.expert() if len(calls) != 6 else {"robot_1": np.zeros((1, 8))}

    session = Session(env, fail_once, warned.append)
    start(session)
    wait_until(lambda: session.is_paused)
    assert warned == ["the policy failed: ZeroDivisionError: no idea"]
    assert session.reading.trouble == "ZeroDivisionError: no idea"
    assert session.reading.time == pytest.approx(0.2)
    session.play()
    wait_until(lambda: session.is_paused)
    assert len(calls) == 6 and "got keys ['robot_1']" in warned[1]
    session.reset()
    wait_until(lambda: session.reading.time == 0)
    wait_until(lambda: session.reading.trouble == "")


def test_what_fails_to_draw_ends_it(make_session):
    session = make_session()

    def fail():
        raise ValueError("no picture")

    with pytest.raises(ValueError, match="no picture"):
        session.run(fail)
    session.env.step(session.env.expert())  # It is nobody's any more.


def test_it_plays_up_to_sixteen_worlds(make_env):
    with pytest.raises(ValueError, match="num_envs must be at most 16, got 17"):
        Session(make_env(17), lambda observations: {}, print)


def test_worlds_beside_one_another_go_on_together(make_session, start, wait_until):
    session = make_session(num_envs=3, max_episode_steps=1000)
    session.moves_on = True
    assert [each.episode for each in session.readings] == [0, 1, 2]
    start(session)
    wait_until(lambda: session.readings[0].episode == 3, timeout=30)
    session.pause()
    assert [each.episode for each in session.readings] == [3, 4, 5]
    # It waited until the last of them had met its goal.
    for i in range(3):
        assert any(any(f.readings[i].success.values()) for f in session._previous)
    session.reset()
    wait_until(lambda: session.reading.time == 0)
    assert [each.episode for each in session.readings] == [3, 4, 5]


def test_each_world_is_read_and_pulled_by_itself(make_session, start, wait_until):
    session = make_session("random", num_envs=3, max_episode_steps=1000)
    session.pause()
    session.perturb = mujoco.MjvPerturb()
    session.look(2)
    assert session.perturb is None and session.reading is session.readings[2]
    with pytest.raises(ValueError, match="world must be at most 2, got 3"):
        session.look(3)
    cube = session.env.model.body("cube/cube").id
    perturb = mujoco.MjvPerturb()
    perturb.select, perturb.active = cube, mujoco.mjtPertBit.mjPERT_TRANSLATE.value
    perturb.refselpos = (0.0, 0.0, 3.0)
    session.perturb = perturb
    start(session)
    session.step()
    wait_until(lambda: session.reading.time > 0)
    forces = session.env.sim.xfrc_applied[:, cube, 2]
    assert forces[2] > 0 and not forces[:2].any()


def film_of(session):
    return [frame.readings[0].time for frame in session.film]


@pytest.fixture
def played(make_session, start, wait_until):
    """Return a paused session of which some steps were played."""

    def played(steps, policy="expert", **settings):
        session = make_session(policy, **settings)
        session.pause()
        start(session)
        for _ in range(steps):
            session.step()
        wait_until(lambda: steps_done(session) == steps)
        return session

    return played


def test_the_end_of_an_episode_is_shown_before_the_next_starts(
    make_session, unwatched, start, wait_until
):
    session, shown = make_session(), []
    expected = unwatched(11)  # The episode ends after 12.
    session.speed = FASTEST
    start(session, lambda: shown.append((session.reading, positions(session))))
    wait_until(lambda: session.reading.episode == 1)
    at_end = [at for reading, at in shown if reading.has_ended]
    assert len(at_end) > 5
    assert all(np.array_equal(at, at_end[0]) for at in at_end)
    assert not np.array_equal(at_end[0], expected[11])
    session.back()
    wait_until(lambda: session.reading.has_ended)
    np.testing.assert_array_equal(positions(session), at_end[0])
    assert session.reading.time == pytest.approx(1.2)
    assert session.reading.previous.startswith("episode 0: success after")
    session.step()  # There is no step after the last.
    wait_until(lambda: session.reading.episode == 1)
    assert session.reading.time == 0


def test_an_episode_can_be_gone_back_in_and_goes_on_with_the_same_bits(
    played, unwatched, wait_until
):
    session = played(5, "random")
    expected = unwatched(6, "random")
    filmed = pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    wait_until(lambda: film_of(session) == filmed)
    for step in (2, 4, 0, 3):
        session.seek(step)
        wait_until(lambda step=step: steps_done(session) == step)
        np.testing.assert_array_equal(positions(session), expected[step])
        assert session.reading == session.film[step].readings[0]
    assert len(session.film) == 6  # What was played is kept until time goes on.
    session.step()
    wait_until(lambda: steps_done(session) == 4)
    assert len(session.film) == 5
    session.step()
    session.step()
    wait_until(lambda: steps_done(session) == 6)
    np.testing.assert_array_equal(positions(session), expected[6])


def test_beyond_what_was_played_there_is_its_last_step(played, wait_until):
    session = played(3)
    session.seek(1)
    wait_until(lambda: steps_done(session) == 1)
    session.seek(99)
    wait_until(lambda: steps_done(session) == 3)


def test_back_leads_to_the_end_of_what_was_played_before(played, unwatched, wait_until):
    expected = unwatched(3)
    session = played(3)
    session.next()
    wait_until(lambda: session.reading.episode == 1)
    wait_until(lambda: film_of(session) == [0.0])
    session.back()
    wait_until(lambda: session.reading.episode == 0)
    np.testing.assert_array_equal(positions(session), expected[3])
    session.seek(1)
    wait_until(lambda: steps_done(session) == 1)
    np.testing.assert_array_equal(positions(session), expected[1])
    session.back()  # There is nothing before.
    session.next()
    wait_until(lambda: session.reading.episode == 1)


def test_another_world_and_policy_take_over(played, make_env, wait_until):
    session = played(3)
    other = make_env(seed=5, max_episode_steps=30, auto_reset=False)
    policies = {"robot_1": "idle", "robot_2": "random"}
    session.change(lambda env: (other, load_policy(policies, other), policies), 7, 2)
    wait_until(lambda: session.env is other)
    assert (session.reading.seed, session.reading.episode) == (7, 2)
    assert session.reading.players == {"side_1": "robot_1 idle, robot_2 random"}
    assert session.policies == policies
    session.step()
    # A step is done a moment before it is filmed.
    wait_until(lambda: film_of(session) == pytest.approx([0.0, 0.1]))
    session.back()  # Not to a world that is no more.
    session.step()
    wait_until(lambda: steps_done(session) == 2)


def test_what_cannot_be_loaded_is_told_and_changes_nothing(make_env, start, wait_until):
    env, warned, told = make_env(), [], []
    session = Session(env, load_policy("expert", env), warned.append)
    session.pause()
    start(session, lambda: told.append(session.reading.is_loading))

    def fail(env):
        assert told[-1]
        raise FileNotFoundError("no baseline is shipped")

    session.change(fail, 0, 0)
    wait_until(lambda: session.reading.trouble)
    assert warned == ["the choice failed: FileNotFoundError: no baseline is shipped"]
    assert session.env is env and not session.reading.is_loading
    session.step()
    wait_until(lambda: steps_done(session) == 1)
    wait_until(lambda: session.reading.trouble == "")
