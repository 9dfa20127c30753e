"""Decoding off the drawing thread: the newest of every avatar, by turns. ONNX Runtime releases the
interpreter lock while it computes.

A slot has one turn at a time and one request that waits for the next: a newer one takes its place,
and the replaced ones are counted. It is widened by what the old one asked for, so a request for the
expression map alone never cancels one for both.

Building the session of a level takes as long as a few frames, so a thread of its own does it: faces
whose sessions are there are decoded meanwhile. It builds what is asked for first, then all others,
so that a change of level in the middle of a call finds everything there.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from pica_client.decode.decoder import OnnxDecoder
from pica_client.decode.request import DecodeRequest, DecodeResult
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
    """One avatar of the pool; guarded by the pool's lock, but for its decoder, which is only for
    whose turn it is."""

    name: str
    avatar: Avatar
    decoder: OnnxDecoder | None = None
    is_broken: bool = False
    lacks_session: bool = False
    """Whether its turn waits for its decoder, or for a session of it."""
    has_all: bool = False
    """Whether its decoder has the sessions of all levels."""
    is_busy: bool = False
    """Whether it has a turn, or waits for it."""
    request: DecodeRequest | None = None
    submitted_s: float = 0.0
    results: list[DecodeResult] = field(default_factory=list)


class DecodePool(Closing):
    """Decodes the newest latent of every avatar on worker threads.

    Args:
        make_decoder: Builds the decoder of an avatar; runs on a thread, for it may take long.
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
        self._changed = threading.Condition()
        self._workers = ThreadPoolExecutor(workers, "decode")
        self._builder = ThreadPoolExecutor(1, "build decoders")

    def add(self, slot: str, avatar: Avatar) -> None:
        """Prepare a slot for an avatar; replaces what was there."""
        with self._changed:
            self._slots[slot] = entry = _Slot(slot, avatar)
            self._line_up(entry)

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
            if not entry.is_busy:
                self._line_up(entry)

    def take_results(self) -> list[DecodeResult]:
        """What became of requests since the last call; those of a slot in their order."""
        with self._changed:
            found = [result for entry in self._slots.values() for result in entry.results]
            for entry in self._slots.values():
                entry.results.clear()
        return found

    def wait_idle(self, timeout_s: float) -> bool:
        """Wait until no decode is waiting or under way; False when the time runs out first."""
        with self._changed:
            return self._changed.wait_for(self._is_idle, timeout_s)

    def close(self) -> None:
        """Stop the threads and wait for them; what waits is dropped."""
        with self._changed:
            self._slots.clear()
        self._builder.shutdown(cancel_futures=True)
        self._workers.shutdown(cancel_futures=True)

    def _is_idle(self) -> bool:
        return not any(entry.is_busy for entry in self._slots.values())

    def _line_up(self, entry: _Slot) -> None:
        """Give a slot a turn after those who wait already; under the lock."""
        if not self._slots:  # closed
            return
        entry.is_busy = True
        asked, decoder = entry.request, entry.decoder
        if decoder is not None and asked is not None and decoder.has(asked.level, asked.parts):
            self._workers.submit(self._take_turn, entry, decoder)
        else:
            entry.lacks_session = True
            self._builder.submit(self._build)

    def _build(self) -> None:
        """Build what a slot waits for, else one session that has not been asked for yet."""
        with self._changed:
            waiting = [entry for entry in self._slots.values() if entry.lacks_session]
            entry = next(iter(waiting or filter(_may_build_ahead, self._slots.values())), None)
            if entry is None:
                return
            is_asked, entry.lacks_session = entry.lacks_session, False
            asked = entry.request
        results = []
        try:
            if entry.decoder is None:
                entry.decoder = self._make_decoder(entry.avatar)
            if not is_asked:
                entry.has_all = not entry.decoder.prepare_next()
            elif asked is not None:
                entry.decoder.prepare(asked.level, asked.parts)
        except Exception as error:  # one avatar's failure must not end the thread of all
            entry.has_all = True  # what fails ahead fails again when it is asked for
            results = [_broken(entry, error)] if is_asked else []
        if is_asked:
            self._end_turn(entry, results)
        with self._changed:
            if self._slots:
                self._builder.submit(self._build)

    def _take_turn(self, entry: _Slot, decoder: OnnxDecoder) -> None:
        with self._changed:
            request, entry.request = entry.request, None
            submitted_s = entry.submitted_s
        assert request is not None  # a turn begins with one, and takes it alone
        try:
            result = self._decode(entry, decoder, request, submitted_s)
        except Exception as error:
            result = _broken(entry, error)
        self._end_turn(entry, [result])

    def _end_turn(self, entry: _Slot, results: list[DecodeResult]) -> None:
        """Keep results, and line a slot up again if it was asked for meanwhile."""
        with self._changed:
            entry.results += results
            entry.is_busy = False
            is_there = self._slots.get(entry.name) is entry and not entry.is_broken
            if entry.request is not None and is_there:
                self._line_up(entry)
            self._changed.notify_all()

    def _decode(
        self, entry: _Slot, decoder: OnnxDecoder, request: DecodeRequest, submitted_s: float
    ) -> DecodeResult:
        decoder.prepare(request.level, request.parts)
        started_s = self._clock()
        maps = decoder.decode(request.latent, request.view_direction, request.level, request.parts)
        times_s = (submitted_s, started_s, self._clock())
        return DecodeResult(entry.name, maps, None, request.captured_us, *times_s, request.parts)


def _may_build_ahead(entry: _Slot) -> bool:
    return not (entry.decoder is None or entry.has_all or entry.is_broken)


def _broken(entry: _Slot, error: Exception) -> DecodeResult:
    entry.is_broken = True
    return DecodeResult(entry.name, None, " ".join(str(error).split())[:300])
