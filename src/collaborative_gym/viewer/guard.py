"""A page's server. It answers no other page, and takes only its users' input."""

import asyncio
import errno
import html
import ipaddress
import logging
import re
import socket
import threading
from collections.abc import Callable
from http import HTTPStatus
from typing import Annotated, Any, Literal

import msgspec
import viser
from websockets.asyncio import server as websockets
from websockets.http11 import Request, Response

from collaborative_gym.viewer.session import MOST_WORLDS

_PROTOCOL = f"viser-v{viser.__version__}"
"""The WebSocket protocol by which viser's own page talks to it."""

_LARGEST = 2**14
"""Size of the largest message that is read, in bytes; a tab's have some hundred."""

_MOST = 64
"""How many connections may be open; a tab has one, and some while it loads. Beyond it,
one that has asked for nothing yet makes room."""

_FAR = 1e3  # bound of a mouse's and a camera's place, in m
_PIXELS = 2**16  # bound of places and sizes on a screen, in pixels

_HOST = re.compile(r"(?:\[(.+)\]|([^:\[\]]+))(?::\d+)?", re.ASCII)
"""A request's `Host`: an IPv6 address in brackets, or else a name, and a port."""

_HEAD = """<!doctype html><title>Collaborative Gym</title>
<meta name=viewport content=width=device-width>
<style>body { font: 1.1em sans-serif; max-width: 40em; margin: 3em auto }</style>
<h1>This link does not open</h1>
"""
"""Beginning of the page that says what is wrong with a link, on a phone, too."""

_LAST_PORT = 65535  # the greatest port

_LOGGER = logging.getLogger(__name__)
_LOGGER.addHandler(logging.NullHandler())  # Who scans ports must not fill a terminal.

_starting = threading.Lock()


def start_server(
    host: str, port: int, *, links: str, on_link: Callable[[str], Callable[[], object]]
) -> viser.ViserServer:
    """Return a server that listens at an address, and answers its own pages alone.

    A web page may send requests to every server that its reader's browser reaches. So
    all are refused, with status 403, unless `Host` is a name of this server, and
    `Origin`, which browsers send with each WebSocket, is the same. Messages that no
    page of ours sends are dropped. The names are `localhost`, loopback addresses and
    `host`; where other machines reach it also this machine's name and all numeric
    addresses, which no foreign page can turn to another machine as it can a name.

    A link is a path of the page, which begins with `links`, that says what to show. It
    takes effect only when the page connects by the same path: a mere request, which
    other pages can cause, changes nothing. `on_link` returns a function that shows a
    link; it raises a KeyError or ValueError for one that cannot be shown.

    Raises:
      RuntimeError: if the installed viser would start its server unguarded.
    """
    guard = _Guard(host, links, on_link)
    # viser has no option for this, and listens as soon as it is made.
    with _starting:
        unguarded, websockets.serve = websockets.serve, guard.serve
        try:
            server = viser.ViserServer(host, port, verbose=False)
        finally:
            websockets.serve = unguarded
    if not guard.has_served:
        server.stop()
        raise RuntimeError(
            f"viser {viser.__version__} cannot be guarded from foreign pages; install"
            " the version that this package was tested with: pip install viser==1.1.1"
        )
    guard.gui = server.gui
    return server


