"""Drawn frames into files: recordings of a call as MP4, and single PNG images; and the sound of a
recording: voices as they were heard and as they were said, on one time line.

Frames keep the times they were drawn at, so a call that was drawn unevenly plays at its true speed;
sound keeps the times it was heard at. A thread encodes, up to `MAX_WAITING` frames behind.
Needs PyAV (the `video` extra) and Pillow; importing this module does not.
"""

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from fractions import Fraction
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from pica_client.errors import OptionError
from pica_client.system import Closing, writing
from pica_client.voice.opus import SAMPLE_RATE_HZ
from pica_core.files import replacing
from pica_core.types import FloatArray, Image

MAX_ERROR_S = 0.03
"""Error of a place that is mended by a leap; less is not heard (chosen: a picture)."""
LATE_S = 0.5
"""Sound that is younger than this may not have come yet."""
MAX_SECONDS = 30.0
"""Sound that waits to be taken at most; more is dropped, as the recording has stopped drawing."""


class Soundtrack:
    """Takes sound on any thread, and gives it to a recording.

    Attributes:
        close: To be called once nothing more is wanted.
    """

    def __init__(self, on_close: Callable[[], None] = lambda: None) -> None:
        self.close = on_close
        self._lock = threading.Lock()
        self._begin_s: float | None = None
        self._sum = np.zeros((0, 2), np.float32)  # from sample number _at on
        self._at = 0
        self._ends: dict[str, int] = {}  # number of the next sample

    def begin(self, now: float) -> None:
        """Set when the recording begins; earlier sound is left out."""
        with self._lock:
            self._begin_s = now

    def add(self, who: str, sound: FloatArray, time_s: float) -> None:
        """Take the next sound of a source, float32 ``[n]`` or ``[n, 2]``, and when it begins."""
        with self._lock:
            if self._begin_s is None:
                return
            place = round((time_s - self._begin_s) * SAMPLE_RATE_HZ)
            end = self._ends.get(who, place)
            if abs(place - end) > MAX_ERROR_S * SAMPLE_RATE_HZ:
                end = place
            self._ends[who] = end + len(sound)
            both = sound if sound.ndim == 2 else np.repeat(sound[:, None], 2, axis=1)
            first = end - self._at
            both, first = both[max(-first, 0) :], max(first, 0)
            if first + len(both) > MAX_SECONDS * SAMPLE_RATE_HZ:
                return
            missing = first + len(both) - len(self._sum)
            if missing > 0:
                more = max(missing, SAMPLE_RATE_HZ)  # seldom, and so cheaply
                self._sum = np.concatenate([self._sum, np.zeros((more, 2), np.float32)])
            self._sum[first : first + len(both)] += both

    def take(self, until_s: float) -> tuple[FloatArray, int]:
        """All up to a time after the beginning that was not given yet, float32 ``[n, 2]`` within
        [-1, 1], and the number of its first sample. Gaps are silence."""
        with self._lock:
            count = max(round(until_s * SAMPLE_RATE_HZ) - self._at, 0)
            taken = np.zeros((count, 2), np.float32)
            there = self._sum[:count]
            taken[: len(there)] = np.clip(there, -1, 1)
            first, self._sum = self._at, self._sum[count:]
            self._at += count
        return taken, first


TICKS_PER_S = 60
"""Resolution of a frame's time. It is also the rate that players and editors take a recording to
have, of which the frames that were not drawn are missing: at a finer one they speak of 1000 a
second (chosen: displays seldom do more)."""
SOUND_BPS = 128_000
"""Bits a second of the sound, AAC in stereo (chosen: voices lose nothing that is heard)."""
CONTAINER = {"movflags": "hybrid_fragmented+delay_moov", "flush_packets": "1"}
"""A file that plays up to its last key frame if the process is killed, and is a plain MP4 once it
is closed (FFmpeg 7.1)."""
KEY_FRAMES = 60
"""A key frame after so many frames, two seconds of a call: the most that a kill costs (chosen)."""
MAX_WAITING = 2
"""Frames that wait for the encoder at most; the next one is taken when the oldest is done (chosen:
one that takes long delays no image, and a slow machine keeps no more than that in memory)."""


