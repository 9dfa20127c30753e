"""The call as a camera of this machine: frames for a device of v4l2loopback, which other programs
open as a camera. Linux alone; written after its ``videodev2.h``, and untested on a device.
"""

import os
import stat
import struct
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image as Pictures

from pica_client.errors import OptionError
from pica_core.types import Image

_SET_FORMAT: Final = 0xC0000000 | struct.calcsize("Pi196x") << 16 | ord("V") << 8 | 5
"""``VIDIOC_S_FMT``, which takes a ``v4l2_format``: of a kind, aligned, and 200 bytes."""
_VIDEO_OUTPUT, _PROGRESSIVE, _SRGB = 2, 1, 8
_FROM_RGB: Final = np.array([[257, -148, 439], [504, -291, -368], [98, 439, -71]], np.float32)
"""Columns for Y, U and V, thousandths: BT.601 in the range that cameras use."""


class CameraOutput:
    """A device that takes frames of one size; a file or a pipe gets them one after the other."""

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        """Open it, and tell it the size: columns, without an odd last one, and rows.

        Raises:
            OptionError: It is not there, or takes no frames.
        """
        if sys.platform != "linux":
            raise OptionError("camera needs Linux; elsewhere use OBS, see docs/join-by-a-link.md")
        import fcntl

        self._path, self.size = path, (size[0] // 2 * 2, size[1])
        width, height = self.size
        pixels = (width, height, int.from_bytes(b"YUYV", "little"), _PROGRESSIVE, 2 * width)
        wanted = struct.pack("P7i172x", _VIDEO_OUTPUT, *pixels, 2 * width * height, _SRGB)
        with _refused(path), ExitStack() as stack:
            self._file = stack.enter_context(path.open("r+b", buffering=0))  # never made
            if stat.S_ISCHR(os.fstat(self._file.fileno()).st_mode):
                taken = fcntl.ioctl(self._file, _SET_FORMAT, wanted)
                if taken[:20] != wanted[:20]:
                    raise OSError(0, f"it does not take {width}x{height} YUYV")
            stack.pop_all()

    def close(self) -> None:
        """Let go of it."""
        self._file.close()

    def write(self, image: Image) -> None:
        """Give a frame, uint8 ``[H, W, 3 or 4]``; one of another size is scaled.

        Raises:
            OptionError: It takes no more.
        """
        image = np.ascontiguousarray(image[:, : image.shape[1] // 2 * 2, :3])
        if image.shape[1::-1] != self.size:
            image = np.asarray(Pictures.fromarray(image).resize(self.size))
        data = packed(image).data.cast("B")
        with _refused(self._path):
            while data:
                data = data[self._file.write(data) :]


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = f"camera {path}: {error.strerror}; is v4l2loopback loaded?"
        raise OptionError(reason) from error


def packed(image: Image) -> Image:
    """A picture uint8 ``[H, W, 3]`` of even width as YUYV: ``[H, W, 2]``, two pixels sharing
    colours."""
    black = np.array([16, 128, 128], np.float32)
    yuv = image.astype(np.float32) @ (_FROM_RGB / 1000) + black
    found = np.empty((*image.shape[:2], 2), np.uint8)
    found[..., 0] = np.rint(yuv[..., 0])
    pairs = (yuv[:, ::2, 1:] + yuv[:, 1::2, 1:]) / 2
    found[..., 1] = np.rint(pairs).reshape(image.shape[:2])
    return found
