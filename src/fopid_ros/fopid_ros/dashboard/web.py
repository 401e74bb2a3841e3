"""The dashboard's web side: files, a WebSocket that tells what happens, and requests that change something.

``GET /`` and its files and the WebSocket ``/live`` are for everybody whom the rules of access let in;
``POST /api/...`` takes a JSON object and needs the token.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from tornado.httputil import HTTPServerRequest
from tornado.web import Application, RequestHandler

from fopid_core.errors import InputError
from fopid_core.study.page.access import Access
from fopid_core.study.page.files import FileHandler, shared_files
from fopid_core.study.page.guarded import Guarded, json_object
from fopid_core.study.page.listening import LARGEST_REQUEST
from fopid_ros.dashboard.live import PING_PERIOD, LiveHandler
from fopid_ros.dashboard.node import DashboardNode
from fopid_ros.dashboard.remote_parameters import RefusedError

Change = Callable[[Mapping[str, Any]], Awaitable[str]]


class ChangeHandler(Guarded):
    """Asks the node for a change and answers with its one line."""

    async def post(self, name: str) -> None:
        """Answer 200 when done, 400 for bad input, 401 without the token, 409 with the reason of a refusal."""
        changes: Mapping[str, Change] = self.settings["changes"]
        if not self.access.allows_change(self.request.headers.get("Authorization", "")):
            self._answer(401, "the token is missing or wrong")
        elif name not in changes:
            self._answer(404, f"{name!r}; allowed: {', '.join(changes)}")
        else:
            await self._change(changes[name])

    async def _change(self, change: Change) -> None:
        try:
            self._answer(200, await change(json_object(self.request.body)))
        except InputError as error:
            self._answer(400, str(error))
        except RefusedError as error:
            self._answer(409, str(error))

    def _answer(self, status: int, message: str) -> None:
        self.set_status(status)
        self.write({"message": message})


def application(node: DashboardNode, access: Access) -> Application:
    """The web application of a node."""

    async def nothing(_: Mapping[str, Any]) -> str:
        return "the token is right"

    async def say(fields: Mapping[str, Any]) -> str:
        return await node.publish_signal(str(fields.get("signal")), fields.get("value"))

    async def roll_back(_: Mapping[str, Any]) -> str:
        return await node.roll_back()

    changes: dict[str, Change] = {
        "token": nothing,
        "parameters": node.set_parameters_of_controller,
        "rollback": roll_back,
        "tune": node.tune,
        "signal": say,
    }

    def log(handler: RequestHandler) -> None:
        request: HTTPServerRequest = handler.request
        node.get_logger().debug(f"{handler.get_status()} {request.method} {request.path} {request.remote_ip}")

    static = Path(str(resources.files("fopid_ros.dashboard"))) / "static"
    return Application(
        [
            (r"/live", LiveHandler),
            (r"/api/(\w+)", ChangeHandler),
            *shared_files(),
            (r"/(.*)", FileHandler, {"path": static, "default_filename": "index.html"}),
        ],
        access=access,
        node=node,
        changes=changes,
        log_function=log,
        websocket_ping_interval=PING_PERIOD,
        websocket_ping_timeout=PING_PERIOD,
        websocket_max_message_size=LARGEST_REQUEST,
    )
