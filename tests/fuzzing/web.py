"""The dashboard's web side in this process, with a node that finds no loop: bytes in, bytes out."""

from __future__ import annotations

import asyncio
import atexit
import logging
from contextlib import ExitStack
from functools import cache

import rclpy
from rclpy.context import Context
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

import fopid_ros.dashboard.node
from fopid_core.study.page.access import Access
from fopid_core.study.page.listening import LARGEST_REQUEST
from fopid_ros.dashboard.web import application

from ..ros.conftest import own_domain

PATIENCE = 5.0
"""[s] for an answer once the other end has said all it has to say."""


class Faults(logging.Handler):
    """Keeps what tornado logs of errors: tracebacks."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.told: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep it."""
        self.told.append(self.format(record))


class Server:
    """The page's server with a token ``t``."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._faults = Faults()
        logging.getLogger("tornado").addHandler(self._faults)
        for name in ("tornado.general", "tornado.access"):
            logging.getLogger(name).propagate = False
        self._loop.run_until_complete(self._start())

    async def _start(self) -> None:
        fopid_ros.dashboard.node.MEETING_TIME = 0.0  # there is nobody to meet
        stack = ExitStack()
        domain, context = stack.enter_context(own_domain()), Context()
        rclpy.init(context=context, domain_id=domain)
        stack.callback(context.try_shutdown)
        atexit.register(stack.close)
        node = fopid_ros.dashboard.node.DashboardNode(context=context)
        self._server = HTTPServer(
            application(node, Access("t")), max_body_size=LARGEST_REQUEST, max_header_size=LARGEST_REQUEST,
            idle_connection_timeout=1.0, body_timeout=1.0,
        )  # fmt: skip
        sockets = bind_sockets(0, "127.0.0.1")
        self._port = sockets[0].getsockname()[1]
        self._server.add_sockets(sockets)

    def answer(self, case: bytes) -> bytes:
        """What the server sends to somebody who sends this and then nothing more."""
        told = self._loop.run_until_complete(self._exchange(case))
        assert not self._faults.told, self._faults.told.pop()
        return told

    async def _exchange(self, case: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        try:
            writer.write(case)
            writer.write_eof()
            return await asyncio.wait_for(reader.read(), PATIENCE)
        except ConnectionError:  # the server had heard enough
            return b""
        finally:
            writer.close()


@cache
def _server() -> Server:
    return Server()


def answer(case: bytes) -> bytes:
    """What the page's server answers."""
    return _server().answer(case)
