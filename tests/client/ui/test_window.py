"""A real window on an X server of its own, and the surface without one: input, drawing, sizes."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from imgui_bundle import imgui

from helpers.hand import frame, press
from pica_client.ui.actions import Action, keyboard
from pica_client.ui.state import ViewState
from pica_client.ui.window import ON_PICTURE, Surface, Window
from pica_core.errors import GraphicsError
from pica_core.gl import create_context

pytestmark = pytest.mark.render

OPEN = """
from pica_client.ui.window import Window
with Window((60, 40)) as window:
    window.poll()
    print(*window.size_px)
"""


PRESS = """
import subprocess
from pica_client.ui.actions import keyboard
from pica_client.ui.state import ViewState
from pica_client.ui.window import Window
with Window((480, 360)) as window:
    for step in range(200):
        window.poll()
        window.begin(step / 50)
        keyboard(state := ViewState())
        for request in state.requests:
            print(request.name)
        window.surface.end()
        window.show(lambda target: None)
        if step in (20, 60, 100):
            subprocess.run(["xdotool", "key", "maq"[step // 40]], check=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_without_a_display_a_window_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(GraphicsError, match=r"DISPLAY is not set.*--headless"):
        Window((64, 64))


def run_under_xvfb(script: str, *before: list[str]) -> list[str]:
    """The words that a script prints on an X server of its own, after these commands."""
    read, write = os.pipe()
    words = ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24", "-nolisten", "tcp"]
    server = subprocess.Popen([*words, "-noreset"], pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as number:
            env = {**os.environ, "DISPLAY": f":{number.readline().strip()}"}
        for command in before:
            subprocess.run(command, env=env, check=True, timeout=60)
        done = subprocess.run(
            [sys.executable, "-c", script], env=env, capture_output=True, text=True, timeout=60
        )
    finally:
        server.terminate()
        server.wait(10)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="needs Xvfb")
def test_a_window_is_never_too_small_for_its_bar() -> None:
    assert run_under_xvfb(OPEN) == ["480", "360"]


@pytest.mark.skipif(
    None in map(shutil.which, ("Xvfb", "xdotool", "setxkbmap")), reason="needs Xvfb and keyboards"
)
def test_keys_go_by_what_is_printed_on_them() -> None:
    pressed = run_under_xvfb(PRESS, ["setxkbmap", "fr"])
    # On a French keyboard M is where an American one has a semicolon, and A where that has Q.
    assert pressed == ["MUTE_FACE", "CLOSE"]


def test_keys_are_a_fields_own_while_a_text_is_typed() -> None:
    with Surface() as surface:
        state = ViewState()
        for step, key in enumerate((None, None, None, imgui.Key.l, imgui.Key.escape)):
            if key is not None:
                press(key)(surface.io)
            with frame(surface, 0.1 * step, (640, 360)):
                imgui.begin("form")
                imgui.set_keyboard_focus_here()
                imgui.input_text("##field", "")
                imgui.end()
                keyboard(state)
    assert state.requests == [Action.CLOSE]


def test_signs_and_panels_are_painted_where_they_are_wanted() -> None:
    context = create_context()
    target = context.framebuffer([context.texture((200, 50), 4)])
    with Surface(context) as surface:
        red = surface.show("red", np.full((4, 4, 3), (255, 0, 0), np.uint8))
        green = surface.show("green", np.full((4, 4, 3), (0, 255, 0), np.uint8))
        for step in range(2):  # a window is shown from its second frame on
            with frame(surface, 0.1 * step, (100, 50)):
                for name, texture, left in ((f"{ON_PICTURE}a", green, 0), ("b", red, 50)):
                    imgui.set_next_window_pos((left, 0))
                    imgui.begin(name, None, imgui.WindowFlags_.no_decoration)
                    imgui.image(imgui.ImTextureRef(texture), (40, 40))
                    imgui.end()
        seen = []
        for paints in ({}, {"panels": False}, {"signs": False}):
            target.clear()
            surface.paint(target, **paints)
            pixels = np.frombuffer(target.read(components=3), np.uint8).reshape(50, 200, 3)[25]
            seen.append([tuple(pixels[x].tolist()) for x in (25, 80)])
        assert context.error == "GL_NO_ERROR"
    context.release()
    black, left, right = (0, 0, 0), (0, 255, 0), (255, 0, 0)
    assert seen == [[left, right], [left, black], [black, right]]
