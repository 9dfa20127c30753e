"""The pictures of a call in README and docs/viewer.md, drawn off the screen.

    python scripts/call_pictures.py docs/call.png docs/viewer.jpg

Five generated performances on the avatars that ship, without a network: the first picture is a call
of five, the second a sheet of the layouts, on pictures of several shapes.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from pica_client.avatars.library import AvatarLibrary
from pica_client.call.faces import FaceState
from pica_client.sources.performances import make_performance
from pica_client.ui.viewer import Viewer
from pica_client.ui.viewer_options import ViewerOptions
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar

FPS = 30
BEGIN_S = 40.0
SECONDS = 2.0
"""For the speaking hint to mean something."""
CALL: tuple[tuple[int, int], int, dict[str, Any]] = ((960, 540), 5, {})
SHEET: tuple[tuple[tuple[int, int], int, dict[str, Any]], ...] = (
    ((640, 360), 5, {"layout": "table"}),
    ((640, 360), 5, {"layout": "grid"}),
    ((640, 360), 5, {"pinned": 2}),
    ((640, 360), 3, {"layout": "line"}),
    ((216, 360), 5, {}),
    ((216, 360), 5, {"pinned": 3}),
    ((480, 360), 5, {}),
    ((368, 360), 2, {}),
)
"""Size, people and what the user did; each row of the sheet is `SHEET_WIDTH` wide."""
SHEET_WIDTH = 1280


class Performers:
    """People who perform, each on one of the shipped avatars."""

    def __init__(self, library: AvatarLibrary, count: int) -> None:
        self._people = []
        self._avatars: dict[str, Avatar] = {}
        for number, name in enumerate(library.names[:count]):
            identity = library.find(name)
            avatar = self._avatars[identity] = library.load(identity)
            track = make_performance("talk" if number % 2 else "listen", seed=number)
            self._people.append(
                (f"peer-{number}", name, identity, ExpressionEncoder(avatar), track)
            )

    def faces(self, now: float) -> list[FaceState]:
        """Everybody at a time of their performance."""
        found = []
        for place, (peer_id, name, identity, encoder, track) in enumerate(self._people):
            frame = track.frame_at(BEGIN_S + now)
            face = FaceState(
                peer_id=peer_id,
                place=place,
                name=name.title(),
                avatar_id=identity,
                latent=encoder.encode(frame.arkit),
                rotation=frame.rotation,
                translation_m=frame.translation_m,
            )
            found.append(face)
        return found

    def avatar(self, avatar_id: str) -> Avatar:
        """Everybody's is there."""
        return self._avatars[avatar_id]

    def subscribe(self, peer_id: str, layer: int | None, now: float) -> None:
        """Nothing is sent."""


def draw(
    library: AvatarLibrary, size: tuple[int, int], count: int, state: dict[str, Any], path: Path
) -> None:
    """Let a call go on for a moment and keep what is seen at its end."""
    options = ViewerOptions(headless=True, size=size, frame_budget_ms=1000)
    with Viewer(Performers(library, count), options, clock=lambda: 0.0) as viewer:
        viewer.controls.state = replace(viewer.controls.state, **state)
        for number in range(round(SECONDS * FPS)):
            viewer.step(number / FPS)
            viewer.wait_decoded(10.0)
        viewer.save_image(path)


def main() -> None:
    """Draw both."""
    call, sheet_file = Path(sys.argv[1]), Path(sys.argv[2])
    library = AvatarLibrary()
    draw(library, *CALL, call)
    sheet = Image.new("RGB", (SHEET_WIDTH, 3 * SHEET[0][0][1]))
    x = y = 0
    with tempfile.TemporaryDirectory() as folder:
        for size, count, state in SHEET:
            draw(library, size, count, state, Path(folder) / "cell.png")
            with Image.open(Path(folder) / "cell.png") as cell:
                sheet.paste(cell, (x, y))
            x += size[0]
            if x >= SHEET_WIDTH:
                x, y = 0, y + size[1]
    sheet.save(sheet_file, quality=88, optimize=True)
    library.close()


if __name__ == "__main__":
    main()
