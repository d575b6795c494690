"""Headless Chromium over its debugging pipe: what a page does when it is really opened."""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

AXE = Path(os.environ.get("BIAXBAYES_AXE", ""))
needs_axe = pytest.mark.skipif(not AXE.is_file(), reason="BIAXBAYES_AXE names no axe.min.js")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or ""
SWITCHES = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)


class Page:
    """One tab of a browser of its own.

    Attributes
    ----------
    events : list of dict
        Everything the browser sent since the start: requests, console, exceptions.
    """

    def __init__(self, profile: Path) -> None:
        down, self._write = os.pipe()
        self._read, up = os.pipe()
        # The browser reads commands from descriptor 3 and answers on 4.
        command = [CHROMIUM, *SWITCHES, "--remote-debugging-pipe", f"--user-data-dir={profile}"]
        shell = f'exec "$@" 3<&{down} 4>&{up}'
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", *command, "about:blank"],
            pass_fds=(down, up),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(down)
        os.close(up)
        self.events: list[dict[str, Any]] = []
        self._number, self._buffer, self._session = 0, b"", None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the DevTools protocol, and its answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            output = self._next(60.0)
            if output.get("id") == self._number:
                assert "error" not in output, output
                return output["result"]
            self.events.append(output)

    def open(self, path: Path) -> None:
        """Load a file and wait until it is shown."""
        first = len(self.events)
        self.call("Page.navigate", url=path.resolve().as_uri())
        while not self.seen("Page.loadEventFired", first):
            self.events.append(self._next(60.0))

    def resize(self, width: int, height: int = 800) -> None:
        """Show as much as a screen of this size does, in CSS pixels; narrow ones are phones."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def seen(self, method: str, first: int = 0) -> list[dict[str, Any]]:
        """Parameters of the events of a kind."""
        return [e["params"] for e in self.events[first:] if e.get("method") == method]

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression; promises are awaited."""
        output = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in output, output["exceptionDetails"]
        return output["result"].get("value")

    def audit(self, scheme: str) -> dict[str, Any]:
        """What axe finds of the page in a colour scheme: how many passes, and its violations."""
        self.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": scheme}],
        )
        self.evaluate(AXE.read_text(encoding="utf-8") + "; 1")
        return self.evaluate(
            "axe.run().then(r => ({passes: r.passes.length, violations: "
            "r.violations.map(v => [v.impact, v.id, v.nodes.length, v.nodes[0].html])}))"
        )

    def close(self) -> None:
        """End the browser."""
        self._session = None
        try:
            self.call("Browser.close")
        except (OSError, AssertionError, TimeoutError):
            self._process.kill()
        self._process.wait(30)
        os.close(self._write)
        os.close(self._read)

    def _next(self, seconds: float) -> dict[str, Any]:
        end = time.monotonic() + seconds
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise TimeoutError("the browser does not answer")
            more = os.read(self._read, 1 << 20)
            if not more:
                raise OSError("the browser has gone")
            self._buffer += more
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)


@contextlib.contextmanager
def shown(path: Path, profile: Path) -> Iterator[Page]:
    """A file in a browser of its own, whose profile is removed in the end."""
    page = Page(profile)
    try:
        page.open(path)
        yield page
    finally:
        page.close()
        # Chromium may leave files behind while it ends; the profile is removed at leisure.
        shutil.rmtree(profile, ignore_errors=True)
