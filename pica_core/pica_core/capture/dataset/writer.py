"""What a rendered capture consists of, written: frames in the background, tables at the end."""

import io
import json
import struct
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from zlib import compress, crc32

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.files import SPLITS, Take, Topology
from pica_core.types import Array, ByteArray, FloatArray

ENCODERS = 2
"""Threads that encode images; what they call lets other threads run."""
MAX_WAITING = 64
"""Images that may wait for them; then drawing waits."""
PNG_UP = 2
"""A row's filter: what is kept is the difference to the row above (PNG specification, 9.2)."""
ERROR_FRAMES = 256
"""Frames that the tracker's errors are summed up over, at most."""


def png(array: Array) -> bytes:
    """An image as PNG; fast rather than small.

    Rows hold the difference to the row above. Choosing a filter for each row, as image libraries
    do, takes as long again as all the rest and saves no bytes (measured on the stage's images:
    12.2 ms and 146 KiB against 6.5 ms and 145 KiB, depth 7.5 ms and 54 KiB against 3.6 ms and
    51 KiB).

    Args:
        array: ``[H, W]`` or ``[H, W, 3]``, uint8 or uint16.
    """
    height, width, *channels = array.shape
    held = np.ascontiguousarray(array, array.dtype.newbyteorder(">"))
    rows = held.view(np.uint8).reshape(height, -1)
    filtered = np.empty((height, 1 + rows.shape[1]), np.uint8)
    filtered[:, 0] = PNG_UP
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    bits, colour = 8 * array.itemsize, 2 if channels else 0
    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    parts = (b"IHDR", header), (b"IDAT", compress(filtered.data, 1)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(f">I4s{len(data)}sI", len(data), name, data, crc32(data, crc32(name)))
        for name, data in parts
    )


def depth_units(depth_m: FloatArray) -> npt.NDArray[np.uint16]:
    """Depth as files hold it."""
    units = np.rint(depth_m / np.float32(multiface.DEPTH_UNIT_M))
    return np.clip(units, 0, 65535).astype(np.uint16)


class BackgroundWriter(AbstractContextManager["BackgroundWriter"]):
    """Makes images and writes them while the next ones are drawn.

    `finish` waits for everything handed over so far and raises what went wrong; the writer of the
    file that marks a frame as done calls it first.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(ENCODERS, thread_name_prefix="encode")
        self._waiting: list[Future[None]] = []

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def image(self, path: Path, make: Callable[[], Array]) -> None:
        """Write what `make` returns as a PNG file."""

        def work() -> None:
            multiface.write_aside(path, png(make()))

        while len(self._waiting) >= MAX_WAITING:
            self._waiting.pop(0).result()
        self._waiting.append(self._pool.submit(work))

    def finish(self) -> None:
        """Wait for all images."""
        while self._waiting:
            self._waiting.pop(0).result()


class TrainingSums:
    """Running mean and variance of training meshes and textures."""

    def __init__(self) -> None:
        self._count = 0
        self._sums: list[Any] = [0.0, 0.0]
        self._squares: list[Any] = [0.0, 0.0]

    def add(self, vertices_mm: FloatArray, texture: ByteArray) -> None:
        """Count one frame."""
        self._count += 1
        for k, values in enumerate((vertices_mm.astype(np.float64), texture.astype(np.float64))):
            self._sums[k] = self._sums[k] + values
            self._squares[k] = self._squares[k] + values * values

    def write(self, out: Path) -> None:
        """Write means, and variances over all elements."""
        vertices, texture = means = [total / self._count for total in self._sums]
        multiface.write_aside(out / "vert_mean.bin", vertices.astype("<f4").tobytes())
        multiface.write_aside(out / "tex_mean.png", png(np.rint(texture).astype(np.uint8)))
        names = ("vert_var.txt", "tex_var.txt")
        for name, mean, squares in zip(names, means, self._squares, strict=True):
            variance = float(np.mean(np.maximum(squares / self._count - mean * mean, 0.0)))
            multiface.write_aside(out / name, f"{variance:.9g}\n".encode())


class TrackingErrors:
    """How far the tracked vertices are off, by region."""

    def __init__(self) -> None:
        self._distance_mm: list[FloatArray] = []

    def add(self, tracked_mm: FloatArray, exact_mm: FloatArray) -> None:
        """Count one frame; both ``[Vt, 3]``."""
        if len(self._distance_mm) < ERROR_FRAMES:
            distance = np.linalg.norm(tracked_mm - exact_mm, axis=1)
            self._distance_mm.append(distance.astype(np.float32))

    def describe(self, topology: Topology) -> dict[str, dict[str, float]]:
        """Mean, 99th percentile and largest error by region, mm."""
        distance = np.stack(self._distance_mm)
        everything = {"all": np.ones(distance.shape[1], np.bool_)}
        table = {}
        for name, mask in (everything | topology.regions).items():
            if mask.any():
                part = distance[:, mask]
                table[name] = {
                    "mean": round(float(part.mean()), 3),
                    "p99": round(float(np.percentile(part, 99)), 3),
                    "max": round(float(part.max()), 3),
                }
        return table


def write_topology(path: Path, topology: Topology, **more: Array) -> None:
    """Write a topology file."""
    arrays: dict[str, Any] = {"vertex_uv": topology.vertex_uv, "faces": topology.faces, **more}
    arrays |= {f"region_{name}": mask for name, mask in topology.regions.items()}
    data = io.BytesIO()
    np.savez(data, **arrays)  # fixed zip time stamps: the same bytes every time
    multiface.write_aside(path, data.getvalue())


def write_tables(out: Path, takes: list[Take], info: dict[str, Any]) -> None:
    """Write the list of frames, their expressions, and `capture.json` as the last of all."""
    lines = [",".join(("segment", "frame", "split", *ARKIT_NAMES))]
    names = []
    for take in takes:
        for index, arkit in enumerate(take.arkit):
            numbers = ",".join(f"{value:.6g}" for value in arkit)
            lines.append(f"{take.segment},{index:06d},{take.split},{numbers}")
            names.append(f"{take.segment} {index:06d}")
    multiface.write_aside(out / multiface.EXPRESSIONS, ("\n".join(lines) + "\n").encode())
    multiface.write_aside(out / multiface.FRAME_LIST, ("\n".join(names) + "\n").encode())
    split = {split: [take.segment for take in takes if take.split == split] for split in SPLITS}
    whole = {"schema": multiface.SCHEMA, **info, "split": split}
    multiface.write_aside(out / multiface.CAPTURE, json.dumps(whole, indent=1).encode() + b"\n")
