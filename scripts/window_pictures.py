"""Take pictures of the viewer's window, steered by mouse: join, panels, record, leave.

    python scripts/window_pictures.py OUT [COLUMNSxROWS[@SCALE] ...]

Needs Xvfb, xdotool and xprop. For each size it starts an X server, a relay and five people with
names in six scripts; then it runs `pica view` with an invite link, as a process of its own, and
moves and clicks the pointer of the X server. The window's process notes where buttons are as it
draws them. Pictures are taken of the screen: OUT/NAME-COLUMNSxROWS@SCALE.png.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import ImageGrab

from pica_client.avatars.library import AvatarLibrary
from pica_client.local_call.processes import Children
from pica_protocol.invite import Invite, make_link

if TYPE_CHECKING:
    from pica_client.ui.state import CallView, ViewState

ROOT = Path(__file__).resolve().parents[1]
SIZES = ("1280x720", "480x360", "2560x1440", "2560x1440@2")
ROOM = "standup"
PEOPLE = ("Ada Lovelace", "Ольга Петровна", "李小龍 さくら 김", "מרים  مريم", "Ελένη 😀🎉")
PATIENCE_S = 120.0


class Desk:
    """An X server with a pointer, and one window on it."""

    def __init__(self, size: tuple[int, int], scale: float, folder: Path) -> None:
        self.notes = folder / "notes.json"
        read, write = os.pipe()
        screen = f"{size[0]}x{size[1]}x24"
        self._server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", screen, "-nolisten", "tcp"],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as number:
            self.display = f":{number.readline().strip()}"
        self.environment = {**os.environ, "DISPLAY": self.display, "HOME": str(folder)}
        self.environment.pop("XDG_CONFIG_HOME", None)
        dpi = f"Xft.dpi:\t{96 * scale:g}"
        self._run("xprop", "-root", "-f", "RESOURCE_MANAGER", "8s", "-set", "RESOURCE_MANAGER", dpi)

    def close(self) -> None:
        """End the X server."""
        self._server.terminate()
        self._server.wait(10)

    def click(self, label: str) -> None:
        """Click on what is labelled so: move there, see that it stays, press, let go.

        Each step waits for frames that show it, so a busy machine only takes longer.
        """
        end = time.monotonic() + PATIENCE_S
        while (place := self._find(label)) is None or not self._reaches(label, place):
            if time.monotonic() > end:
                raise TimeoutError(f"nothing is labelled {label!r}; {self.seen()}")
            self.wait_frames(1)
        self._press()

    def type(self, label: str, text: str) -> None:
        """Type a text into a field."""
        self.click(label)
        self._run("xdotool", "key", "ctrl+a")
        self._run("xdotool", "type", "--delay", "150", text)
        self.wait_frames(4)

    def point(self, x: float, y: float) -> None:
        """Move the pointer."""
        self._run("xdotool", "mousemove", str(round(x)), str(round(y)))

    def seen(self) -> dict[str, Any]:
        """What the window's process noted of its latest frame; see `show_window`."""
        try:
            found: dict[str, Any] = json.loads(self.notes.read_text())
        except FileNotFoundError:
            return {"frame": 0, "places": {}}
        return found

    def wait(self, what: str, **wanted: Any) -> None:
        """Wait until frames say so of a call; a number is the least one."""
        end = time.monotonic() + PATIENCE_S
        while not all(
            seen.get(name) == value if isinstance(value, bool | str) else seen.get(name, 0) >= value
            for seen in [self.seen()]
            for name, value in wanted.items()
        ):
            if time.monotonic() > end:
                raise TimeoutError(f"{what}: {wanted} is wanted, {self.seen()} is seen")
            time.sleep(0.1)
        self.wait_frames(2)

    def wait_frames(self, count: int) -> None:
        """Wait until so many frames were drawn from now on."""
        end, last = time.monotonic() + PATIENCE_S, self.seen()["frame"] + count
        while self.seen()["frame"] < last:
            if time.monotonic() > end:
                raise TimeoutError("the window draws no more")
            time.sleep(0.05)

    def _press(self) -> None:
        for step in ("mousedown", "mouseup"):
            self._run("xdotool", step, "1")
            self.wait_frames(2)

    def take(self, path: Path) -> None:
        """Take a picture of the screen."""
        ImageGrab.grab(xdisplay=self.display).save(path)
        print(path.name, flush=True)

    def _find(self, label: str) -> list[float] | None:
        places = self.seen()["places"]
        return next((rect for known, rect in places.items() if label in known), None)

    def _reaches(self, label: str, place: list[float]) -> bool:
        """Point at a place; whether what is labelled so is still there then."""
        left, top, right, bottom = place
        self.point((left + right) / 2, (top + bottom) / 2)
        self.wait_frames(2)
        return self._find(label) == place

    def _run(self, *command: str) -> None:
        subprocess.run(command, env=self.environment, check=True, timeout=20)


