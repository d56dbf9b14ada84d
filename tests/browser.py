"""A headless Chromium driven over its DevTools protocol by a pipe: no other package."""

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--mute-audio"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars"),
    *("--disable-extensions", "--no-default-browser-check", "--disable-default-apps"),
)


def program() -> str | None:
    """Where there is one."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


needs_browser = pytest.mark.skipif(
    program() is None, reason="there is no Chromium here"
)


class Browser:
    """One page of one browser; `events` collects what the protocol tells."""

    def __init__(self, limit: float = 60.0):
        chosen = program()
        assert chosen is not None
        self.limit, self.number, self.events = limit, 0, []
        self.profile = tempfile.mkdtemp(prefix="profile-")
        words = [chosen, *FLAGS, "--remote-debugging-pipe"]
        words += [f"--user-data-dir={self.profile}", "about:blank"]
        read_in, self.out = os.pipe()
        self.into, write_out = os.pipe()
        # The protocol speaks on descriptors 3 and 4, which may be taken here; a process
        # that is forked would wake what jax has to say of forks.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 64) for end in (read_in, write_out)]
        quiet = [(os.POSIX_SPAWN_OPEN, to, os.devnull, os.O_WRONLY, 0) for to in (1, 2)]
        self.process = os.posix_spawn(
            chosen,
            words,
            dict(os.environ),
            file_actions=[
                *quiet,
                *((os.POSIX_SPAWN_DUP2, end, 3 + n) for n, end in enumerate(ends)),
            ],
        )
        for end in (read_in, write_out, *ends):
            os.close(end)
        self.rest = b""
        self.session: str | None = None
        targets = self.send("Target.getTargets")["targetInfos"]
        page = next(t for t in targets if t["type"] == "page")
        found = self.send(
            "Target.attachToTarget", targetId=page["targetId"], flatten=True
        )
        self.session = found["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log", "DOM"):
            self.send(f"{domain}.enable")

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        os.kill(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        os.close(self.out)
        os.close(self.into)
        shutil.rmtree(self.profile, ignore_errors=True)

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; `AssertionError` where it fails."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.out, data) :]
        until = time.monotonic() + self.limit
        while True:
            told = self._read(until)
            if told.get("id") == self.number:
                assert "error" not in told, (method, told["error"])
                return told["result"]

    def _read(self, until: float) -> dict[str, Any]:
        while b"\0" not in self.rest:
            ready, _, _ = select.select(
                [self.into], [], [], max(until - time.monotonic(), 0)
            )
            assert ready, "the browser does not answer"
            more = os.read(self.into, 1 << 20)
            assert more, "the browser has ended"
            self.rest += more
        one, _, self.rest = self.rest.partition(b"\0")
        told = json.loads(one)
        if "method" in told:
            self.events.append((told["method"], told["params"]))
        return told

    def open(self, path: Path, *, ready: str = "true") -> None:
        """A file; until `ready` holds in it."""
        self.events.clear()
        self.send("Page.navigate", url=path.resolve().as_uri())
        self.wait(f"document.readyState === 'complete' && ({ready})")

    def value(self, expression: str) -> Any:
        """What an expression, or its promise, comes to; errors are raised."""
        told = self.send(
            "Runtime.evaluate",
            expression=expression,
            returnByValue=True,
            awaitPromise=True,
            userGesture=True,
        )
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def wait(self, condition: str, limit: float = 30.0) -> None:
        """Until it holds."""
        until = time.monotonic() + limit
        while not self.value(f"Boolean({condition})"):
            assert time.monotonic() < until, (f"never: {condition}", self.errors())
            time.sleep(0.02)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """`mousePressed`, `mouseMoved` or `mouseReleased`, the left button."""
        buttons = {"button": "left", "buttons": 1, "clickCount": 1}
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **(buttons | more))

    def drag(self, a: tuple[float, float], b: tuple[float, float], **more: Any) -> None:
        """From a to b with the left button held."""
        self.mouse("mouseMoved", *a, buttons=0)
        self.mouse("mousePressed", *a, **more)
        for share in (0.25, 0.5, 0.75, 1.0):
            x, y = (p + share * (q - p) for p, q in zip(a, b, strict=True))
            self.mouse("mouseMoved", x, y, **more)
        self.mouse("mouseReleased", *b, **more)

    def key(self, key: str) -> None:
        """Press and release."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": key} if kind == "keyDown" and len(key) == 1 else {}
            self.send("Input.dispatchKeyEvent", type=kind, key=key, **text)

    def box(self, selector: str) -> tuple[float, float, float, float]:
        """Left, top, width and height on the screen, scrolled into view."""
        found = self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center'}); const b = e.getBoundingClientRect();"
            "return [b.left, b.top, b.width, b.height]; })()"
        )
        return tuple(found)

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """A PNG of what is seen, or of all of the page."""
        told = self.send(
            "Page.captureScreenshot", format="png", captureBeyondViewport=whole
        )
        path.write_bytes(base64.b64decode(told["data"]))

    def errors(self) -> list[str]:
        """What was thrown or refused since the page was opened."""
        self.value("1")
        found = []
        for method, told in self.events:
            if method == "Runtime.exceptionThrown":
                found.append(str(told["exceptionDetails"]))
            if method == "Log.entryAdded" and told["entry"]["level"] == "error":
                found.append(told["entry"]["text"])
        return found

    def requests(self) -> list[str]:
        """Addresses asked for since the page was opened, its own first."""
        self.value("1")
        return [
            told["request"]["url"]
            for method, told in self.events
            if method == "Network.requestWillBeSent"
        ]
