"""What a rendered capture consists of, written: frames in the background, tables at the end."""

import io
import json
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.files import SPLITS, Take, Topology
from pica_core.types import Array, FloatArray, Int64Array, IntArray

ENCODERS = 2
"""Threads that encode images; what they call lets other threads run."""
MAX_WAITING = 64
"""Images that may wait for them; then drawing waits."""


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
            data = io.BytesIO()
            Image.fromarray(make()).save(data, "PNG", compress_level=1)
            multiface.write_aside(path, data.getvalue())

        while len(self._waiting) >= MAX_WAITING:
            self._waiting.pop(0).result()
        self._waiting.append(self._pool.submit(work))

    def finish(self) -> None:
        """Wait for all images."""
        while self._waiting:
            self._waiting.pop(0).result()


def write_topology(path: Path, topology: Topology, tracked: IntArray, dense: Int64Array) -> None:
    """Write a topology file: with the tracked triangles, and the vertex that each of theirs is."""
    arrays: dict[str, Any] = {"vertex_uv": topology.vertex_uv, "faces": topology.faces}
    arrays |= {"dense_vertex": dense.astype(np.int32), "tracked_faces": tracked}
    arrays |= {f"region_{name}": mask for name, mask in topology.regions.items()}
    write_archive(path, **arrays)


def write_archive(path: Path, **arrays: Any) -> None:
    """Write arrays by name; zip time stamps are fixed, so the same arrays give the same bytes."""
    data = io.BytesIO()
    np.savez(data, **arrays)
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
