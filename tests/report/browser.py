"""A headless Chromium, spoken to over its DevTools protocol: what a page looks like to those who open it."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--remote-debugging-port=0",
)  # fmt: skip
DEADLINE_S = 30.0

WIDER = """
(() => {
  const scrolls = node => node && (node.closest(".scroll, pre") !== null);
  const out = [...document.body.querySelectorAll("*")].filter(node => {
    const box = node.getBoundingClientRect();
    return box.width && (box.right > innerWidth + 1 || box.left < -1) && !scrolls(node) &&
      !(node.ownerSVGElement);
  });
  const page = document.documentElement.scrollWidth > innerWidth ? ["the page"] : [];
  return page.concat(out.map(node => node.tagName + "." + node.className + " " + node.textContent.slice(0, 40)));
})()
"""
"""What is wider than the window and does not scroll by itself."""
SMALLEST = """
Math.min(...[...document.querySelectorAll("svg text")].map(node => {
  const svg = node.ownerSVGElement, scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
  return scale ? parseFloat(getComputedStyle(node).fontSize) * scale : 100;
}), 100)
"""
"""Height of the smallest text in a figure [px]."""


def found() -> str | None:
    """Path of a Chromium; None if this machine has none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@dataclass
class Opened:
    """A page that is open, with what it asked for and complained about."""

    browser: Browser
    session: str
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def call(self, method: str, **parameters: Any) -> Any:
        return self.browser.call(method, parameters, self.session)

    def value(self, expression: str) -> Any:
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def resize(self, width: int, height: int = 900, *, dark: bool = False) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def picture(self, path: Path) -> None:
        answer = self.call("Page.captureScreenshot", captureBeyondViewport=True, format="png")
        path.write_bytes(base64.b64decode(answer["data"]))

    def tree(self) -> list[tuple[str, str]]:
        """(tag, tag of its parent) of every element, in the order of the page."""
        out: list[tuple[str, str]] = []

        def walk(node: dict[str, Any], parent: str) -> None:
            name = node["nodeName"].lower()
            if node["nodeType"] == 1:
                out.append((name, parent))
            for child in node.get("children", []):
                walk(child, name if node["nodeType"] == 1 else parent)

        walk(self.call("DOM.getDocument", depth=-1)["root"], "")
        return out


class Browser:
    """Use it as a context manager."""

    def __init__(self, program: str, profile: Path) -> None:
        self._command = [program, *FLAGS, f"--user-data-dir={profile}", "about:blank"]
        self._number = 0
        self._open: dict[str, Opened] = {}
        self._until_exit = ExitStack()

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(self._command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if address := re.search(r"DevTools listening on (ws://\S+)", line):
                connection = connect(address[1], max_size=None, compression=None)
                self._socket: ClientConnection = self._until_exit.enter_context(connection)
                return self
        raise RuntimeError(f"{self._command[0]} did not start")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._until_exit.close()
        self._process.terminate()
        self._process.wait(10)
        assert self._process.stderr is not None
        self._process.stderr.close()

    def call(self, method: str, parameters: dict[str, Any], session: str | None = None) -> Any:
        self._number += 1
        number = self._number
        where = {} if session is None else {"sessionId": session}
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters, **where}))
        until = time.monotonic() + DEADLINE_S
        while True:
            message = json.loads(self._socket.recv(timeout=max(until - time.monotonic(), 0.01)))
            if message.get("id") == number:
                assert "error" not in message, (method, message["error"])
                return message["result"]
            self._heard(message)

    def _heard(self, message: dict[str, Any]) -> None:
        page, what = self._open.get(message.get("sessionId", "")), message.get("params", {})
        if page is None:
            return
        match message["method"]:
            case "Network.requestWillBeSent":
                page.requests.append(what["request"]["url"])
            case "Runtime.consoleAPICalled" | "Runtime.exceptionThrown":
                page.complaints.append(json.dumps(what)[:400])
            case "Log.entryAdded":
                page.complaints.append(what["entry"]["text"])
            case _:
                pass

    def open(self, file: Path, *, scripts: bool = True) -> Opened:
        target = self.call("Target.createTarget", {"url": "about:blank"})["targetId"]
        session = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        page = self._open[session] = Opened(browser=self, session=session)
        for domain in ("Page", "Runtime", "Log", "Network", "DOM"):
            page.call(f"{domain}.enable")
        page.call("Emulation.setScriptExecutionDisabled", value=not scripts)
        page.resize(1400)
        page.call("Page.navigate", url=file.resolve().as_uri())
        until = time.monotonic() + DEADLINE_S
        while page.value("document.readyState + location.href") != f"complete{file.resolve().as_uri()}":
            assert time.monotonic() < until, f"{file} does not load"
            time.sleep(0.02)
        return page
