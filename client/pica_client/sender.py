"""The sending half of a call: source -> expression encoder -> payload -> frame, at a steady rate.

A shell: it owns the schedule and the link. Encoding takes a fraction of a millisecond and so runs
on the event loop itself; a thread would cost more than it saves.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pica_client.errors import OptionError
from pica_client.link import Connector, Link, LinkConfig
from pica_client.pacer import Pacer
from pica_client.sources import Source
from pica_client.stats import Samples
from pica_core.avatar_file import Avatar
from pica_core.expression_encoder import ExpressionEncoder
from pica_core.latent_stream import DEFAULT_QUALITY, StreamConfig
from pica_core.stream_ends import open_encoder
from pica_protocol.messages import Joined, KeyframeRequest, StreamMuted, Track
from pica_protocol.session import ClientEvent

_log = logging.getLogger(__name__)

FACE_TRACK = "face"
"""Kind of the tracks whose payloads are latents."""
MAX_LOGGED_FRAMES = 100_000
"""Encoding times kept for a latency analysis: 55 minutes at 30 a second."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SenderConfig:
    """How fast and how long to send."""

    fps: float = 30.0
    """Frames a second."""
    seconds: float = 0.0
    """How long to send, counted from the first frame; 0 is until stopped."""
    quality: int = DEFAULT_QUALITY
    """Of the coded stream, 0 (coarse) to 7 (fine)."""
    bitrate_bps: float | None = None
    """Payload bits a second to keep to by changing the quality; None keeps the quality."""
    plain: bool = False
    """Send 8 bits a value instead of the coded stream."""

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= 240:
            raise OptionError(f"fps is {self.fps:g}; 1 to 240 is allowed")
        if not self.seconds >= 0:
            raise OptionError(f"seconds is {self.seconds:g}; 0 (for ever) or more is allowed")
        self.stream()

    def stream(self) -> StreamConfig:
        """How the stream is encoded."""
        try:
            return StreamConfig(fps=self.fps, quality=self.quality, target_bps=self.bitrate_bps)
        except ValueError as error:
            raise OptionError(str(error).replace("target_bps", "bitrate_bps")) from error


