"""Pictures of the viewer's window, steered by mouse: join, pin, settings, record, leave.

    python scripts/window_pictures.py OUT [COLUMNSxROWS[@SCALE] ...]

Needs Xvfb, xdotool and xprop. For each size it starts an X server, a relay, five people with names
in six scripts, two who only watch, one who encrypts and one whose avatar nobody has; then it runs
`pica view` with an invite link, as a process of its own, and moves and clicks the pointer of the X
server. Where buttons are is noted by the window's process as it draws them. Pictures are taken of
the screen: OUT/NAME-COLUMNSxROWS@SCALE.png.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from PIL import ImageGrab

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.local_call.processes import Child, Children
from pica_client.transport.config import LinkConfig
from pica_client.transport.receiver import Receiver
from pica_core.avatar.file import load_avatar, save_avatar
from pica_protocol.invite import Invite, make_link

ROOT = Path(__file__).resolve().parents[1]
SIZES = ("1280x720", "320x240", "2560x1440", "2560x1440@2")
ROOM = "standup"
PEOPLE = (
    ("Ada Lovelace", "sam", "talk"),
    ("Ольга Петровна", "amara", "listen"),
    ("李小龍 さくら 김", "yun", "talk"),
    ("מרים  مريم", "amara", "listen"),
    ("Ελένη 😀🎉", "henrik", "talk"),
)
PATIENCE_S = 60.0


class Desk:
    """An X server with a pointer, and one window on it."""

    def __init__(self, size: tuple[int, int], scale: float, folder: Path) -> None:
        self.places = folder / "places.json"
        self._folder = folder
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
        """Click on what is labelled so, once it is there and stands still."""
        left, top, right, bottom = self._where(label)
        self.point((left + right) / 2, (top + bottom) / 2)
        time.sleep(0.4)
        self._run("xdotool", "click", "1")

    def point(self, x: float, y: float) -> None:
        """Move the pointer."""
        self._run("xdotool", "mousemove", str(round(x)), str(round(y)))

    def is_shown(self, label: str) -> bool:
        """Whether something is labelled so in the latest frame."""
        try:
            return any(label in known for known in json.loads(self.places.read_text()))
        except (OSError, ValueError):
            return False

    def take(self, path: Path) -> None:
        """Take a picture of the screen."""
        ImageGrab.grab(xdisplay=self.display).save(path)
        print(path.name, flush=True)

    def _where(self, label: str) -> list[float]:
        end, before = time.monotonic() + PATIENCE_S, None
        while time.monotonic() < end:
            try:
                places = json.loads(self.places.read_text())
            except (OSError, ValueError):
                places = {}
            found = next((rect for known, rect in places.items() if label in known), None)
            if found is not None and found == before:
                return list(found)
            before = found
            time.sleep(0.3)
        raise TimeoutError(f"nothing is labelled {label!r}; there are {sorted(places)}")

    def _run(self, *command: str) -> None:
        subprocess.run(command, env=self.environment, check=True, timeout=20)


@contextmanager
def room_of_people(children: Children) -> Iterator[tuple[Child, str]]:
    """A relay and everybody in it; gives the relay and its address."""
    relay, url = children.start_relay()
    secret = children.folder / "secret"
    children.start("secret", "secret", str(secret)).wait(time.monotonic() + 20)
    for name, avatar, source in PEOPLE:
        start_sender(children, url, name, avatar, source)
    unknown = children.folder / "unknown.pica"
    sam = load_avatar(AvatarLibrary().path(AvatarLibrary().find("sam")))
    save_avatar(unknown, replace(sam, manifest=replace(sam.manifest, name="Nowhere")))
    start_sender(children, url, "Nobody's friend", "amara", "talk", "--secret-file", str(secret))
    start_sender(children, url, "Mina of nowhere", str(unknown), "talk")
    library = AvatarLibrary()
    with ExitStack() as stack:
        for name in ("Watching Wanda", "Watching Walter"):
            link = LinkConfig(url=url, room=ROOM, name=name, connect_timeout_s=20)
            stack.enter_context(Receiver(link, Call(library)))
        yield relay, url


def start_sender(
    children: Children, url: str, name: str, avatar: str, source: str, *more: str
) -> None:
    """Let somebody send a face."""
    where = ("--url", url, "--room", ROOM, "--name", name)
    face = ("--avatar", avatar, "--source", f"performance:{source}", "--give-avatar", "no")
    children.start(name, "send", *where, *face, *more)


def photograph(out: Path, size: tuple[int, int], scale: float) -> None:
    """Go through a call, and take a picture at each step."""
    suffix = f"{size[0]}x{size[1]}@{scale:g}.png"
    with Children() as children, tempfile.TemporaryDirectory() as home, ExitStack() as stack:
        desk = Desk(size, scale, Path(home))
        stack.callback(desk.close)
        relay, url = stack.enter_context(room_of_people(children))
        link = make_link(Invite(url=url, room=ROOM))
        columns, rows = size if scale == 1 else (round(size[0]), round(size[1]))
        view = [sys.executable, __file__, "--window", str(desk.places)]
        view += ["view", link, "--size", f"{columns}x{rows}"]
        window = subprocess.Popen(view, env=desk.environment, cwd=ROOT)
        stack.callback(window.kill)

        def take(name: str, seconds: float = 1.5) -> None:
            time.sleep(seconds)
            desk.take(out / f"{name}-{suffix}")

        time.sleep(3.0)
        desk.click("##name")
        time.sleep(1.0)
        subprocess.run(["xdotool", "type", "--delay", "80", "Me"], env=desk.environment, check=True)
        take("01-join", 5.0)
        desk.click("Join")
        take("02-connecting", 0.2)
        # Seven people in an arc: the one in the middle.
        desk.point(size[0] / 2, size[1] * 0.36)
        take("03-call", 8.0)
        subprocess.run(["xdotool", "click", "1"], env=desk.environment, check=True)
        take("04-pinned", 3.0)
        desk.point(size[0] / 2, size[1] * 0.2)
        if desk.is_shown("Got it"):
            desk.click("Got it")
        for number, panel in enumerate(("Participants", "Settings", "Help"), 5):
            desk.click(panel)
            take(f"{number:02}-{panel.lower()}")
            desk.click("Close")
        desk.click("Record")
        desk.point(size[0] / 2, size[1] * 0.7)
        take("08-recording", 2.5)
        desk.click("Stop recording")
        take("09-recorded", 0.7)
        desk.click("Next layout")
        take("10-layout")
        relay.let_go()
        desk.point(size[0] / 2, size[1] * 0.4)
        take("11-relay-gone", 5.0)
        desk.point(size[0] / 2, size[1] * 0.6)
        desk.click("Leave the call")
        take("12-leaving", 1.0)
        desk.click("Leave")
        window.wait(20)


def show_window(places: Path, arguments: list[str]) -> None:
    """Be the window's process: run a command, and note where its buttons are."""
    sys.path.insert(0, str(ROOT / "tests"))
    import pytest
    from imgui_bundle import imgui

    from helpers.hand import note_places
    from pica_command.main import main as pica

    noted = note_places(pytest.MonkeyPatch())
    render = imgui.render

    def render_and_note() -> None:
        part = places.with_suffix(".part")
        part.write_text(json.dumps(noted))
        part.replace(places)
        noted.clear()
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
