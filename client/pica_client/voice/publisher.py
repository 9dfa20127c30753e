"""A voice on its way out: frames of a source -> Opus -> packets on the voice's track, two frames in
each.

While it is muted, or its speaker silent, nothing is sent. A mute lets the frame that was begun go
out, and then one of nothing, which brings out what the encoder held back; nothing that was captured
later leaves this machine or is kept on it.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any, Final, Protocol

import numpy as np

from pica_client.tracks import VOICE_KEY, VOICE_MUTED, VOICE_TRACK
from pica_client.transport.link import Link
from pica_client.voice.opus import FRAME_SAMPLES, FRAME_US, PACKET_FRAMES, OpusEncoder
from pica_core.types import FloatArray
from pica_protocol.messages import Track

BITRATE_BPS: Final = 24_000
"""Bits a second during speech."""
DEADLINE_MS: Final = 200
"""How long a packet may wait on its way (chosen: as the longest wait before it is heard)."""
_NOTHING: Final = np.zeros(FRAME_SAMPLES, np.float32)
_GAP_US: Final = FRAME_US // 2
"""Between the end of a packet and the beginning of the next; more is a silence."""


class VoiceSource(Protocol):
    """What a voice comes from: a microphone, a file."""

    def frames(self, stopping: asyncio.Event) -> AsyncIterator[tuple[FloatArray, int]]:
        """Return 20 ms after 20 ms, float32 ``[960]`` in [-1, 1], as they are captured.

        With each comes when its first sample was captured, microseconds of the event loop's clock.
        Ends when told to stop.
        """


class VoicePublisher:
    """Sends one voice over a link, which the caller runs.

    Attributes:
        is_muted: Whether its owner has muted it, from the next frame on; any thread may set it.
        listeners: Take what is captured and not muted: samples, and when the first was captured.
    """

    def __init__(self, source: VoiceSource, *, is_sealed: bool = False) -> None:
        """Prepare.

        Args:
            is_sealed: Whether it is encrypted on its way: then every packet of speech has the same
                size, as sizes that follow the sounds tell words (RFC 6562).

        Raises:
            VoiceError: There is no libopus.
        """
        self.track = Track(kind=VOICE_TRACK, policy="ordered", deadline_ms=DEADLINE_MS)
        self.is_muted = False
        self.listeners: list[Callable[[FloatArray, int], None]] = []
        self._source = source
        self._encoder = OpusEncoder(BITRATE_BPS, is_constant=is_sealed)
        self._was_muted = False
        self._begun: list[FloatArray] = []  # of the next packet, and when it was captured
        self._begun_us = 0
        self._sent = self._payload_bytes = 0

    async def pace(self, link: Link, stopping: asyncio.Event) -> None:
        """Send until told to stop, or the source ends."""
        async for pcm, captured_us in self._source.frames(stopping):
            self.send(link, pcm, captured_us)

    def send(self, link: Link, pcm: FloatArray, captured_us: int) -> None:
        """Send the next 20 ms, unless it is silent or there is no room to send it to."""
        is_muted = self.is_muted  # another thread may change it meanwhile
        was_muted, self._was_muted = self._was_muted, is_muted
        if is_muted != was_muted:
            link.describe(VOICE_KEY, VOICE_MUTED if is_muted else "")
            if was_muted:
                self._encoder.reset()
        if is_muted and was_muted:
            return
        for listen in () if is_muted else tuple(self.listeners):
            listen(pcm, captured_us)
        self._send(link, _NOTHING if is_muted else pcm, captured_us, is_last=is_muted)

    def _send(self, link: Link, pcm: FloatArray, captured_us: int, *, is_last: bool) -> None:
        if not link.is_joined:
            self._begun.clear()
            return
        if self._begun and captured_us > self._begun_us + len(self._begun) * FRAME_US + _GAP_US:
            self._send_packet(link)  # the source has left something out
        if not self._begun:
            self._begun_us = captured_us
        self._begun.append(pcm)
        if is_last or len(self._begun) == PACKET_FRAMES:
            self._send_packet(link)

    def _send_packet(self, link: Link) -> None:
        pcm, captured_us = np.concatenate(self._begun), self._begun_us
        self._begun.clear()
        opus = self._encoder.encode(pcm)
        if opus is not None and link.send_frame(opus, captured_us, track=self.track):
            self._sent += 1
            self._payload_bytes += len(opus)

    def stats(self) -> dict[str, Any]:
        """What was sent so far."""
        return {
            "sent": self._sent,
            "payload_bytes": self._payload_bytes,
            "muted": self.is_muted,
        }
