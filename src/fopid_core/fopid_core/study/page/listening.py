"""Where a page's server listens, how much it takes, and the address that is printed."""

from __future__ import annotations

import socket

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application

from fopid_core.errors import InputError

LARGEST_REQUEST = 20_000  # bytes
IDLE_TIME = 30.0  # [s] for which a connection may be silent between requests, and within one
EVERYWHERE = ("", "0.0.0.0", "::")


def http_server(application: Application, largest_request: int = LARGEST_REQUEST) -> HTTPServer:
    """A server that neither waits for the slow nor stores what is large."""
    return HTTPServer(
        application,
        max_body_size=largest_request,
        max_header_size=LARGEST_REQUEST,
        idle_connection_timeout=IDLE_TIME,
        body_timeout=IDLE_TIME,
    )


def listening_sockets(host: str, port: int) -> list[socket.socket]:
    """Sockets that listen.

    Raises
    ------
    InputError
        If the port is taken, or the host is no address of this machine.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port = {port}; allowed: 0 to 65535")
    try:
        return bind_sockets(port, host)
    except socket.gaierror as error:
        raise InputError(f"host = {host!r}: {error.strerror}; allowed: an address of this machine") from None
    except OSError as error:
        raise InputError(
            f"host = {host!r}, port = {port}: {error.strerror}; allowed: a free port of this machine, 0 to choose one"
        ) from None


def page_address(host: str, port: int, token: str | None) -> str:
    """The page's address; the token stands where browsers do not send it.

    Examples
    --------
    >>> page_address("127.0.0.1", 8077, "a-secret")
    'http://127.0.0.1:8077/#token=a-secret'
    """
    name = "127.0.0.1" if host in EVERYWHERE else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/{f'#token={token}' if token else ''}"
