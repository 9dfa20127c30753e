"""Pictures of a camera, or of a video that stands in for one, in PyAV's hands."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from PIL import Image

from pica_client.errors import SourceError

FORMATS: Final = {"linux": "v4l2", "darwin": "avfoundation", "win32": "dshow"}
DEVICE_OPTIONS: Final = {"video_size": "640x480", "framerate": "30"}
"""What nearly every camera can do; who cannot is asked without."""
MAX_PIXELS: Final = 4096 * 2304


def device_of(text: str) -> tuple[str, str | None]:
    """What PyAV is to open: a file, or a device and the kind of device. The user wrote nothing, a
    camera's number or name, or a file."""
    path = Path(text).expanduser()
    if text and path.is_file():
        return str(path), None
    kind = FORMATS.get(sys.platform, "v4l2")
    if kind == "v4l2":
        return (f"/dev/video{text or 0}" if not text or text.isdecimal() else text), kind
    if kind == "dshow":
        return f"video={text or 'Integrated Camera'}", kind
    return text or "0", kind


def open_camera(text: str) -> Any:
    """Open a camera or a video.

    Raises:
        SourceError: It is not there, is busy, or is none.
    """
    try:
        import av
    except ImportError as error:
        raise SourceError("webcam: install the extra webcam; PyAV is missing") from error
    name, kind = device_of(text)
    if kind == "v4l2" and not Path(name).exists():
        raise SourceError(f"webcam: there is neither a camera nor a file {name}")
    tries: list[dict[str, str]] = [{}] if kind is None else [DEVICE_OPTIONS, {}]
    for options in tries:
        try:
            container = av.open(name, format=kind, options=options)
        except (OSError, ValueError, LookupError) as error:
            reason = error
            continue
        if container.streams.video:
            return container
        container.close()
        raise SourceError(f"webcam: {name} has no pictures")
    busy = "; does another program use it?" if kind else ""
    raise SourceError(f"webcam: {name}: {getattr(reason, 'strerror', None) or reason}{busy}")


def pictures(
    container: Any, is_video: bool, wait: Callable[[float], bool]
) -> Iterator[tuple[Image.Image, float | None]]:
    """Give its pictures as they come, until the camera is gone. A video is shown at its own speed,
    again and again.

    Args:
        container: From `open_camera`.
        is_video: Whether it is a video.
        wait: Waits some seconds; returns whether to stop.

    Yields:
        A picture, and when it was taken, seconds by the camera's clock, if that is known.
    """
    import av

    began_s, offset_s, last_s = time.monotonic(), 0.0, 0.0
    while True:
        with contextlib.suppress(av.FFmpegError):  # damaged from here on, or the camera was pulled
            for frame in container.decode(video=0):
                if frame.width * frame.height > MAX_PIXELS:
                    return
                taken_s = frame.time
                if is_video:
                    last_s = offset_s + (taken_s if taken_s is not None else last_s + 1 / 30)
                    if wait(max(began_s + last_s - time.monotonic(), 0.0)):
                        return
                    taken_s = last_s
                elif wait(0.0):
                    return
                yield frame.to_image(), taken_s
        if not is_video or last_s <= offset_s:
            return
        offset_s = last_s + 1 / 30
        with contextlib.suppress(av.FFmpegError):  # who has no beginning gives nothing more
            container.seek(0)
