"""A real window on an X server of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest

from pica_client.ui.window import Window
from pica_core.errors import GraphicsError

pytestmark = pytest.mark.render

OPEN = """
from pica_client.ui.window import Window
with Window((60, 40)) as window:
    window.poll()
    print(*window.size_px)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_without_a_display_a_window_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(GraphicsError, match=r"DISPLAY is not set.*--headless"):
        Window((64, 64))


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="needs Xvfb")
def test_a_window_is_never_too_small_for_its_bar() -> None:
    read, write = os.pipe()
    words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24", "-nolisten", "tcp"]
    server = subprocess.Popen([*words, "-noreset"], pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as number:
            display = f":{number.readline().strip()}"
        done = subprocess.run(
            [sys.executable, "-c", OPEN],
            env={**os.environ, "DISPLAY": display},
            capture_output=True,
            text=True,
            timeout=60,
        )
    finally:
        server.terminate()
        server.wait(10)
    assert done.stdout.split() == ["480", "360"], done.stderr
