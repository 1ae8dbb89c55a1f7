"""Where a server listens."""

import errno
import ipaddress
import socket

_LAST_PORT = 65535


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
            told = f"cannot listen on {host}, port {candidate}: {error.strerror}"
            is_foreign = error.errno == errno.EADDRNOTAVAIL
            if is_foreign or isinstance(error, socket.gaierror):
                raise ValueError(f"{told}; give an address of this machine") from error
            raise OSError(told) from error
        return candidate
    raise OSError(f"all ports of {host} from {port} on are taken")