class Sender:
    """One sender; `run` it, `stop` it.

    Attributes:
        frame_log: Capture time and encoding time of each frame sent, both in microseconds; drops
            its oldest when full.
    """

    def __init__(
        self,
        config: SenderConfig,
        link_config: LinkConfig,
        source: Source,
        avatar: Avatar,
        avatar_identity: str,
        *,
        connector: Connector | None = None,
        rng: random.Random | None = None,
        on_joined: Callable[[], None] | None = None,
    ) -> None:
        """Prepare; see `Link` for connector and rng; ``on_joined`` is called after each join."""
        self.config = config
        self._on_joined = on_joined
        self.frame_log: deque[tuple[int, int]] = deque(maxlen=MAX_LOGGED_FRAMES)
        self._source = source
        self._encoder = ExpressionEncoder(avatar)
        self._stream, profile = open_encoder(avatar, config.stream(), plain=config.plain)
        track = Track(kind=FACE_TRACK, avatar=avatar_identity, profile=profile)
        self._link = Link(
            link_config, (track,), on_event=self._on_event, connector=connector, rng=rng
        )
        self._stopping = asyncio.Event()
        self._encode = Samples()
        self._first_sent_s: float | None = None
        self._last_sent_s = 0.0
        self._sent = self._unheard = self._faceless = self._payload_bytes = 0
        self._own_streams: tuple[int, ...] = ()
        self._is_muted = False
        self._skipped = self._silent = self._keyframes = 0

    @property
    def relay_url(self) -> str:
        """The relay that the sender is at, or tries next."""
        return self._link.url

    def stop(self) -> None:
        """Make `run` leave the room and return."""
        self._stopping.set()

    async def run(self) -> dict[str, Any]:
        """Send until `stop`, or for the configured time.

        Returns:
            The statistics, see `stats`.

        Raises:
            RelayError: The relay is not there, or will not have us.
        """
        pacing = asyncio.create_task(self._pace(), name="pacing")
        linking = asyncio.create_task(self._link.run(), name="link")
        try:
            await asyncio.wait({pacing, linking}, return_when=asyncio.FIRST_COMPLETED)
            if pacing.done():
                pacing.result()
                self._link.leave()
            await linking
        finally:
            for task in (pacing, linking):
                task.cancel()
            await asyncio.gather(pacing, linking, return_exceptions=True)
        return self.stats()

    def stats(self) -> dict[str, Any]:
        """What was sent so far; rates are over the time from the first frame to the last."""
        seconds = self._last_sent_s - (self._first_sent_s or 0.0)
        counters = self._link.counters
        return {
            "name": self._link.config.name,
            "seconds": round(seconds, 3),
            "sent": self._sent,
            "skipped": self._skipped,
            "replaced": counters.frames_replaced,
            "not_connected": self._unheard,
            "without_face": self._faceless,
            "silent": self._silent,
            "keyframes": self._keyframes,
            "payload_bytes": self._payload_bytes,
            "wire_bytes": counters.sent_wire_bytes,
            "payload_bps": round(self._payload_bytes * 8 / seconds) if seconds else None,
            "wire_bps": round(counters.sent_wire_bytes * 8 / seconds) if seconds else None,
            "encode_ms": self._encode.summary_ms(),
            "reconnects": self._link.reconnects,
            "resumes": counters.resumes,
            "muted": self._is_muted,
            "errors": counters.errors,
            "seal": None if self._link.guard is None else self._link.guard.stats(),
        }

    def _on_event(self, event: ClientEvent, now: float) -> None:
        match event:
            case KeyframeRequest():
                self._stream.request_keyframe()
            case Joined(tracks=tracks):  # nobody here has seen anything of us, or of the last of it
                self._stream.restart()
                self._own_streams = tuple(track.stream for track in tracks)
                self._is_muted = False  # we are told again if it is so
                if self._on_joined is not None:
                    self._on_joined()
            case StreamMuted(stream=stream, is_muted=is_muted) if stream in self._own_streams:
                self._is_muted = is_muted
                _log.warning("muted by an admin" if is_muted else "not muted any more")
            case _:
                pass

    async def _pace(self) -> None:
        loop = asyncio.get_running_loop()
        begin_s = loop.time()
        pacer = Pacer(self.config.fps, begin_s)
        while not self._stopping.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(pacer.due_s):
                    await self._stopping.wait()
                return
            # A loop may fire a timer up to its clock's resolution too early.
            now = max(loop.time(), pacer.due_s)
            if self._first_sent_s is not None and 0 < self.config.seconds <= (
                now - self._first_sent_s
            ):
                return
            self._send_face(now - begin_s, now)
            pacer.advance(max(loop.time(), now))
            self._skipped = pacer.num_skipped

    def _send_face(self, time_s: float, now: float) -> None:
        """Sample, encode and offer one face."""
        if not self._link.is_joined:
            self._unheard += 1
            return
        began_s = time.perf_counter()
        frame = self._source.frame_at(time_s)
        if not frame.has_face:
            self._faceless += 1  # nothing to say: the receivers see the stream fall silent
            return
        latent = self._encoder.encode(frame.arkit)
        captured_us = round(now * 1e6)
        coded = self._stream.encode(latent, frame.rotation, frame.translation_m, captured_us)
        encode_s = time.perf_counter() - began_s
        if coded is None:
            self._silent += 1  # still: the receivers know, and hold the face
            self._last_sent_s = now
            return
        if self._link.send_frame(
            coded.payload, captured_us, layer=coded.layer, is_keyframe=coded.is_keyframe
        ):
            self._first_sent_s = now if self._first_sent_s is None else self._first_sent_s
            self._last_sent_s = now
            self._sent += 1
            self._keyframes += coded.is_keyframe
            self._payload_bytes += len(coded.payload)
            self._encode.add(encode_s)
            self.frame_log.append((captured_us, round(encode_s * 1e6)))
