"""A web page onto a session: the world, the controls and the measures."""

import io
from collections.abc import Callable
from contextlib import redirect_stdout

import numpy as np
import viser

from collaborative_gym.viewer.guard import (
    free_port,
    is_loopback,
    name_for_browser,
    start_server,
)
from collaborative_gym.viewer.menu import LINK, Menu
from collaborative_gym.viewer.panel import Panel
from collaborative_gym.viewer.session import Session
from collaborative_gym.viewer.stage import Stage


class Page:
    """A web server whose page shows a session and passes on what its users do.

    Any number of browsers may watch; they share the controls. Where the port is taken,
    or 0, it listens on the next one that is free.

    Attributes:
      url: of the page.
      is_public: whether other machines may reach it.

    Raises:
      OSError: if it cannot listen there.
      RuntimeError: if the installed viser cannot be guarded from foreign pages.
      ValueError: if the world has something that the page cannot draw.
    """

    def __init__(self, session: Session, menu: Menu, host: str, port: int):
        port = free_port(host, port)
        self._session, self._menu = session, menu
        self._eyes: dict[int, np.ndarray] = {}  # where tabs were placed, by their ids
        with redirect_stdout(io.StringIO()):  # It announces itself.
            self._server = start_server(host, port, links=LINK, on_link=self._open)
        self.is_public = not is_loopback(host)
        self.url = f"http://{name_for_browser(host)}:{self._server.get_port()}"
        try:
            self._panel = Panel(self._server, session, menu, on_view=self._look)
            self._set_stage()
        except BaseException:
            self.close()
            raise
        self._server.on_client_connect(self._join)

    def refresh(self) -> None:
        """Bring all pages up to date. Only the session's thread may call this."""
        if self._stage.env is not self._session.env:
            self._set_stage()
            self._look(self._panel.view)
        self._stage.refresh(**self._panel.looks)
        self._panel.refresh()

    def close(self) -> None:
        """Stop the server and leave all pages."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    def _set_stage(self) -> None:
        self._stage = Stage(self._server, self._session)
        self._panel.offer_views(self._stage.views)

    def _look(self, view: str) -> None:
        for client in self._server.get_clients().values():
            self._eyes[client.client_id] = self._stage.stand(client, view)

    def _join(self, client: viser.ClientHandle) -> None:
        """Place a new tab's camera, and again when its picture gets another shape.

        The first size of a tab may be that of a page not yet laid out. A tab may also
        take the first camera of all tabs after its own. What a user has moved stays.
        """
        if client.client_id not in self._server.get_clients():
            return  # It has left already.
        aspect = client.camera.aspect
        number = client.client_id
        self._eyes[number] = self._stage.stand(client, self._panel.view)

        async def follow(camera: viser.CameraHandle) -> None:
            nonlocal aspect
            eye = self._eyes[number]
            first = self._server.initial_camera.position
            is_placed = np.allclose(camera.position, eye, atol=0.01)
            is_first = np.allclose(camera.position, first, atol=0.01)
            has_new_shape = not np.isclose(camera.aspect, aspect, rtol=0.01)
            if has_new_shape if is_placed else is_first:
                aspect = camera.aspect
                self._eyes[number] = self._stage.stand(client, self._panel.view)

        client.camera.on_update(follow)

    def _open(self, link: str) -> Callable[[], object]:
        choice = self._menu.read(link)
        return lambda: self._panel.play(choice)
