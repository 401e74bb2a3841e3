"""The dashboard's web side: files, a WebSocket that tells what happens, and requests that change something.

``GET /`` and its files and the WebSocket ``/live`` are for everybody whom the rules of access let in;
``POST /api/...`` takes a JSON object and needs the token.
"""

from __future__ import annotations

import asyncio
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
from fopid_ros.common.parameter_file import parameter_text
from fopid_ros.dashboard.live import PING_PERIOD, LiveHandler
from fopid_ros.dashboard.node import DashboardNode
from fopid_ros.dashboard.remote_parameters import RefusedError

Change = Callable[[Mapping[str, Any]], Awaitable[str | dict[str, Any]]]


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

    def _answer(self, status: int, said: str | dict[str, Any]) -> None:
        self.set_status(status)
        self.write({"message": said} if isinstance(said, str) else said)


class ParametersHandler(Guarded):
    """All parameters of controller, tuner and plant."""

    async def get(self) -> None:
        """Answer with them by node."""
        self.write(await self.settings["node"].all_parameters())


class ParameterFileHandler(Guarded):
    """The same as a file that a start with ``--params-file`` reads."""

    async def get(self) -> None:
        """Answer with the file."""
        nodes = (await self.settings["node"].all_parameters()).values()
        self.set_header("Content-Type", "application/yaml; charset=utf-8")
        self.set_header("Content-Disposition", 'attachment; filename="fopid_parameters.yaml"')
        self.write("".join(
            parameter_text(one["name"], {each["name"]: _value(each) for each in one["parameters"]})
            for one in nodes if one["parameters"] is not None
        ))  # fmt: skip


def _predicted(fields: Mapping[str, Any]) -> dict[str, Any]:
    from fopid_core.study.page.prediction import answer  # scipy is loaded when somebody moves a slider

    try:
        return answer(fields)
    except InputError as error:  # a number that is being typed is no fault, and no error in a browser's console
        return {"refused": str(error)}


def _value(told: Mapping[str, Any]) -> Any:
    return float(told["value"]) if told["type"] == "double" else told["value"]


def application(node: DashboardNode, access: Access) -> Application:
    """The web application of a node."""

    async def nothing(_: Mapping[str, Any]) -> str:
        return "the token is right"

    async def say(fields: Mapping[str, Any]) -> str:
        return await node.publish_signal(str(fields.get("signal")), fields.get("value"))

    async def roll_back(_: Mapping[str, Any]) -> str:
        return await node.roll_back()

    async def predict(fields: Mapping[str, Any]) -> dict[str, Any]:
        return await asyncio.to_thread(_predicted, fields)

    async def bring_back(fields: Mapping[str, Any]) -> str:
        return await node.bring_back(fields.get("number"))

    async def cancel(_: Mapping[str, Any]) -> str:
        return await node.autotuning.cancel()

    async def reject(_: Mapping[str, Any]) -> str:
        return node.autotuning.reject()

    async def save(_: Mapping[str, Any]) -> str:
        return await node.save_gains()

    changes: dict[str, Change] = {
        "token": nothing,
        "parameters": node.set_parameters_of_controller,
        "rollback": roll_back,
        "gain_set": bring_back,
        "tune": node.tune,
        "autotune": node.start_autotuning,
        "plan": node.plan_autotuning,
        "cancel": cancel,
        "reject": reject,
        "parameter": node.set_parameter,
        "predict": predict,
        "save": save,
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
            (r"/parameters", ParametersHandler),
            (r"/parameters\.yaml", ParameterFileHandler),
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
