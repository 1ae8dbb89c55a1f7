"""The call that shows a policy at work, in real time."""

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_count, how_to_install
from collaborative_gym.policies import AnyPolicy, as_played, as_policy
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task
from collaborative_gym.viewer.session import MOST_WORLDS, Session

HERE = ("127.0.0.1", 8080)
"""Host and port of a page's server, unless others are given."""


def view(
    env: str | Task,
    say: Callable[[str], object],
    *,
    warn: Callable[[str], object],
    policy: AnyPolicy = "expert",
    any_env: bool = False,
    seed: int = 0,
    num_envs: int = 1,
    address: tuple[str, int] | None = None,
) -> None:
    """Show a policy in one episode after the other, until the viewer is closed.

    It shows in a window; or on a web page, if no window can be opened, an address is
    given or there are several worlds. The page's server has no password: whoever
    reaches it may watch and control.

    Args:
      env: an environment id, a task's name, or a task.
      say: called with news for the user, such as where the page is.
      warn: called with what should alarm the user, such as that the policy failed.
      policy: as `evaluate` takes it.
      any_env: whether a trained policy may play another environment than its own.
      seed: the episodes' seed.
      num_envs: how many worlds to show beside one another, up to 16.
      address: host and port of the page's server, at first 127.0.0.1 and 8080; if the
        port is in use, the next free one is taken.

    Raises:
      ImportError: if a page is needed and the extra `view` is not installed.
      KeyError: if a name is unknown.
      OSError: if the server cannot listen there.
      ValueError: if there are too many worlds.
    """
    check_count("num_envs", num_envs, 1, MOST_WORLDS)
    check_count("port", (address or HERE)[1], 0, 65535)
    task = as_played(as_task(env), policy)
    say(f"building the world of {task.name} ...")
    world = VectorEnv(task, num_envs, seed=seed, num_threads=1, auto_reset=False)
    with closing(world):
        act = as_policy(policy, world, any_env=any_env)
        is_shared = not isinstance(policy, Mapping)
        policies = dict.fromkeys(world.agents, policy) if is_shared else policy
        session = Session(world, act, warn, policies=policies, moves_on=True)
        face: Any = None
        if address is None and num_envs == 1:
            # Imported here because a page needs no windowing system.
            from collaborative_gym.viewer.window import Window

            try:
                face = Window(session)
            except RuntimeError as error:
                say(f"{error}; showing it in the browser instead")
        is_page, (host, port) = face is None, address or HERE
        if is_page:
            face = _page(session, any_env, host, port)
        # A signal may come as soon as a user knows the address.
        with closing(face):
            if is_page and face.is_public:
                warn(
                    f"WARNING: the viewer listens on {host}. Everyone who reaches this"
                    " machine can watch and control it; there is no password."
                )
            if is_page:
                say(_invitation(face.url, port))
            session.run(face.refresh)


def _invitation(url: str, port: int) -> str:
    taken = f"port {port} is in use; " * (port > 0 and not url.endswith(f":{port}"))
    return f"{taken}open {url} in a browser; Ctrl-C ends it"


def _page(session: Session, any_env: bool, host: str, port: int) -> Any:
    """Return a page's server.

    Raises:
      ImportError: if the extra `view` is not installed; says how to.
    """
    try:
        from collaborative_gym.viewer.menu import Menu
        from collaborative_gym.viewer.web import Page
    except ImportError as error:
        raise ImportError(
            f"the viewer in the browser needs {error.name}, which is not installed;"
            f" {how_to_install('view')}, or make a video instead:"
            " collaborative-gym record ENV --output video.mp4"
        ) from error
    menu = Menu(session.env, session.policies, any_env=any_env)
    return Page(session, menu, host, port)
