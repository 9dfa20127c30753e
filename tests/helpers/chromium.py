"""A headless Chromium that a test steers through its DevTools, over one websocket."""

import contextlib
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

FLAGS = (
    "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--ignore-gpu-blocklist --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-dev-shm-usage --disable-extensions "
    "--autoplay-policy=no-user-gesture-required --use-fake-ui-for-media-stream "
    "--use-fake-device-for-media-stream --window-size=400,300 --remote-debugging-port=0 "
    "--remote-allow-origins=*"
)


class Tab:
    """One page of the browser; `complaints` are what its console and its security policy said."""

    def __init__(self, websocket: ClientConnection) -> None:
        self._websocket = websocket
        self._number = 0
        self.requests: list[str] = []
        self.complaints: list[str] = []
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def note_workers(self) -> None:
        """Note what workers ask for and say, too: they begin once this tab is asked something."""
        self.send(
            "Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=True, flatten=True
        )

    def send(self, method: str, **params: Any) -> Any:
        """Let the browser do something, and return what it answers."""
        number = self._tell(method, params)
        while True:
            message = json.loads(self._websocket.recv(timeout=60))
            if message.get("id") == number:
                assert "error" not in message, message["error"]
                return message["result"]
            if "method" in message:
                self._note(message["method"], message.get("params", {}))

    def _tell(self, method: str, params: Mapping[str, Any], **target: str) -> int:
        self._number += 1
        request = {"id": self._number, "method": method, "params": params, **target}
        self._websocket.send(json.dumps(request))
        return self._number

    def _note(self, method: str, params: dict[str, Any]) -> None:
        match method:
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
            case "Target.attachedToTarget":
                for told in ("Network.enable", "Log.enable", "Runtime.runIfWaitingForDebugger"):
                    self._tell(told, {}, sessionId=params["sessionId"])
            case "Network.webSocketCreated":
                self.requests.append(params["url"])
            case "Log.entryAdded":
                self.complaints.append(params["entry"]["text"])
            case "Runtime.consoleAPICalled" if params["type"] in ("error", "warning"):
                self.complaints.append(str(params["args"]))
            case "Runtime.exceptionThrown":
                self.complaints.append(str(params["exceptionDetails"]))

    def open(self, url: str) -> None:
        """Go to a page, and forget what others said and asked for."""
        self.requests.clear()
        self.complaints.clear()
        self.send("Page.navigate", url=url)

    def value(self, script: str) -> Any:
        """What an expression gives in the page; promises are awaited."""
        params = {"expression": script, "awaitPromise": True, "returnByValue": True}
        found = self.send("Runtime.evaluate", **params)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def tap(self, identity: str) -> None:
        """Press an element as a person does."""
        box = f"document.getElementById({identity!r}).getBoundingClientRect()"
        x, y = self.value(f"(({{left, top}}) => [left + 3, top + 3])({box})")
        for kind in ("mousePressed", "mouseReleased"):
            mouse = {"x": x, "y": y, "button": "left", "clickCount": 1}
            self.send("Input.dispatchMouseEvent", type=kind, **mouse)

    @contextlib.contextmanager
    def in_background(self) -> Iterator[None]:
        """Another tab in front of this one."""
        other = self.send("Target.createTarget", url="about:blank")["targetId"]
        self.send("Target.activateTarget", targetId=other)
        self.until("document.hidden")
        yield
        self.send("Target.closeTarget", targetId=other)
        self.send("Page.bringToFront")
        self.until("!document.hidden")

    def until(self, script: str, timeout_s: float = 10.0) -> Any:
        """Wait until an expression is true in the page, and return what it gives."""
        ends_s = time.monotonic() + timeout_s
        while not (found := self.value(script)):
            assert time.monotonic() < ends_s, f"never true: {script}; {self.complaints}"
            time.sleep(0.05)
        return found


@contextlib.contextmanager
def chromium(*flags: str) -> Iterator[Tab]:
    """A browser with one empty page; skips the test where there is none."""
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("chromium is not installed")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        process = subprocess.Popen(
            [program, *FLAGS.split(), *flags, f"--user-data-dir={home}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            found = Path(home) / "DevToolsActivePort"
            ends_s = time.monotonic() + 20
            while not found.exists() or len(found.read_text().split()) < 2:
                assert process.poll() is None, "chromium has ended"
                assert time.monotonic() < ends_s, "chromium does not start"
                time.sleep(0.05)
            port = found.read_text().split()[0]
            pages = httpx.get(f"http://127.0.0.1:{port}/json/list", trust_env=False).json()
            url = next(each["webSocketDebuggerUrl"] for each in pages if each["type"] == "page")
            # A tab that no test reads for a while answers no pings.
            with connect(url, max_size=None, proxy=None, ping_interval=None) as websocket:
                yield Tab(websocket)
        finally:
            process.terminate()
            process.wait(10)
