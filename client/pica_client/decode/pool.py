"""Decoding off the drawing thread: the newest of every avatar, by turns. ONNX Runtime releases the
interpreter lock while it computes.

Bounded by construction: a slot holds one waiting request and one finished result. A newer request
takes the place of one that waits, and the replaced ones are counted; it is widened by what the old
one asked for, so a request for the expression map alone never cancels one for both. A newer result
takes the place of one that was not taken, and keeps the position map of that if it brings none.

Getting ready for a level takes as long as a few frames. A worker with nothing else to do gets ready
for those that were not asked for yet, one after the other, so that a change of level in the middle
of a call finds everything there.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodeRequest, DecodeResult, Parts
from pica_client.system import Closing
from pica_core.avatar.file import Avatar

MAX_WORKERS = 4
"""More do not pay (measured on 16 cores, five heads: 1, 2 and 4 take 14.9, 8.5 and 5.5 ms)."""
CORES_PER_WORKER = 4
"""The others draw, play sound and run the rest of the machine (chosen)."""


def num_workers(num_cores: int | None) -> int:
    """The threads that are to decode on a machine with this many cores; None is unknown."""
    return min(max((num_cores or 1) // CORES_PER_WORKER, 1), MAX_WORKERS)


@dataclass(slots=True, eq=False)
class _Slot:
    """One avatar of the pool; guarded by the pool's lock."""

    avatar: Avatar
    decoder: OnnxDecoder | None = None
    is_broken: bool = False
    is_busy: bool = False
    request: DecodeRequest | None = None
    submitted_s: float = 0.0
    result: DecodeResult | None = None
    unprepared: list[tuple[int, Parts]] = field(init=False)
    """What to get ready for when there is time; the last first."""

    def __post_init__(self) -> None:
        both: tuple[Parts, ...] = ("expression", "both")
        self.unprepared = [(level, parts) for level in self.avatar.levels for parts in both]

    @property
    def has_work(self) -> bool:
        """Whether a decoder is to be built, or a request waits."""
        return not self.is_broken and (self.decoder is None or self.request is not None)


class DecodePool(Closing):
    """Decodes the newest latent of every avatar on worker threads.

    Args:
        make_decoder: Builds the decoder of an avatar; runs on a worker, for it may take long.
        clock: Seconds, monotonic.
        workers: Threads; see `num_workers`.

    Attributes:
        num_replaced: Requests that a newer one replaced before a worker took them.

    An exception of a decoder breaks its own slot alone: it comes back as `DecodeResult.error`.
    """

    def __init__(
        self,
        make_decoder: Callable[[Avatar], OnnxDecoder],
        clock: Callable[[], float] = time.monotonic,
        *,
        workers: int = 1,
    ) -> None:
        self.num_replaced = 0
        self._make_decoder = make_decoder
        self._clock = clock
        self._slots: dict[str, _Slot] = {}
        self._closed = False
        self._changed = threading.Condition()
        self._workers = [
            threading.Thread(target=self._work, name=f"decode-{index}", daemon=True)
            for index in range(workers)
        ]
        for worker in self._workers:
            worker.start()

    def add(self, slot: str, avatar: Avatar) -> None:
        """Prepare a slot for an avatar; replaces what was there. Its decoder is built on a
        worker."""
        with self._changed:
            self._slots[slot] = _Slot(avatar)
            self._changed.notify()

    def remove(self, slot: str) -> None:
        """Forget a slot; an unknown one is no error. A decode under way is dropped when it ends."""
        with self._changed:
            self._slots.pop(slot, None)

    def submit(self, slot: str, request: DecodeRequest) -> None:
        """Ask for a decode; takes the place of a request that still waits, and widens to its parts.
        Broken or unknown slots ignore it."""
        with self._changed:
            entry = self._slots.get(slot)
            if entry is None or entry.is_broken:
                return
            entry.submitted_s = self._clock()
            if entry.request is not None:
                self.num_replaced += 1
                request = request.widened_by(entry.request)
            entry.request = request
            self._changed.notify()

    def take_results(self) -> list[DecodeResult]:
        """The newest result of every slot since the last call."""
        with self._changed:
            found = [entry.result for entry in self._slots.values() if entry.result is not None]
            for entry in self._slots.values():
                entry.result = None
        return found

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until nothing is waiting or under way; False when the time runs out first."""

        def idle() -> bool:
            return not any(entry.is_busy or entry.has_work for entry in self._slots.values())

        with self._changed:
            return self._changed.wait_for(idle, timeout_s)

    def close(self) -> None:
        """Stop the workers and wait for them; what waits is dropped."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for worker in self._workers:
            worker.join()

    def _next(self) -> tuple[str, _Slot] | None:
        """The slot with work that no worker is busy with and whose last turn was the longest ago,
        else one that can get ready for more; under the lock."""
        free = [(slot, entry) for slot, entry in self._slots.items() if not entry.is_busy]
        waiting = [pair for pair in free if pair[1].has_work]
        ahead = [pair for pair in free if pair[1].unprepared and not pair[1].is_broken]
        if not waiting + ahead:
            return None
        slot, entry = (waiting or ahead)[0]
        self._slots[slot] = self._slots.pop(slot)  # its next turn is after those of all others
        return slot, entry

    def _work(self) -> None:
        while True:
            with self._changed:
                found = None
                while not self._closed and (found := self._next()) is None:
                    self._changed.wait()
                if self._closed or found is None:
                    return
                slot, entry = found
                entry.is_busy = True
                request, entry.request = entry.request, None
                submitted_s = entry.submitted_s
                is_ahead = request is None and entry.decoder is not None
                ahead = entry.unprepared.pop() if is_ahead else None
            result = self._run(slot, entry, request, submitted_s, ahead)
            with self._changed:
                entry.is_busy = False
                if result is not None:
                    entry.result = result.completed_by(entry.result)
                self._changed.notify_all()

    def _run(
        self,
        slot: str,
        entry: _Slot,
        request: DecodeRequest | None,
        submitted_s: float,
        ahead: tuple[int, Parts] | None,
    ) -> DecodeResult | None:
        """Build what is needed if it is not there, and decode. Only this worker touches the
        entry's decoder."""
        try:
            if entry.decoder is None:
                entry.decoder = self._make_decoder(entry.avatar)
            if request is None:
                if ahead is not None:
                    entry.decoder.prepare(*ahead)
                return None
            entry.decoder.prepare(request.level, request.parts)
            started_s = self._clock()
            maps = entry.decoder.decode(
                request.latent, request.view_direction, request.level, request.parts
            )
            times_s = (submitted_s, started_s, self._clock())
            return DecodeResult(slot, maps, None, request.captured_us, *times_s, request.parts)
        except Exception as error:  # one avatar's failure must not end the worker of all
            entry.is_broken = True
            return DecodeResult(slot, None, " ".join(str(error).split())[:300])
