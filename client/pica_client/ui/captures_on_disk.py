"""Pictures and recordings that the user asks for during a call, each under a new name.

Names count up and say nothing of the time: ``picture-0001.png``, ``recording-0001.mp4``.
"""

from collections.abc import Callable
from pathlib import Path

from pica_client.closing import Closing
from pica_client.errors import OptionError
from pica_client.output import make_folder, writing
from pica_client.ui.recorder import Recorder, save_png
from pica_client.user_folders import pictures_folder, videos_folder
from pica_client.voice.sound.soundtrack import Soundtrack
from pica_core.types import Image

MAX_NUMBER = 9999
BeginSound = Callable[[], Soundtrack | None]
"""Gives the sound of a recording that begins; None: there is none."""


class CapturesOnDisk(Closing):
    """Writes into folders that are made when they are first needed.

    Its methods return what to tell the user, empty for nothing.

    Args:
        folder: Where to; None is the system's folders for pictures and for videos.
    """

    def __init__(self, folder: Path | None = None, begin_sound: BeginSound = lambda: None) -> None:
        self._begin_sound = begin_sound
        self._pictures = folder or pictures_folder()
        self._videos = folder or videos_folder()
        self._recorder: Recorder | None = None
        self._path = Path()

    @property
    def is_recording(self) -> bool:
        """Whether `write` is wanted."""
        return self._recorder is not None

    def save_picture(self, image: Image) -> str:
        """Write a picture, uint8 ``[H, W, 3]``.

        Raises:
            OptionError: It cannot be written.
        """
        path = new_path(self._pictures, "picture", ".png")
        save_png(path, image)
        return f"Saved {path.name} in {path.parent}"

    def toggle_recording(self, size: tuple[int, int]) -> str:
        """Begin a recording of images of this size, or end the one under way.

        Raises:
            OptionError: It cannot be written.
            ModuleNotFoundError: PyAV is not installed; names the extra.
        """
        if self._recorder is not None:
            return self.close()
        try:
            import av  # noqa: F401
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "recording needs PyAV: pip install 'pica-telepresence[video]'", name="av"
            ) from error
        self._path = new_path(self._videos, "recording", ".mp4")
        self._recorder = Recorder(self._path, size, self._begin_sound)
        return f"Recording into {self._path.name}"

    def write(self, image: Image, now: float) -> str:
        """Append a frame to the recording, if there is one.

        Raises:
            OptionError: The disk is full; the recording is over.
        """
        try:
            if self._recorder is not None:
                self._recorder.write(image, now)
        except OptionError:
            self._recorder = None
            raise
        return ""

    def close(self) -> str:
        """End the recording that is under way, if any.

        Raises:
            OptionError: The disk is full; the file cannot be played.
        """
        if self._recorder is None:
            return ""
        recorder, self._recorder = self._recorder, None
        recorder.close()
        return f"Saved {self._path.name} in {self._path.parent}"


def new_path(folder: Path, stem: str, suffix: str) -> Path:
    """Take the first free name, by making an empty file of it.

    Raises:
        OptionError: The folder cannot be made or written, or has no name left.
    """
    make_folder(folder)
    for number in range(1, MAX_NUMBER + 1):
        path = folder / f"{stem}-{number:04d}{suffix}"
        with writing(path):
            try:
                path.open("xb").close()
            except FileExistsError:
                continue
        return path
    raise OptionError(f"{folder}: all names up to {stem}-{MAX_NUMBER} are taken; move some away")
