"""Drawn frames into files: an MP4 of a call, and single PNG images.

    with Recorder(Path("call.mp4"), (960, 540)) as recorder:
        recorder.write(image, time_s)

Frames keep the times they were drawn at, so a call that was drawn unevenly plays at its true speed.
Needs PyAV (the `video` extra); importing this module does not.
"""

from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from pica_client.errors import OptionError
from pica_client.output import writing, writing_whole
from pica_core.types import Image

TICKS_PER_S = 60
"""Resolution of a frame's time. It is also the rate that players and editors take a recording to
have, of which the frames that were not drawn are missing: at a finer one they speak of 1000 a
second (chosen: displays seldom do more)."""


class Recorder:
    """Writes an MP4: H.264 where this build of FFmpeg has it, else MPEG-4 part 2.

    Args:
        path: File to write; replaced if it exists.
        size: Columns and rows of the images. Odd sizes lose their last row or column: video needs
            even ones.

    Raises:
        OptionError: The file cannot be written.
        ModuleNotFoundError: PyAV is not installed.
    """

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        import av

        width, height = size[0] - size[0] % 2, size[1] - size[1] % 2
        if width < 2 or height < 2:
            raise OptionError(f"size is {size[0]}x{size[1]}; a video needs at least 2x2")
        self._size = (width, height)
        self._path = path
        self._last_tick = -1
        self._av: Any = av
        with writing(path):
            path.open("wb").close()  # FFmpeg would find out with the first frame only
            self._container: Any = av.open(str(path), "w", format="mp4")
        has_h264 = "libx264" in av.codecs_available
        self.codec = "libx264" if has_h264 else "mpeg4"
        stream: Any = self._container.add_stream(self.codec, rate=TICKS_PER_S)
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, TICKS_PER_S)
        # One thread: the cores belong to the rasteriser. "veryfast" costs 4 ms for 960x540.
        stream.thread_count = 1
        if has_h264:
            stream.options = {"preset": "veryfast", "crf": "20"}
        else:
            stream.bit_rate = 8_000_000
        self._stream = stream

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def write(self, image: Image, time_s: float) -> None:
        """Append a frame.

        Args:
            image: uint8 ``[H, W, 3]``, top row first. One of another size is cropped, or stands on
                black.
            time_s: Since the start of the recording. Frames that come within a tick of the last one
                are dropped, and those that come after `close`.

        Raises:
            OptionError: The disk is full; the recording is over.
        """
        tick = round(time_s * TICKS_PER_S)
        if tick <= self._last_tick or self._container is None:
            return
        self._last_tick = tick
        width, height = self._size
        canvas = image[:height, :width]
        if canvas.shape != (height, width, 3):  # the window has become smaller than the recording
            canvas = np.zeros((height, width, 3), np.uint8)
            canvas[: image.shape[0], : image.shape[1]] = image[:height, :width]
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(canvas), format="rgb24")
        frame.pts = tick
        frame.time_base = Fraction(1, TICKS_PER_S)
        self._mux(frame)

    def close(self) -> None:
        """Finish the file. Once is enough, twice is harmless.

        Raises:
            OptionError: The disk is full; the file cannot be played.
        """
        if self._container is None:
            return
        self._mux(None)
        if self._container is not None:
            container, self._container = self._container, None
            with writing(self._path):
                container.close()

    def _mux(self, frame: Any) -> None:
        """Encode a frame, or what is left with None, into the file."""
        with writing(self._path):
            try:
                self._container.mux(self._stream.encode(frame))
            except OSError:
                # FFmpeg crashes when it is to go on with a file whose header it could not write.
                container, self._container = self._container, None
                with suppress(OSError):
                    container.close()
                raise


def save_png(path: Path, image: Image) -> None:
    """Write one image, uint8 ``[H, W, 3]``.

    Raises:
        OptionError: The file cannot be written.
    """
    from PIL import Image as PillowImage

    with writing_whole(path) as unfinished:
        PillowImage.fromarray(image).save(unfinished, format="png")
