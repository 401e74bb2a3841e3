"""A headless Chromium, driven over the DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from tornado.websocket import WebSocketClientConnection, websocket_connect

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WITHOUT_BROWSER = "no Chromium or Chrome on this machine"
NEEDS_BROWSER = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None and "FOPID_NEED_BROWSER" not in os.environ, reason=WITHOUT_BROWSER),
]
PATIENCE = 60.0
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-extensions",
    "--disable-background-networking", "--no-first-run", "--remote-debugging-port=0",
)  # fmt: skip

LOADED = "Page.loadEventFired"
CLICKABLE = """(selector) => {
  const element = document.querySelector(selector);
  if (!element || element.disabled) return null;
  element.scrollIntoView({ block: "center" });
  const box = element.getBoundingClientRect(), x = box.x + box.width / 2, y = box.y + box.height / 2;
  const hit = document.elementFromPoint(x, y);
  return element === hit || element.contains(hit) ? [x, y] : null;
}"""
"""Where to click on an element; null while nobody could."""


class Browser:
    """One browser process; its pages share nothing but the process."""

    def __init__(self, folder: Path) -> None:
        assert CHROMIUM, WITHOUT_BROWSER
        self._loop = asyncio.new_event_loop()
        self._process = subprocess.Popen(
            [CHROMIUM, *OPTIONS, f"--user-data-dir={folder}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        port_file = folder / "DevToolsActivePort"
        until(lambda: port_file.exists() and len(port_file.read_text().split()) == 2, "the browser")
        port, path = port_file.read_text().split()
        self._address = f"ws://127.0.0.1:{port}"
        self._control = Page(self._loop, self._address + path)

    def open(self, address: str, width: int = 1280, height: int = 900, dark: bool = False) -> Page:
        """A page of its own storage at this address."""
        context = self._control.call("Target.createBrowserContext")["browserContextId"]
        target = self._control.call("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        page = Page(self._loop, f"{self._address}/devtools/page/{target}")
        for domain in ("Runtime", "Page", "Network", "Log"):
            page.call(f"{domain}.enable")
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        page.call("Emulation.setEmulatedMedia", features=[scheme])
        page.go(address)
        return page

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._loop.close()


class Page:
    """One page of a browser, or the browser itself."""

    def __init__(self, loop: asyncio.AbstractEventLoop, address: str) -> None:
        self._loop, self._number = loop, 0
        self._socket: WebSocketClientConnection = self._wait(lambda: websocket_connect(address, max_message_size=2**26))
        self.events: list[dict[str, Any]] = []

    def _wait(self, begin: Callable[[], Awaitable[Any]]) -> Any:
        async def wait() -> Any:
            return await asyncio.wait_for(begin(), PATIENCE)

        return self._loop.run_until_complete(wait())

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        request = json.dumps({"id": self._number, "method": method, "params": parameters})
        self._wait(lambda: self._socket.write_message(request))
        while (message := json.loads(self._wait(self._socket.read_message))).get("id") != self._number:
            self.events.append(message)
        assert "error" not in message, message
        return message["result"]

    def run(self, script: str) -> Any:
        """The value of a script's last expression; promises are awaited."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def go(self, address: str) -> None:
        """Load an address; while a page gives way to another there is nothing that a script could be run in."""
        self.events = [event for event in self.events if event["method"] != LOADED]
        self.call("Page.navigate", url=address)
        while not any(event["method"] == LOADED for event in self.events):
            self.events.append(json.loads(self._wait(self._socket.read_message)))

    def text(self, selector: str) -> str:
        return self.run(f"document.querySelector({json.dumps(selector)})?.innerText ?? ''")

    def click(self, selector: str) -> None:
        """As a person does: as soon as it is there, can be used, is not covered and stands still."""
        places: list[list[float] | None] = []

        def is_free() -> bool:
            places.append(self.run(f"({CLICKABLE})({json.dumps(selector)})"))
            return len(places) > 1 and places[-1] is not None and places[-1] == places[-2]

        until(is_free, f"{selector} that can be clicked")
        assert places[-1] is not None
        x, y = places[-1]
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def write(self, selector: str, text: str) -> None:
        """Type into a field, in place of what it holds."""
        self.click(selector)
        self.run(f"document.querySelector({json.dumps(selector)}).select()")
        self.call("Input.insertText", text=text)

    def press(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def until(self, script: str, what: str, patience: float = PATIENCE) -> None:
        until(lambda: self.run(script), what, patience)

    def complaints(self) -> list[str]:
        """What the console says: errors, warnings, exceptions, requests that failed or were blocked."""
        self.run("0")
        said = []
        for event in self.events:
            method, parameters = event["method"], event["params"]
            if method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
                said.append(str([argument.get("value") for argument in parameters["args"]]))
            elif method == "Runtime.exceptionThrown":
                said.append(str(parameters["exceptionDetails"]))
            elif method == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
                said.append(parameters["entry"]["text"] + " " + parameters["entry"].get("url", ""))
        return said

    def requested(self) -> set[str]:
        """Addresses the page has asked for."""
        self.run("0")
        return {e["params"]["request"]["url"] for e in self.events if e["method"] == "Network.requestWillBeSent"}

    def picture(self, path: Path) -> None:
        """The whole page as PNG."""
        shot = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))

    def close(self) -> None:
        """End the page; one that is only left goes on drawing."""
        self.call("Page.close")
        self._socket.close()


def until(ready: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
    deadline = time.monotonic() + patience
    while not ready():
        assert time.monotonic() < deadline, f"{what} within {patience} s"
        time.sleep(0.05)
