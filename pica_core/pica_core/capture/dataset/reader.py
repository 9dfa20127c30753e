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
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from itertools import islice

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
    """A capture behind a cache of `max_bytes`. Use it from one thread.

    Attributes:
        bad: What is wrong with requests that could not be read.
        peak_bytes: Most that was kept, or reserved for what is being decoded, at any time.
        decoded: How many arrays were decoded.
    """

    def __init__(self, capture: Capture, max_bytes: int = MAX_BYTES) -> None:
        if max_bytes < 1:
            raise CaptureError(f"reader: max_bytes is {max_bytes}; at least 1 is needed")
        self.capture = capture
        self.max_bytes = max_bytes
        self.bad: dict[Request, str] = {}
        self.peak_bytes = self.decoded = 0
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="decode")
        self._kept: OrderedDict[Request, Future[Array]] = OrderedDict()
        self._kept_bytes = 0
        self._unread: set[Request] = set()
        self._waiting: deque[Request] = deque()
        self._sizes = _sizes(capture)

    def __exit__(self, *error: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def ask(self, requests: Iterable[Request]) -> None:
        """Have arrays decoded that will be read soon, in this order."""
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
        self._unread.discard(request)
        if request not in self._kept and request in self._waiting:
            self._waiting.remove(request)
        try:
            if request in self._kept or self._keep(request):
                self._kept.move_to_end(request)
                return self._kept[request].result()
            self.decoded += 1  # larger than the cache, or that is full of what will be read
            return self._decode(request)
        except CaptureError as error:
            if self._kept.pop(request, None) is not None:
                self._kept_bytes -= self._sizes[request.kind]
            if request not in self.bad:
                self.bad[request] = str(error)
                log.warning("%s; left out, %d so far", error, len(self.bad))
            raise
        finally:
            self._start_waiting()

    def stream(
        self, requests: Iterable[Request], ahead: int = AHEAD
    ) -> Iterator[tuple[Request, Array]]:
        """Arrays in order, decoded ahead; those that cannot be read are left out and counted."""
        coming: deque[Request] = deque()
        rest = iter(requests)
        while True:
            coming.extend(more := list(islice(rest, ahead + 1 - len(coming))))
            self.ask(more)
            if not coming:
                return
            request = coming.popleft()
            with suppress(CaptureError):
                yield request, self.read(request)

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
        array.flags.writeable = False
        return array

    def _start_waiting(self) -> None:
        """Have decoded what waits, in order, as far as it fits."""
        while self._waiting and self._keep(self._waiting[0]):
            self._waiting.popleft()

    def _keep(self, request: Request) -> bool:
        """Have an array decoded and keep it, if it fits once the oldest that were read go."""
        size = self._sizes[request.kind]
        excess = self._kept_bytes + size - self.max_bytes
        let_go = []
        for other in self._kept if excess > 0 else ():
            if other not in self._unread:
                let_go.append(other)
                excess -= self._sizes[other.kind]
                if excess <= 0:
                    break
        if excess > 0:
            return False
        for other in let_go:
            del self._kept[other]
            self._kept_bytes -= self._sizes[other.kind]
        self._kept[request] = self._pool.submit(self._decode, request)
        self._kept_bytes += size
        self.decoded += 1
        self.peak_bytes = max(self.peak_bytes, self._kept_bytes)
        return True


def _sizes(capture: Capture) -> dict[str, int]:
    """Bytes of a decoded array of each kind."""
    pixels = max(camera.width * camera.height for camera in capture.cameras)
    return {
        "image": 3 * pixels,
        "mask": pixels,
        "depth": 4 * pixels,
        "true_depth": 4 * pixels,
        "texture": 3 * capture.texture_size**2,
        "vertices": 12 * len(capture.tracked_topology.vertex_uv),
        "true_vertices": 12 * len(capture.topology.vertex_uv),
    }
