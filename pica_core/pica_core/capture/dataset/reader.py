"""Keep what fits of a capture in memory and decode ahead what will be asked for.

    with CaptureReader(capture, max_bytes=2 << 30) as reader:
        for request, image in reader.stream(requests):   # in order, bad ones left out
            ...

or, where somebody else decides what comes next: `ask` for what will be needed, then `read` it.

Threads decode into one cache of bounded size. What was asked for stays until it was read; of the
rest the least recently used goes first; what does not fit waits its turn, and whoever reads it
before then decodes it. So memory depends on `max_bytes` alone, however large the capture is.
"""

import logging
from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from threading import RLock

import numpy as np

from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError
from pica_core.types import Array

log = logging.getLogger(__name__)

MAX_BYTES = 2 << 30
"""Decoded arrays in memory unless said otherwise (chosen)."""
THREADS = 2
AHEAD = 64
"""Requests that `stream` asks for before it needs them."""
OF_CAMERAS = {"image": "image", "mask": "mask", "depth": "depth_m", "true_depth": "true_depth_m"}
OF_FRAMES = {
    "texture": "average_texture", "vertices": "vertices_m", "true_vertices": "true_vertices_m",
}  # fmt: skip
READS = OF_CAMERAS | OF_FRAMES
"""Methods of `Capture` by kind of array."""


@dataclass(frozen=True, slots=True)
class Request:
    """One array of a capture."""

    kind: str
    """Key of `READS`, such as ``image``."""
    frame: int
    """Place in `Capture.frames`."""
    camera: str = ""
    """Camera name, for images, masks and depth."""


class CaptureReader(AbstractContextManager["CaptureReader"]):
    """A capture behind a cache of `max_bytes`, decoded by `threads`. Use it from one thread.

    Attributes:
        bad: What is wrong with requests that could not be read.
        peak_bytes: Most that was kept at any time.
        decoded: How many arrays were decoded.
    """

    def __init__(
        self, capture: Capture, max_bytes: int = MAX_BYTES, threads: int = THREADS
    ) -> None:
        if max_bytes < 1 or not 1 <= threads <= 64:
            raise CaptureError(
                f"reader: max_bytes is {max_bytes}, threads is {threads}; "
                "at least 1 and 1 to 64 are needed"
            )
        self.capture = capture
        self.max_bytes = max_bytes
        self.bad: dict[Request, str] = {}
        self.peak_bytes = 0
        self.decoded = 0
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="decode")
        self._lock = RLock()
        self._kept: OrderedDict[Request, Array] = OrderedDict()
        self._kept_bytes = 0
        self._running: dict[Request, Future[Array]] = {}
        self._reserved_bytes = 0
        self._unread: set[Request] = set()
        self._waiting: deque[Request] = deque()
        self._sizes = _sizes(capture)

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._waiting.clear()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def ask(self, requests: Iterable[Request]) -> None:
        """Have arrays decoded that will be read soon, in this order."""
        with self._lock:
            for request in requests:
                self._check(request)
                if request not in self._unread and request not in self.bad:
                    self._unread.add(request)
                    if request not in self._kept:
                        self._waiting.append(request)
            self._start_waiting()

    def read(self, request: Request) -> Array:
        """An array; do not write into it.

        Raises:
            CaptureError: It cannot be read; counted in `bad`.
        """
        self._check(request)
        with self._lock:
            self._unread.discard(request)
            if request in self._kept:
                self._kept.move_to_end(request)
                array = self._kept[request]
                self._start_waiting()
                return array
            running = self._running.get(request)
            if running is None and request in self._waiting:
                self._waiting.remove(request)
        try:
            array = self._decode(request) if running is None else running.result()
        except CaptureError as error:
            if request not in self.bad:
                self.bad[request] = str(error)
                log.warning("%s; left out, %d so far", error, len(self.bad))
            raise
        finally:
            with self._lock:
                self._start_waiting()
        if running is None:
            self._keep(request, array)
        return array

    def stream(
        self, requests: Iterable[Request], ahead: int = AHEAD
    ) -> Iterator[tuple[Request, Array]]:
        """Arrays in order, decoded ahead; those that cannot be read are left out and counted."""
        coming: deque[Request] = deque()
        rest = iter(requests)
        while True:
            for request in rest:
                coming.append(request)
                self.ask([request])
                if len(coming) > ahead:
                    break
            if not coming:
                return
            request = coming.popleft()
            try:
                array = self.read(request)
            except CaptureError:
                continue
            yield request, array
            del array

    def _check(self, request: Request) -> None:
        if request.kind not in READS or not 0 <= request.frame < len(self.capture.frames):
            raise CaptureError(
                f"{self.capture.path}: no {request.kind!r} of frame {request.frame}; there are "
                f"{', '.join(READS)} of {len(self.capture.frames)} frames"
            )

    def _decode(self, request: Request) -> Array:
        frame = self.capture.frames[request.frame]
        read = getattr(self.capture, READS[request.kind])
        array: Array = read(frame, request.camera) if request.kind in OF_CAMERAS else read(frame)
        with self._lock:
            self.decoded += 1
        return array

    def _start_waiting(self) -> None:
        """Start what waits, in order, as far as it fits; the lock is held."""
        while self._waiting and self._make_room(self._sizes[self._waiting[0].kind]):
            request = self._waiting.popleft()
            size = self._sizes[request.kind]
            self._reserved_bytes += size
            self._running[request] = self._pool.submit(self._work, request, size)

    def _work(self, request: Request, size: int) -> Array:
        try:
            array = self._decode(request)
        except BaseException:
            with self._lock:
                self._reserved_bytes -= size
                del self._running[request]
            raise
        with self._lock:
            self._reserved_bytes -= size
            del self._running[request]
            self._keep(request, array)
        return array

    def _keep(self, request: Request, array: Array) -> None:
        with self._lock:
            if request in self._kept or not self._make_room(array.nbytes):
                return  # larger than the cache, or it is full of what was asked for before
            array.flags.writeable = False
            self._kept[request] = array
            self._kept_bytes += array.nbytes
            self.peak_bytes = max(self.peak_bytes, self._kept_bytes)

    def _make_room(self, size: int) -> bool:
        """Let go of what was read until `size` bytes fit; the lock is held."""
        excess = self._kept_bytes + self._reserved_bytes + size - self.max_bytes
        if excess > 0:
            let_go = []
            for request, array in self._kept.items():
                if request not in self._unread:
                    let_go.append(request)
                    excess -= array.nbytes
                    if excess <= 0:
                        break
            for request in let_go:
                self._kept_bytes -= self._kept.pop(request).nbytes
        return excess <= 0


def _sizes(capture: Capture) -> dict[str, int]:
    """Bytes of a decoded array of each kind."""
    pixels = max(camera.width * camera.height for camera in capture.cameras)
    return {
        "image": 3 * pixels,
        "mask": pixels,
        "depth": 4 * pixels,
        "true_depth": 4 * pixels,
        "texture": 3 * capture.texture_size**2,
        "vertices": np.dtype(np.float32).itemsize * 3 * len(capture.tracked_topology.vertex_uv),
        "true_vertices": np.dtype(np.float32).itemsize * 3 * capture.num_vertices,
    }