def start_people(children: Children, url: str) -> None:
    """Let everybody send a face."""
    avatars = AvatarLibrary().names
    for number, name in enumerate(PEOPLE):
        where = ("--url", url, "--room", ROOM, "--name", name)
        source = f"performance:{('talk', 'listen')[number % 2]}"
        avatar = avatars[number % len(avatars)]
        children.start(name, "send", *where, "--avatar", avatar, "--source", source)


def photograph(out: Path, size: tuple[int, int], scale: float) -> None:
    """Go through a call, and take a picture at each step."""
    suffix = f"{size[0]}x{size[1]}@{scale:g}.png"
    with Children() as children, tempfile.TemporaryDirectory() as home, ExitStack() as stack:
        desk = Desk(size, scale, Path(home))
        stack.callback(desk.close)
        relay, url = children.start_relay()
        start_people(children, url)
        link = make_link(Invite(url=url, room=ROOM))
        view = [sys.executable, __file__, "--window", str(desk.notes)]
        view += ["view", link, "--wait", "--size", f"{size[0]}x{size[1]}"]
        window = subprocess.Popen(view, env=desk.environment, cwd=ROOT)
        stack.callback(window.kill)

        def take(name: str) -> None:
            desk.wait_frames(3)
            desk.take(out / f"{name}-{suffix}")

        desk.type("##name", "Me")
        take("01-join")
        desk.click("Make my own")
        take("01-own")
        desk.click("Join")
        desk.wait("everybody", faces=len(PEOPLE), here=len(PEOPLE) + 1)
        take("02-call")
        for number, panel in enumerate(("Participants", "Settings", "Help"), 3):
            desk.click(panel)
            desk.wait("open", side=panel.lower())
            take(f"{number:02}-{panel.lower()}")
            desk.click("Close")
            desk.wait("closed", side="none")
        desk.click("Record")
        desk.wait("recording", is_recording=True)
        take("06-recording")
        desk.click("Stop recording")
        desk.wait("recorded", is_recording=False)
        take("07-recorded")
        desk.click("Next layout")
        take("08-layout")
        os.kill(relay.pid, signal.SIGKILL)
        desk.wait("the relay is gone", is_connected=False, away_s=2)
        take("09-relay-gone")
        port = url.rpartition(":")[2]
        again = children.start("relay again", "relay", "--port", port)
        desk.wait("back", is_connected=True, faces=len(PEOPLE))
        take("10-back")
        desk.click("Leave the call")
        take("11-leaving")
        desk.click("Leave")
        window.wait(60)
        again.let_go()


def show_window(notes: Path, arguments: list[str]) -> None:
    """Be the window's process: run a command, and note of each frame where its buttons are
    and how the call stands."""
    sys.path.insert(0, str(ROOT / "tests"))
    import pytest
    from imgui_bundle import imgui

    from helpers.hand import note_places
    from pica_client.ui import call_surface
    from pica_client.ui.avatar_presenter import AvatarPresenter, CallScene
    from pica_command.main import main as pica

    state: dict[str, Any] = {"frame": 0}

    def note_call(view: ViewState, call: CallView) -> None:
        state.update(
            here=len(call.status.participants),
            side=view.side,
            is_recording=view.is_recording,
            is_connected=call.status.is_connected,
            away_s=call.status.away_s,
        )

    def note_faces(presenter: AvatarPresenter, scene: CallScene) -> CallScene:
        state["faces"] = sum(map(bool, presenter.num_decoded().values()))
        return dressed(presenter, scene)

    call_surface.PANELS = (*call_surface.PANELS, note_call)
    dressed = AvatarPresenter.dressed
    AvatarPresenter.dressed = note_faces  # type: ignore[method-assign, assignment]
    render = imgui.render

    places = note_places(pytest.MonkeyPatch())

    def render_and_note() -> None:
        state["frame"] += 1
        part = notes.with_suffix(".part")
        part.write_text(json.dumps({**state, "places": places}))
        part.replace(notes)
        places.clear()
        render()

    imgui.render = render_and_note
    sys.argv = ["pica", *arguments]
    pica()


def main() -> None:
    """Do as the module's docstring says."""
    if sys.argv[1:2] == ["--window"]:
        show_window(Path(sys.argv[2]), sys.argv[3:])
        return
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("sizes", nargs="*", default=SIZES)
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    for text in chosen.sizes:
        sides, _, scale = text.partition("@")
        columns, rows = sides.split("x")
        photograph(chosen.out, (int(columns), int(rows)), float(scale or 1))


if __name__ == "__main__":
    main()
