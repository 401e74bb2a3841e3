"""The dashboard: a live page of the loop for any browser of this machine."""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import socket
import sys
import time
from collections.abc import Sequence

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import InvalidNamespaceException, InvalidNodeNameException
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from tornado.httpserver import HTTPServer

from fopid_core.errors import InputError
from fopid_core.study.page.access import Access, chosen_token
from fopid_core.study.page.listening import http_server, listening_sockets, page_address
from fopid_ros.common.arguments import parse
from fopid_ros.common.middleware import prepare_middleware, use_profile
from fopid_ros.dashboard.live import PERIOD, LiveHandler, close_browsers
from fopid_ros.dashboard.node import SPECS, DashboardNode
from fopid_ros.dashboard.web import application

TOKEN_VARIABLE = "FOPID_DASHBOARD_TOKEN"
DEFAULT_PORT = 8077
SLICE = 0.02  # [s] between two looks at what ROS has brought, while somebody looks at the page; else PERIOD


def _parser() -> argparse.ArgumentParser:
    parameters = "\n".join(f"  {spec.name} ({spec.default})  {spec.description}" for spec in SPECS)
    parser = argparse.ArgumentParser(
        prog="dashboard",
        description="A live page of the loop: signals, gains, tuning. Changes need the token in the printed address.",
        epilog=f"{TOKEN_VARIABLE} in the environment sets the token; without it each start makes a new one.\n\n"
        f"parameters (default), after --ros-args:\n{parameters}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (127.0.0.1: this machine only)")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"port; 0 chooses a free one ({DEFAULT_PORT})")
    return parser


async def _spin(executor: Executor, node: DashboardNode) -> None:
    """Serve ROS between the requests: all in one thread, so that nothing needs a lock."""
    settled = 0.0
    while True:
        # spin_until_future_complete would keep 32 bytes of each of its calls, 5 MB an hour.
        waiting = executor.create_task(lambda: None)  # comes behind all that is waiting now
        while not waiting.done():
            executor.spin_once(timeout_sec=0.0)
        now = time.monotonic()
        if now - settled >= PERIOD - SLICE / 2:
            settled = now
            node.history.settle()
        await asyncio.sleep(SLICE if LiveHandler.open_now else PERIOD)


async def serve(node: DashboardNode, executor: Executor, server: HTTPServer, sockets: list[socket.socket]) -> None:
    """Serve ROS and browsers until told to stop; raises what went wrong in between."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    server.add_sockets(sockets)
    tasks = [asyncio.create_task(work) for work in (_spin(executor, node), node.watch(), stop.wait())]
    done, pending = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    server.stop()
    close_browsers()
    for task in pending:
        task.cancel()
    await asyncio.gather(*pending, return_exceptions=True)
    for task in done:
        task.result()


def _serve_node(host: str, port: int, given: str | None, ros_arguments: list[str]) -> None:
    token = chosen_token(given)
    prepare_middleware()
    use_profile()
    sockets = listening_sockets(host, port)
    rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = DashboardNode()
    names = frozenset({host.lower(), socket.gethostname().lower()})
    server = http_server(application(node, Access(token, names)))
    print(f"dashboard  {page_address(host, sockets[0].getsockname()[1], None if given else token)}", flush=True)
    if given:
        print(f"add #token= and what {TOKEN_VARIABLE} holds to change anything", flush=True)
    executor = EventsExecutor()
    executor.add_node(node)
    asyncio.run(serve(node, executor, server, sockets))
    executor.shutdown()
    node.destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the executable ``dashboard``."""
    given = list(sys.argv[1:] if args is None else args)
    options = parse(_parser(), given)
    try:
        _serve_node(options.host, options.port, os.environ.get(TOKEN_VARIABLE), given)
    except (InputError, InvalidNodeNameException, InvalidNamespaceException, RCLError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:  # before the loop hears of it
        return 130
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