class _Guard:
    """The guard of one server against strangers; `gui` are the inputs of its pages."""

    def __init__(
        self, host: str, links: str, on_link: Callable[[str], Callable[[], object]]
    ):
        self.has_served = False
        self.gui: viser.GuiApi | None = None
        self._links, self._on_link = links, on_link
        self._is_public = not is_loopback(host)
        self._names = {"localhost", host.lower()}
        if self._is_public:
            name = socket.gethostname().lower()
            self._names |= {name, f"{name}.local"}
        self._open = 0
        self._silent: dict[asyncio.Transport, None] = {}

    def serve(
        self,
        *arguments: Any,
        process_request: Callable[..., Response | None] = lambda *_: None,
        **settings: Any,
    ) -> websockets.serve:
        """Serve as viser asks for with `websockets.serve`, but guarded."""
        self.has_served = True

        def answer(connection: Any, request: Request) -> Response | None:
            self._silent.pop(connection.transport, None)
            refusal = self._refuse(connection, request)
            if refusal is None and request.path.startswith(self._links):
                refusal = self._follow(connection, request)
            try:
                response = refusal or process_request(connection, request)
            except (OSError, ValueError):  # No file can have such a name.
                response = connection.respond(HTTPStatus.NOT_FOUND, "NOT FOUND\n")
            if response is not None:
                # Nor may a foreign page show ours, and lead its reader's clicks to it.
                response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            return response

        class Connection(_Connection):
            guard = self

        settings |= {"max_size": _LARGEST, "logger": _LOGGER}
        settings |= {"process_request": answer, "create_connection": Connection}
        return _serve(*arguments, **settings)

    def enter(self, transport: asyncio.Transport) -> None:
        """Count a connection in, and end one if there are too many.

        That is the oldest without a request: a program that opens many and keeps silent
        does not lock tabs out. Where all are tabs, it is the new one.
        """
        self._open += 1
        self._silent[transport] = None
        if self._open > _MOST:
            oldest = next(iter(self._silent))
            del self._silent[oldest]
            oldest.abort()

    def leave(self, transport: asyncio.Transport) -> None:
        """Count a connection out."""
        self._open -= 1
        self._silent.pop(transport, None)

    def takes(self, sent: "_Input | _Drag | _Camera") -> bool:
        """Return whether a message fits the inputs of the page."""
        if not isinstance(sent, _Input):
            return True
        inputs = getattr(self.gui, "_gui_input_handle_from_uuid", {})
        own = inputs.get(sent.uuid)
        return own is not None and all(
            _fits(own, each) for each in sent.updates.values()
        )

    def _follow(self, connection: Any, request: Request) -> Response | None:
        """Show a link once a page connects by it; refuse all else."""
        try:
            show = self._on_link(request.path)
        except (KeyError, ValueError) as error:
            said = f'<p>{html.escape(str(error))}<p><a href="/">To the viewer</a>\n'
            response = connection.respond(HTTPStatus.NOT_FOUND, _HEAD + said)
            del response.headers["Content-Type"]
            response.headers["Content-Type"] = "text/html; charset=utf-8"
            return response
        if "Upgrade" in request.headers:
            show()
        request.path = "/"
        return None

    def _refuse(self, connection: Any, request: Request) -> Response | None:
        hosts = [host.lower() for host in request.headers.get_all("Host")]
        origins = [origin.lower() for origin in request.headers.get_all("Origin")]
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return connection.respond(
                HTTPStatus.FORBIDDEN,
                "This viewer does not answer to that name; open the address that it"
                " printed, or start it with --host NAME.\n",
            )
        if origins not in ([], [f"http://{hosts[0]}"]):
            return connection.respond(
                HTTPStatus.FORBIDDEN, "This viewer answers its own page alone.\n"
            )
        protocols = request.headers.get_all("Sec-WebSocket-Protocol")
        if "Upgrade" in request.headers and protocols != [_PROTOCOL]:
            return connection.respond(
                HTTPStatus.BAD_REQUEST, "This page is of another version; reload it.\n"
            )
        return None

    def _is_ours(self, host: str) -> bool:
        """Return whether a request's `Host` is a name of this server."""
        parts = _HOST.fullmatch(host)
        if parts is None:
            return False
        name = parts[1] or parts[2]
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return self._is_public or address.is_loopback or name in self._names


