"""A headless Chromium, driven by its DevTools protocol."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tornado.websocket import websocket_connect

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
SECONDS = 120  # for Chromium to start, and for a page to load
MOST = 2**28  # bytes of a message
KEYS = {"ArrowRight": 39, "ArrowLeft": 37, "Home": 36, "End": 35, "Tab": 9}
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
)


class Chromium:
    """One browser with one page; a context that ends both.

    `folder` is for its profile: empty, and its own.
    """

    def __init__(self, folder: Path):
        self._loop = asyncio.new_event_loop()
        self._process = subprocess.Popen(
            [CHROMIUM, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            self._socket = self._wait(
                websocket_connect, self._address(folder), max_message_size=MOST
            )
            self._count, self._session, self._events = 0, None, []
            target = self.send("Target.createTarget", url="about:blank")["targetId"]
            attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
            self._session = attached["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.send(f"{domain}.enable")
            self.send("Emulation.setFocusEmulationEnabled", enabled=True)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """End the browser."""
        self._process.kill()
        self._process.wait()
        self._loop.close()

    def _address(self, folder: Path) -> str:
        """Where the browser listens: it writes that to its profile once it does."""
        file, end = folder / "DevToolsActivePort", time.monotonic() + SECONDS
        while not (file.is_file() and len(lines := file.read_text().split()) == 2):
            if self._process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"{CHROMIUM} does not start (exit {self._process.poll()})")
            time.sleep(0.05)
        return f"ws://127.0.0.1:{lines[0]}{lines[1]}"

    def _wait(self, call: Callable, *arguments, **options) -> Any:
        """What a call that has to be awaited gives, in time."""

        async def awaited():
            return await asyncio.wait_for(call(*arguments, **options), SECONDS)

        return self._loop.run_until_complete(awaited())

    def send(self, method: str, **parameters: Any) -> Mapping[str, Any]:
        """Result of a command; events that come before it are kept."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._wait(self._socket.write_message, json.dumps(message))
        while (answer := self._read()).get("id") != self._count:
            self._events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def open(self, page: Path, width: int = 1280, scheme: str = "light", **media: str) -> None:
        """Load a file at a window width (px) in a color scheme; `media`: print or screen."""
        self._events.clear()
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=900,
            deviceScaleFactor=1,
            mobile=False,
        )
        wanted = [{"name": "prefers-color-scheme", "value": scheme}]
        self.send("Emulation.setEmulatedMedia", features=wanted, **media)
        self.send("Page.navigate", url=page.as_uri())
        while not any(event["method"] == "Page.loadEventFired" for event in self._events):
            self._events.append(self._read())

    def evaluate(self, script: str) -> Any:
        """Value of an expression of JavaScript in the page."""
        found = self.send("Runtime.evaluate", expression=script, returnByValue=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"]["exception"]["description"])
        return found["result"].get("value")

    def press(self, key: str) -> None:
        """Press and release a key, one of `KEYS`."""
        for kind in ("rawKeyDown", "keyUp"):
            self.send(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=KEYS[key],
            )

    def problems(self) -> list[str]:
        """What went wrong since the page was opened: console, exceptions, requests."""
        self.evaluate("0")  # so that what was on its way has come
        found = []
        for event in self._events:
            method, of = event["method"], event.get("params", {})
            if method == "Runtime.exceptionThrown":
                found.append(f"exception: {of['exceptionDetails']['text']}")
            elif method == "Runtime.consoleAPICalled" and of["type"] in ("error", "warning"):
                found.append(f"console: {of['args']}")
            elif method == "Log.entryAdded" and of["entry"]["level"] in ("error", "warning"):
                found.append(f"log: {of['entry']['text']} {of['entry'].get('url', '')}")
            elif method == "Network.loadingFailed":
                found.append(f"request: {of['errorText']}")
        return found

    def _read(self) -> dict[str, Any]:
        text = self._wait(self._socket.read_message)
        if text is None:
            raise RuntimeError(f"{CHROMIUM} has ended")
        return json.loads(text)
