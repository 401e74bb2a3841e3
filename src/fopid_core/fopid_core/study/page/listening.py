"""Where a page's server listens, how much it takes, and the address that is printed."""

from __future__ import annotations

import socket
from typing import Any

from tornado.http1connection import HTTP1ServerConnection
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application

from fopid_core.errors import InputError

LARGEST_REQUEST = 20_000  # bytes
IDLE_TIME = 30.0  # [s] for which a connection may be silent between requests, and within one
MOST_CONNECTIONS = 128  # WebSockets not counted: those have a limit of their own
EVERYWHERE = ("", "0.0.0.0", "::")


class RoomyServer(HTTPServer):
    """Has room for a newcomer: where too many wait, the one that has waited longest goes.

    Without a limit the process runs out of files, can accept nobody, and logs that as fast as it can.
    """

    def initialize(self, *args: Any, **kwargs: Any) -> None:
        super().initialize(*args, **kwargs)
        self._waiting: dict[HTTP1ServerConnection, None] = {}  # the one that was heard of first comes first

    def start_request(self, server_conn: Any, request_conn: Any) -> Any:
        """A connection is new, or waits for its next request."""
        self._waiting.pop(server_conn, None)
        self._waiting[server_conn] = None
        if len(self._waiting) > MOST_CONNECTIONS:
            longest = next(iter(self._waiting))
            del self._waiting[longest]
            longest.stream.close()
        return super().start_request(server_conn, request_conn)

    def on_close(self, server_conn: Any) -> None:
        """It is closed, or a WebSocket now."""
        self._waiting.pop(server_conn, None)
        super().on_close(server_conn)


def http_server(application: Application, largest_request: int = LARGEST_REQUEST) -> HTTPServer:
    """A server that neither waits for the slow nor stores what is large."""
    return RoomyServer(
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
