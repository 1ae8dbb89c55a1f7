"""The call that shows a policy at work, in real time."""

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import how_to_install
from collaborative_gym.policies import AnyPolicy, as_played, as_policy
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task
from collaborative_gym.viewer.session import Session


def view(
    env: str | Task,
    say: Callable[[str], object],
    *,
    warn: Callable[[str], object],
    policy: AnyPolicy = "expert",
    any_env: bool = False,
    seed: int = 0,
    web: bool = False,
    address: tuple[str, int] = ("127.0.0.1", 8080),
) -> None:
    """Show a policy in one episode after the other, until the viewer is closed.

    It shows in a window, or else on a web page. The page's server has no password:
    whoever reaches it may watch and control.

    Args:
      env: an environment id, a task's name, or a task.
      say: called with news for the user, such as where the page is.
      warn: called with what should alarm the user, such as that the policy failed.
      policy: as `evaluate` takes it.
      any_env: whether a trained policy may play another environment than its own.
      seed: of the episodes.
      web: whether to show a page even if a window can be opened.
      address: host and port of the page's server; if the port is in use, the next free
        one is taken.

    Raises:
      ImportError: if a page is needed and the extra `view` is not installed.
      KeyError: if a name is unknown.
      OSError: if the server cannot listen there.
    """
    task = as_played(as_task(env), policy)
    say(f"building the world of {task.name} ...")
    world = VectorEnv(task, 1, seed=seed, num_threads=1, auto_reset=False)
    with closing(world):
        act = as_policy(policy, world, any_env=any_env)
        is_shared = not isinstance(policy, Mapping)
        policies = dict.fromkeys(world.agents, policy) if is_shared else policy
        session = Session(world, act, warn, policies=policies, moves_on=True)
        face: Any = None
        if not web:
            # Imported here because a page needs no windowing system.
            from collaborative_gym.viewer.window import Window

            try:
                face = Window(session)
            except RuntimeError as error:
                say(f"{error}; showing it in the browser instead")
        if face is None:
            face = _page(session, any_env, *address)
            if face.is_public:
                warn(
                    f"WARNING: the viewer listens on {address[0]}. Everyone who"
                    " reaches this machine can watch and control it; there is no"
                    " password."
                )
            say(f"open {face.url} in a browser; Ctrl-C ends it")
        with closing(face):
            session.run(face.refresh)


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