class _Connection(websockets.ServerConnection):
    """A connection that reads only the messages of our pages."""

    guard: _Guard

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.guard.enter(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self.guard.leave(self.transport)
        super().connection_lost(exc)

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message that makes sense, and drop those before it."""
        while True:
            message = await super().recv(decode=False)
            try:
                sent = _READER.decode(message)
            except ValueError:
                continue
            if self.guard.takes(sent):
                # Once it is written again, viser can read it in one way only.
                return _WRITER.encode(sent)


_serve = websockets.serve

_Metres = Annotated[float, msgspec.Meta(ge=-_FAR, le=_FAR)]
_Place = tuple[_Metres, _Metres, _Metres]
_Pixels = Annotated[float, msgspec.Meta(ge=-_PIXELS, le=_PIXELS)]
_Size = Annotated[int, msgspec.Meta(ge=0, le=_PIXELS)]
_Part = Annotated[float, msgspec.Meta(ge=-1.01, le=1.01)]
_World = Annotated[int, msgspec.Meta(ge=0, lt=MOST_WORLDS)]
_Text = Annotated[str, msgspec.Meta(max_length=200)]


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message from a page, as viser names and reads it."""


class _Input(_Message, tag="GuiUpdateMessage"):
    """A click, a tick, a number or one of the names that are offered."""

    uuid: _Text
    updates: dict[Literal["value"], bool | float | _Text]


class _Drag(_Message, tag="SceneNodeDragMessage"):
    """A mouse or a finger that pulls."""

    phase: Literal["start", "update", "end"]
    name: _Text
    instance_index: _World
    start_position: _Place
    start_screen_pos: tuple[_Pixels, _Pixels]
    end_position: _Place
    end_screen_pos: tuple[_Pixels, _Pixels]
    button: Literal["left"]
    modifier: Literal["cmd/ctrl"] | None
    owner: Literal[""] = ""


class _Camera(_Message, tag="ViewerCameraMessage"):
    """The view of a tab; by its first one viser knows that the tab is there."""

    wxyz: tuple[_Part, _Part, _Part, _Part]
    position: _Place
    fov: _Metres
    near: _Metres
    far: _Metres
    image_height: _Size
    image_width: _Size
    look_at: _Place
    up_direction: _Place

    def __post_init__(self) -> None:
        # A page that is hidden, or not yet laid out, has no height.
        self.image_height = max(1, self.image_height)
        self.image_width = max(1, self.image_width)


def _fits(own: Any, value: bool | float | str) -> bool:
    if isinstance(own, viser.GuiDropdownHandle | viser.GuiButtonGroupHandle):
        return value in own.options
    if isinstance(own, viser.GuiSliderHandle):
        return not isinstance(value, bool | str) and own.min <= value <= own.max
    return isinstance(value, bool)


_READER = msgspec.msgpack.Decoder(_Input | _Drag | _Camera)
_WRITER = msgspec.msgpack.Encoder()


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address."""
    found = socket.getaddrinfo(host, None)
    return all(ipaddress.ip_address(where[0]).is_loopback for *_, where in found)


def name_for_browser(host: str) -> str:
    """Return an address as a browser on this machine wants it."""
    if host in ("0.0.0.0", "::"):
        return "localhost"
    return f"[{host}]" if ":" in host else host


def free_port(host: str, port: int) -> int:
    """Return the first port from this one on where nobody listens; 0 stays 0.

    Raises:
      OSError: if it cannot listen there, other than because somebody does.
      ValueError: if there is no such port, or this machine does not have the address.
    """
    if not 0 <= port <= _LAST_PORT:
        raise ValueError(f"port must be between 0 and {_LAST_PORT}, got {port}")
    for candidate in range(port, _LAST_PORT + 1):
        try:
            family, *_, address = socket.getaddrinfo(host, candidate)[0]
            socket.create_server(address, family=family).close()
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                continue
            fault = f"cannot listen on {host}, port {candidate}: {error.strerror}"
            is_foreign = error.errno == errno.EADDRNOTAVAIL
            if is_foreign or isinstance(error, socket.gaierror):
                raise ValueError(f"{fault}; give an address of this machine") from error
            raise OSError(fault) from error
        return candidate
    raise OSError(f"all ports of {host} from {port} on are taken")
