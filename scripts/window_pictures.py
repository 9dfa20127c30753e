"""Pictures of the viewer's window in a real call: each layout with five people, with and without
statistics, a pinned participant, help, banners, and the join form.

    xvfb-run -a -s "-screen 0 2560x1440x24" python scripts/window_pictures.py OUT [COLUMNSxROWS ...]

Writes OUT/NAME-COLUMNSxROWS.png, and of the first size OUT/sheet.jpg, which is docs/viewer.jpg.

Starts a relay and five senders on this machine, opens the window that `pica view` opens, presses
its keys, and takes each picture by its own screenshot key. Faces are the generated ones that ship.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from PIL import Image

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.call import Call
from pica_client.local_call.local_call import ROOM, LocalCall, LocalCallConfig
from pica_client.local_call.processes import Children
from pica_client.render.recorder import save_png
from pica_client.render.renderer import Renderer
from pica_client.render.seats import LAYOUTS
from pica_client.transport.config import LinkConfig
from pica_client.transport.monitor import CallMonitor
from pica_client.transport.receiver import Receiver
from pica_client.ui.controls import KeyPressed, OwnFace
from pica_client.ui.join_dialog import empty_room
from pica_client.ui.join_form import Fields, JoinForm
from pica_client.ui.view_session import make_publisher
from pica_client.ui.viewer import Viewer, ViewerOptions
from pica_client.ui.window import Window

SIZES = ((1280, 720), (2560, 1440))
PEOPLE = 5
SETTLE_S = 3.0
"""For figures and the speaking hint to mean something."""
AWAY_S = 6.0
SHEET = (
    "layout-line",
    "layout-arc",
    "layout-table",
    "layout-grid",
    "pinned-arc-statistics",
    "join",
)
SHEET_COLUMNS = 2
CELL_PX = 640


class Photographer:
    """Presses keys of a viewer and keeps what it shows.

    Args:
        viewer: In a window.
        folder: Where pictures go; the viewer's `keep_in`.
        size: For their names.
    """

    def __init__(self, viewer: Viewer, folder: Path, size: tuple[int, int]) -> None:
        self._viewer = viewer
        self._folder = folder
        self._suffix = f"{size[0]}x{size[1]}"

    @property
    def layout(self) -> str:
        """How people sit."""
        return self._viewer.controls.state.layout

    def press(self, *keys: str) -> None:
        """Press keys one after the other."""
        for key in keys:
            self._viewer.receive(KeyPressed(key))

    def run(self, seconds: float) -> None:
        """Let the call go on."""
        self._viewer.run(seconds)

    def take(self, name: str, seconds: float = 0.7) -> None:
        """Let the call go on for a moment, and keep the picture under a name."""
        self.run(seconds)
        before = set(self._folder.glob("picture-*.png"))
        self.press("P")
        self._viewer.step(time.monotonic())
        (taken,) = set(self._folder.glob("picture-*.png")) - before
        taken.replace(self._folder / f"{name}-{self._suffix}.png")
        print(f"{name}-{self._suffix}.png", flush=True)


def photograph_call(camera: Photographer, lose_relay: Callable[[], object]) -> None:
    """Take all pictures of a call with people in it; the relay is lost at the end."""
    camera.run(SETTLE_S)
    for _ in LAYOUTS:
        layout = camera.layout
        # The notice of the picture before is gone by then.
        camera.take(f"layout-{layout}", 4.5)
        camera.press("S")
        camera.take(f"statistics-{layout}", 4.5)
        camera.press("3")
        camera.take(f"pinned-{layout}-statistics", 4.5)
        camera.press("S")
        camera.take(f"pinned-{layout}", 4.5)
        camera.press("0", "L")
    camera.press("H")
    camera.take("help", 4.5)
    camera.press("H", "M", "V")
    camera.take("muted-recording")
    camera.press("V", "F")
    camera.take("frozen", 4.5)
    camera.press("F")
    lose_relay()
    camera.take("connection-lost", AWAY_S)


def photograph_form(folder: Path, size: tuple[int, int]) -> None:
    """Take the join form, as it begins and with an error in it."""
    given = Fields(url="wss://relay.example:8765", room="standup", name="Ada")
    wrong = replace(given, room="a room with spaces", token="eyJhbGciOiJIUzI1")
    with Window("PiCA Telepresence", size) as window:
        renderer = Renderer(window.context, window.size_px)
        for name, fields, key in (("join", given, "Tab"), ("join-error", wrong, "Enter")):
            form = JoinForm(fields)
            form.receive(KeyPressed(key))
            renderer.draw([], empty_room(), [form.item(renderer.size)])
            window.show(renderer)
            save_png(folder / f"{name}-{size[0]}x{size[1]}.png", renderer.read_image())
            print(f"{name}-{size[0]}x{size[1]}.png", flush=True)


def photograph(folder: Path, size: tuple[int, int]) -> None:
    """Hold a call of five and take its pictures in a window of this size."""
    library = AvatarLibrary()
    try:
        with Children() as children:
            stage = LocalCall(LocalCallConfig(peers=PEOPLE), library, children)
            call = Call(library)
            publisher = make_publisher("performance:talk", None, library)
            link = LinkConfig(url=stage.url, room=ROOM, name="Me", connect_timeout_s=20)
            receiver = Receiver(link, call, publisher=publisher)

            def set_own_face(wanted: OwnFace) -> None:
                if wanted != "none":
                    publisher.set_mode(wanted)

            with receiver:
                while call.num_live < PEOPLE:
                    receiver.check()
                    stage.check()
                    time.sleep(0.05)
                options = ViewerOptions(size=size, keep_in=folder, sends_face=True)
                with Viewer(
                    call,
                    options,
                    status=CallMonitor(receiver).status,
                    on_own_face=set_own_face,
                ) as viewer:
                    viewer.prepare()
                    photograph_call(Photographer(viewer, folder, size), stage.relay.let_go)
    finally:
        library.close()


def make_sheet(folder: Path, size: tuple[int, int]) -> None:
    """Put some of the pictures side by side."""
    cell = (CELL_PX, CELL_PX * size[1] // size[0])
    rows = math.ceil(len(SHEET) / SHEET_COLUMNS)
    sheet = Image.new("RGB", (SHEET_COLUMNS * cell[0], rows * cell[1]))
    for index, name in enumerate(SHEET):
        with Image.open(folder / f"{name}-{size[0]}x{size[1]}.png") as image:
            row, column = divmod(index, SHEET_COLUMNS)
            small = image.resize(cell, Image.Resampling.LANCZOS)
            sheet.paste(small, (column * cell[0], row * cell[1]))
    sheet.save(folder / "sheet.jpg", quality=90, optimize=True)


def main() -> None:
    """Take all pictures in all sizes."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    given = [text.partition("x") for text in sys.argv[2:]]
    sizes = [(int(columns), int(rows)) for columns, _, rows in given] or SIZES
    for size in sizes:
        photograph_form(folder, size)
        photograph(folder, size)
    make_sheet(folder, sizes[0])


if __name__ == "__main__":
    main()