class Recorder(Closing):
    """Writes an MP4 of H.264 and AAC.

    Args:
        path: File to write; replaced if it exists.
        size: Columns and rows of the images. Odd sizes lose their last row or column: video needs
            even ones.
        begin_sound: Gives the sound to go with it; None: there is none.

    Attributes:
        path: The file.

    Raises:
        OptionError: The file cannot be written.
        ModuleNotFoundError: PyAV is not installed.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        begin_sound: Callable[[], Soundtrack | None] = lambda: None,
    ) -> None:
        try:
            import av
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "recording needs PyAV: pip install 'pica-telepresence[video]'", name="av"
            ) from error
        width, height = size[0] - size[0] % 2, size[1] - size[1] % 2
        self._size, self._window_size = (width, height), size
        self.path = path
        self._last_tick = -1
        self._begin_s: float | None = None
        self._av: Any = av
        with writing(path):
            path.open("wb").close()  # FFmpeg would find out with the first frame only
            self._container: Any = av.open(str(path), "w", format="mp4", options=CONTAINER)
        stream: Any = self._container.add_stream("libx264", rate=TICKS_PER_S)
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, TICKS_PER_S)
        # One thread: the cores belong to the rasteriser. At 1280x720 this costs 4.5 ms a frame, at
        # an MSE of 3.1 and 7.6 KB; "superfast", which looks ahead, 8 to 11 ms, at 2.7 and 7.8 KB.
        stream.thread_count = 1
        stream.gop_size = KEY_FRAMES
        stream.options = {"preset": "ultrafast", "tune": "zerolatency", "crf": "20"}
        self._stream = stream
        self._encoder = ThreadPoolExecutor(1, "recorder")
        self._waiting: deque[Future[None]] = deque()
        self._sound = begin_sound()
        if self._sound is not None:
            self._sound_stream = self._container.add_stream("aac", rate=SAMPLE_RATE_HZ)
            self._sound_stream.layout = "stereo"
            self._sound_stream.bit_rate = SOUND_BPS
            self._sound_stream.options = {"aac_coder": "fast"}

    def write(self, image: Image, time_s: float) -> None:
        """Append a frame.

        Args:
            image: uint8 ``[H, W, 4]``, top row first, of which the last is not looked at; must not
                change afterwards. One of another size is scaled to fit, with black bars where its
                shape differs.
            time_s: When it was drawn, on the clock of the sound; the first is the beginning. Frames
                that come within a tick of the last one are dropped, and those after `close`.

        Raises:
            OptionError: The disk is full, as one of the last frames was written; the recording is
                over.
        """
        while self._waiting and (len(self._waiting) >= MAX_WAITING or self._waiting[0].done()):
            self._waiting.popleft().result()
        if self._begin_s is None:
            self._begin_s = time_s
            if self._sound is not None:
                self._sound.begin(time_s)
        tick = round((time_s - self._begin_s) * TICKS_PER_S)
        if tick <= self._last_tick or self._container is None:
            return
        self._last_tick = tick
        self._waiting.append(self._encoder.submit(self._encode, image, tick))

    def close(self) -> None:
        """Finish the file. Once is enough, twice is harmless.

        Raises:
            OptionError: The disk is full, or there is not one frame and therefore no file.
        """
        self._encoder.shutdown()
        while self._waiting:
            self._waiting.popleft().result()
        if self._container is None:
            return
        self._mux(self._stream, None)
        self._write_sound((self._last_tick + 1) / TICKS_PER_S, is_last=True)
        if self._container is not None:
            container, self._container = self._container, None
            with writing(self.path):
                container.close()
        if self._last_tick < 0:
            self.path.unlink(missing_ok=True)
            raise OptionError(f"{self.path}: no picture was drawn, so there is no recording")

    def _encode(self, image: Image, tick: int) -> None:
        """Append a frame, and the sound up to it; on the encoder's thread."""
        if image.shape[1::-1] != self._window_size:
            image = _fitted(image, self._size)
        width, height = self._size
        canvas = np.ascontiguousarray(image[:height, :width])
        frame = self._av.VideoFrame.from_numpy_buffer(canvas, format="rgba")
        frame.pts = tick
        frame.time_base = Fraction(1, TICKS_PER_S)
        self._mux(self._stream, frame)
        self._write_sound(tick / TICKS_PER_S - LATE_S)

    def _write_sound(self, until_s: float, *, is_last: bool = False) -> None:
        if self._sound is None or self._container is None:
            return
        samples, first = self._sound.take(until_s)
        if len(samples):
            frame = self._av.AudioFrame.from_ndarray(
                np.ascontiguousarray(samples.T), format="fltp", layout="stereo"
            )
            frame.sample_rate, frame.pts = SAMPLE_RATE_HZ, first
            frame.time_base = Fraction(1, SAMPLE_RATE_HZ)
            self._mux(self._sound_stream, frame)
        if is_last:
            self._mux(self._sound_stream, None)
            self._sound.close()

    def _mux(self, stream: Any, frame: Any) -> None:
        """Encode a frame, or what is left with None, into the file."""
        if self._container is None:
            return
        with writing(self.path):
            try:
                self._container.mux(stream.encode(frame))
            except OSError:
                # FFmpeg crashes when it is to go on with a file whose header it could not write.
                container, self._container = self._container, None
                if self._sound is not None:
                    self._sound.close()
                with suppress(OSError):
                    container.close()
                raise


def _fitted(image: Image, size: tuple[int, int]) -> Image:
    """The whole of an image, as large as fits into the middle of one of this size, on black."""
    from PIL import Image as PillowImage
    from PIL import ImageOps

    whole = PillowImage.fromarray(image)
    # Twice as fast as the default, and no difference is seen in a recording.
    return np.asarray(ImageOps.pad(whole, size, PillowImage.Resampling.BILINEAR))


def save_png(path: Path, image: Image) -> None:
    """Write one image, uint8 ``[H, W, 3]``; OptionError if the file cannot be written."""
    from PIL import Image as PillowImage

    with writing(path), replacing(path) as unfinished:
        PillowImage.fromarray(image).save(unfinished, format="png")


def new_path(folder: Path, stem: str, suffix: str) -> Path:
    """Return the first name that is free; names count up and say nothing of the time.

    Raises:
        OptionError: The folder cannot be made.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = (folder / f"{stem}-{number:04d}{suffix}" for number in count(1))
    return next(path for path in paths if not path.exists())
