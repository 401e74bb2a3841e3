"""The WebSocket that tells browsers what happens, as many as can be served and no slower than they answer."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, ClassVar

from tornado.websocket import WebSocketClosedError, WebSocketHandler

from fopid_core.study.json_values import jsonable
from fopid_core.study.page.guarded import Guarded
from fopid_ros.dashboard.history import Cursor, Row
from fopid_ros.dashboard.node import KEPT_ROWS, DashboardNode

PERIOD = 0.05
"""Time between two messages to a browser [s]."""

FACTS_PERIOD = 0.2
"""Between two words on how the loop is [s]; they come also when nothing else does."""

MOST_BROWSERS = 32
"""So many are served at a time; beyond, those that have never answered make room."""

PING_PERIOD = 10.0
"""A browser that has not answered after so long [s] is gone."""


class LiveHandler(Guarded, WebSocketHandler):
    """Tells one browser what happens, once it has answered a ping.

    Each message goes out after the one before has: a slow browser gets fewer and larger ones, and nobody waits for it.
    """

    open_now: ClassVar[dict[LiveHandler, None]] = {}  # the oldest first
    _feeding: asyncio.Task[None] | None = None

    def initialize(self) -> None:
        self.answered = asyncio.Event()

    def open(self, *args: str, **kwargs: str) -> None:
        if len(self.open_now) >= MOST_BROWSERS and not self._make_room():
            self.close(1013, f"{MOST_BROWSERS} browsers are served already")
            return
        self.set_nodelay(True)
        try:
            self.ping(b"")
        except WebSocketClosedError:  # it is gone before it was let in
            return
        self.open_now[self] = None
        self._feeding = asyncio.create_task(self._feed())

    def _make_room(self) -> bool:
        """End the oldest connection that has never answered; whether there was one."""
        oldest = next((handler for handler in self.open_now if not handler.answered.is_set()), None)
        if oldest is None:
            return False
        oldest.close(1013, "another browser answers")
        oldest.on_close()
        return True

    def on_pong(self, data: bytes) -> None:
        """It is alive."""
        self.answered.set()

    def on_close(self) -> None:
        self.open_now.pop(self, None)
        if self._feeding is not None:
            self._feeding.cancel()

    def on_message(self, message: str | bytes) -> None:
        """What a browser sends here is not looked at."""

    async def _feed(self) -> None:
        node: DashboardNode = self.settings["node"]
        await self.answered.wait()
        place, facts_at = Cursor(), -math.inf
        told: dict[str, Any] = {}
        while True:
            rows, now = node.history.since(place)
            news: dict[str, Any] = {"fresh": now.record != place.record}
            place = now
            for name, tell in node.sections().items():
                section = tell()
                if section != told.get(name):
                    news[name] = told[name] = section
            if time.monotonic() - facts_at >= FACTS_PERIOD:
                facts_at = time.monotonic()
                news["facts"] = node.health.facts()
            if rows or len(news) > 1:
                try:
                    await self.write_message(_message(rows, news))
                except WebSocketClosedError:
                    return
            await asyncio.sleep(PERIOD)


def _message(rows: Iterable[Row], news: dict[str, Any]) -> str:
    """One object; null where a number is not finite, which a browser could not read."""
    more = json.dumps(jsonable(news), separators=(",", ":"), allow_nan=False)[1:]
    return f'{{"rows":[{",".join(map(row_text, rows))}],{more}'


@lru_cache(2 * KEPT_ROWS)
def row_text(row: Row) -> str:
    """A row as JSON: eight digits of a signal, time to 0.1 ms, null where there is no number; written once for all.

    Examples
    --------
    >>> row_text((0.12345, 1.0, 6.9e95, math.nan))
    '[0.1235,1.0,6.9e+95,null]'
    """
    numbers = [round(row[0], 4), *(float(f"{x:.8g}") if math.isfinite(x) else None for x in row[1:])]
    return json.dumps(numbers, separators=(",", ":"))


def close_browsers() -> None:
    """Tell all browsers that the server goes."""
    for handler in list(LiveHandler.open_now):
        handler.close(1001, "the dashboard ends")
