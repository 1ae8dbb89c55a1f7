"""Threads, forks, and what fails in the middle of a call."""

import os
import threading

import numpy as np
import pytest

import collaborative_gym as cg

LENGTH = 12


def in_thread(call):
    """Return what a call gives, or raises, in a thread of its own."""
    given = []

    def run():
        try:
            given.append(call())
        except Exception as error:  # handed on to the test
            given.append(error)

    thread = threading.Thread(target=run, name="visitor")
    thread.start()
    thread.join()
    return given[0]


@pytest.mark.parametrize(
    "call",
    [
        lambda env: env.step(env.idle()),
        lambda env: env.reset(),
        lambda env: env.render(width=32, height=24),
        lambda env: env.get_state(),
        lambda env: env.expert(),
        lambda env: env.close(),
    ],
    ids=["step", "reset", "render", "get_state", "expert", "close"],
)
def test_another_thread_is_told_that_one_is_inside(make_env, call, assert_same):
    env, plain = make_env(2), make_env(2)
    for each in (env, plain):
        each.reset(seed=0)
    found = []
    env.watch(lambda: found.append(in_thread(lambda: call(env))))
    env.step(env.idle())
    env.watch(None)
    plain.step(plain.idle())
    (error,) = found
    assert isinstance(error, RuntimeError)
    assert "thread 'MainThread' is inside this environment" in str(error)
    assert_same(env.get_state(), plain.get_state())


def test_threads_may_take_turns(make_env, assert_same):
    env, plain = make_env(2), make_env(2)
    for each in (env, plain):
        each.reset(seed=0)
    in_thread(lambda: env.step(env.idle()))
    plain.step(plain.idle())
    assert_same(env.get_state(), plain.get_state())


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("call", ["reset", "step", "render", "get_state", "close"])
def test_a_forked_child_is_told_so(make_env, call):
    env = make_env(3, num_threads=2)
    env.reset(seed=0)
    arguments = (env.idle(),) if call == "step" else ()
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            getattr(env, call)(*arguments)
            message = "nothing was raised"
        except BaseException as error:
            message = str(error)
        os.write(writing, message.encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        told = pipe.read()
    os.waitpid(child, 0)
    assert "belongs to the process that made it" in told
    assert "'spawn'" in told
    env.step(env.idle())


@pytest.mark.parametrize("strain", [False, True])
@pytest.mark.parametrize("shot", [1, 3, 10])
def test_a_watcher_that_raises_leaves_the_worlds_as_they_were(
    make_env, shot, strain, assert_same
):
    task = make_env().task
    env, plain = (cg.VectorEnv(task, 2, strain=strain) for _ in range(2))
    for each in (env, plain):
        each.reset(seed=0)
        each.step(each.expert())
    seen = []

    def watcher():
        seen.append(0)
        if len(seen) == shot:
            raise KeyboardInterrupt

    before = env.get_state()
    env.watch(watcher, shots=10)
    with pytest.raises(KeyboardInterrupt):
        env.step(env.expert())
    assert_same(env.get_state(), before)
    env.watch(None)
    for _ in range(LENGTH):
        seen, expected = env.step(env.expert())[0], plain.step(plain.expert())[0]
        np.testing.assert_array_equal(seen["robot_1"], expected["robot_1"])
    assert_same(env.get_state(), plain.get_state())


def test_a_watcher_may_draw_but_not_step(make_env):
    env = make_env(1)
    env.reset(seed=0)
    env.watch(lambda: env.render(width=32, height=24))
    env.step(env.idle())
    for call in (lambda: env.step(env.idle()), env.reset):
        env.watch(call)
        with pytest.raises(RuntimeError, match="in the middle of a step; a watcher"):
            env.step(env.idle())
    env.watch(None)
    assert env.step(env.idle())[-1]["step"].tolist() == [2]


@pytest.mark.parametrize("method", ["disturb", "measure", "reward", "success", "reset"])
def test_a_task_that_fails_leaves_the_worlds_as_they_were(
    make_env, monkeypatch, method, assert_same
):
    env = make_env(3)
    env.reset(seed=0)
    for _ in range(LENGTH - 1):
        env.step(env.idle())
    before = env.get_state()

    def fail(*_, **__):
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(env.task, method, fail)
        with pytest.raises(ZeroDivisionError):
            env.step(env.idle())
        assert_same(env.get_state(), before)
    assert env.step(env.idle())[-1]["ended"].all()


@pytest.mark.parametrize(
    "call",
    [
        lambda env, state: env.reset(),
        lambda env, state: env.reset(seed=5, episodes=[7], env_ids=[2]),
        lambda env, state: env.set_state(state),
        lambda env, state: env.set_state(state, [1, 0, 2]),
    ],
    ids=["reset", "reset one", "set_state", "set_state in others"],
)
def test_a_reset_that_fails_at_its_end_leaves_the_worlds_as_they_were(
    make_env, monkeypatch, call, assert_same
):
    env = make_env(3)
    env.reset(seed=0)
    state = env.get_state()
    for _ in range(LENGTH // 2):
        env.step(env.expert())
    before = env.get_state()

    def fail(*_, **__):
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(env.task, "observe", fail)
        with pytest.raises(ZeroDivisionError):
            call(env, state)
    assert_same(env.get_state(), before)


def test_any_thread_may_draw_in_its_turn(make_env):
    env = make_env(1)
    env.reset(seed=0)

    def draw():
        return env.render(width=32, height=24)

    draw()
    picture = draw()
    np.testing.assert_array_equal(in_thread(draw), picture)
    assert in_thread(env.close) is None
