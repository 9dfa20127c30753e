"""Small pictures of the avatars of this machine, drawn beside the form, kept for the next time."""

import threading
from pathlib import Path

import numpy as np
from PIL import Image as PillowImage
from PIL import UnidentifiedImageError

from pica_client.avatars.library import AvatarLibrary
from pica_client.errors import ClientError
from pica_client.output import make_folder
from pica_client.render.recorder import save_png
from pica_client.render.thumbnail import draw_thumbnail
from pica_client.user_folders import cache_folder
from pica_core.errors import AvatarFileError, GraphicsError
from pica_core.types import Image

SIDE_PX = 128


class Portraits:
    """Draws a picture of each avatar, one after the other, on a thread and a GL context of its own.

    Args:
        folder: Where pictures are kept; by default beside the avatars that can be fetched again.
    """

    def __init__(self, library: AvatarLibrary, folder: Path | None = None) -> None:
        self._library = library
        self._folder = folder or cache_folder().parent / "portraits"
        self._pictures: dict[str, Image] = {}
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(target=self._draw_all, name="portraits", daemon=True)
        self._thread.start()

    def take(self) -> dict[str, Image]:
        """The pictures so far, uint8 ``[H, W, 3]`` by the avatar's name."""
        return dict(self._pictures)

    def close(self) -> None:
        """Draw no more; what is being drawn is waited for."""
        self._is_stopping.set()
        self._thread.join()

    def _draw_all(self) -> None:
        for name in self._library.names:
            if self._is_stopping.is_set():
                return
            try:
                self._pictures[name] = self._picture(name)
            except (AvatarFileError, ClientError, GraphicsError):
                continue  # a form without this picture is still a form

    def _picture(self, name: str) -> Image:
        identity = self._library.find(name)
        path = self._folder / f"{identity}-{SIDE_PX}.png"
        try:
            with PillowImage.open(path) as image:
                kept = np.asarray(image.convert("RGB"))
            if kept.shape == (SIDE_PX, SIDE_PX, 3):
                return kept
        except (OSError, UnidentifiedImageError):
            pass  # none there yet, or a broken one: it is drawn anew
        drawn = draw_thumbnail(self._library.load(identity), (SIDE_PX, SIDE_PX))
        make_folder(self._folder)
        save_png(path, drawn)
        return drawn
