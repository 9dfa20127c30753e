"""The call as a camera of this machine: frames for a device of v4l2loopback, which other programs
open as a camera. Linux alone; written after its ``videodev2.h``, and untested on a device.
"""

import os
import stat
import struct
import sys
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image as Pictures

from pica_client.errors import OptionError
from pica_core.types import Image

_SET_FORMAT: Final = 0xC0000000 | struct.calcsize("Pi196x") << 16 | ord("V") << 8 | 5
"""``VIDIOC_S_FMT``, which takes a ``v4l2_format``: of a kind, aligned, and 200 bytes."""
_VIDEO_OUTPUT, _PROGRESSIVE, _SRGB = 2, 1, 8
_FROM_RGB: Final = np.array(
    [[0.257, -0.148, 0.439], [0.504, -0.291, -0.368], [0.098, 0.439, -0.071]], np.float32
)
"""Columns for Y, U and V: BT.601 in the range that cameras use."""
_BLACK: Final = np.array([16, 128, 128], np.float32)


class CameraOutput:
    """A device that takes frames of one size; a file or a pipe gets them one after the other."""

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        """Open it, and tell it the size: columns, of which an odd last one is left out, and rows.

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
        try:
            self._file = path.open("r+b", buffering=0)  # a device is never made
        except OSError as error:
            raise self._failure(error) from error
        try:
            if stat.S_ISCHR(os.fstat(self._file.fileno()).st_mode):
                taken = fcntl.ioctl(self._file, _SET_FORMAT, wanted)
                if taken[:20] != wanted[:20]:
                    raise OSError(0, f"it does not take {width}x{height} YUYV")
        except OSError as error:
            self.close()
            raise self._failure(error) from error

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
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            raise self._failure(error) from error

    def _failure(self, error: OSError) -> OptionError:
        return OptionError(f"camera {self._path}: {error.strerror}; is v4l2loopback loaded?")


def packed(image: Image) -> Image:
    """A picture uint8 ``[H, W, 3]`` of even width as YUYV: ``[H, W, 2]``, two pixels sharing
    colours."""
    yuv = image.astype(np.float32) @ _FROM_RGB + _BLACK
    found = np.empty((*image.shape[:2], 2), np.uint8)
    found[..., 0] = np.rint(yuv[..., 0])
    pairs = (yuv[:, ::2, 1:] + yuv[:, 1::2, 1:]) / 2
    found[..., 1] = np.rint(pairs).reshape(image.shape[:2])
    return found
