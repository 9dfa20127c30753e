"""One peer with a face: what has come of its stream, and the face it makes at display time.

`call.Call` owns the seats and holds its lock around them.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from pica_client.call.connection_quality import StreamHealth
from pica_client.call.layer_subscription import EVERY, NOTHING, LayerSubscription
from pica_client.playout.buffer import PlayedFace, Playout, PlayoutReport
from pica_client.playout.config import PlayoutConfig
from pica_client.publish.face_track import FACE_KEY, FACE_LOST
from pica_core.codec.latent_stream import LatentDecoder
from pica_core.errors import LatentError
from pica_protocol.frames import Frame
from pica_protocol.messages import Peer, Track

RETRY_S = 0.1
"""Until a subscription is told again that could not be, as while the network takes nothing."""
FACE_NOTES = {
    "muted": "face is off",
    "frozen": "face is frozen",
    FACE_LOST: "no face in front of the tracker",
}
"""Why a face stands still, by what its owner says under `FACE_KEY`."""


Tell = Callable[[int, int], bool]
"""Asks the relay for a share of a stream, see `Subscribe`; False if it could not be told."""


@dataclass(kw_only=True, slots=True)
class StreamWindow:
    """What one stream did since the statistics began."""

    received: int = 0
    payload_bytes: int = 0
    longest_gap_s: float = 0.0
    """Longest time without a frame that has ended."""
    silent_since_s: float | None = None
    """When the gap began that is still open: with the last frame; None: no frame is expected."""
    before: PlayoutReport = field(default_factory=PlayoutReport)


class RemoteParticipant:
    """One peer with a face, and what has come from it."""

    def __init__(self, peer: Peer, track: Track, config: PlayoutConfig | None) -> None:
        self.peer = peer
        self.track = track
        self.subscription = LayerSubscription()
        self.playout = Playout(config)
        self.decoder: LatentDecoder | None = None
        self.trouble = ""
        self.is_away = False
        self.is_muted = False
        self.is_paused = self.is_resuming = False
        self.played: PlayedFace | None = None
        self.last_arrival_s: float | None = None
        self.payload_bytes = 0
        self.window = StreamWindow()
        self.reported = PlayoutReport()

    def stays(self, peer: Peer | None) -> bool:
        """Say whether this is still the seat of whoever has its id after we joined again.

        Somebody else may have got an old id, as from another relay, or from one that lies: only who
        is the same in every respect keeps the seat.
        """
        if peer is None or replace(peer, metadata=()) != replace(self.peer, metadata=()):
            return False
        self.peer = peer
        return True

    def is_same_person(self, peer: Peer) -> bool:
        """Say whether somebody who comes is who sat here: by identity, or else by name."""
        mine = self.peer.identity or self.peer.name
        return mine == (peer.identity or peer.name)

    def succeed(self, former: "RemoteParticipant") -> None:
        """Go on counting where the last seat of the same person stopped."""
        counted = former.playout.report().since(former.window.before)
        self.window = replace(
            former.window,
            before=PlayoutReport().since(counted),
        )

    def note_gap(self, now: float, *, is_expected: bool) -> None:
        """End the gap that is open, and begin another if a next frame is to be expected."""
        window = self.window
        if window.silent_since_s is not None:
            window.longest_gap_s = max(window.longest_gap_s, now - window.silent_since_s)
        window.silent_since_s = now if is_expected else None

    def note_silence(self, now: float) -> None:
        """Note that it has changed whether the stream stands still on purpose."""
        is_expected = not (self.is_paused or self.is_muted or self.says_muted)
        if is_expected != (self.window.silent_since_s is not None):
            self.note_gap(now, is_expected=is_expected and self.last_arrival_s is not None)

    @property
    def note(self) -> str:
        """What is wrong with the stream, for people."""
        if self.trouble:
            return self.trouble
        if self.is_muted:
            return "muted by an admin"
        if self.is_away:
            return "connection lost"
        return FACE_NOTES.get(self._face_mode, "")

    @property
    def says_muted(self) -> bool:
        """Whether its owner has said that nothing is sent."""
        return self._face_mode == "muted"

    @property
    def says_absent(self) -> bool:
        """Whether its owner has said that the tracker sees nobody."""
        return self._face_mode == FACE_LOST

    @property
    def _face_mode(self) -> str:
        return dict(self.peer.metadata).get(FACE_KEY, "")

    def tell_subscription(self, tell: Tell, now: float) -> float | None:
        """Tell the relay how much is wanted, if that is due; return when to call again."""
        subscription = self.subscription
        share, before = subscription.due(now), subscription.told
        if share is not None:
            if not tell(self.track.stream, EVERY[share]):
                return now + RETRY_S
            subscription.note_told(share, now)
            if share == NOTHING:
                self.pause()
                self.note_silence(now)
            elif before == NOTHING:
                self.resume(now)
        return subscription.next_timer()

    def pause(self) -> None:
        """Note that the relay was told to send nothing: the face stands still on purpose."""
        self.playout.pause()
        self.is_paused, self.is_resuming = True, False

    def resume(self, now: float) -> None:
        """Note that the relay was told to send again: the face stands still until the first frame
        comes."""
        if self.is_paused:
            self.is_paused, self.is_resuming = False, True
            if self.last_arrival_s is not None:
                self.last_arrival_s = now
            self.note_silence(now)

    def receive_frame(self, frame: Frame, now: float) -> int:
        """Take a frame off the wire; there must be a decoder. Return how many payloads could not be
        read."""
        assert self.decoder is not None
        num_unreadable = 0
        for received in self.playout.sender.receive(frame, now):
            try:
                sample = self.decoder.decode(received.payload)
            except LatentError:
                num_unreadable += 1
            else:
                if self.is_paused:
                    continue  # it was on its way when we wanted nothing more
                self.playout.receive_frame(received.decoded(sample))
                if self.is_resuming:  # what the relay had kept; the next need not follow from it
                    self.playout.pause()
                self.is_resuming = False
        if num_unreadable:
            return num_unreadable
        self.last_arrival_s = now
        is_silent = self.is_paused or self.is_muted or self.says_muted
        self.note_gap(now, is_expected=not is_silent)
        window = self.window
        window.received += 1
        window.payload_bytes += len(frame.payload)
        self.payload_bytes += len(frame.payload)
        return 0

    def play(self, now: float, heard_us: int | None = None) -> tuple[PlayedFace | None, bool]:
        """The face to show now, None before the first one; and whether the stream is stopped on
        purpose: then the face stands still, and nothing is concealed. ``heard_us`` as in
        `Playout.sample_at`."""
        is_stopped = self.is_paused or self.is_resuming
        if not is_stopped:
            self.played = self.playout.sample_at(now, heard_us)
        return self.played, is_stopped

    def begin_window(self, now: float) -> None:
        """Begin the statistics anew."""
        self.window = StreamWindow(before=self.playout.report())
        self.note_silence(now)

    def health(self) -> StreamHealth:
        """What judges the connection."""
        return StreamHealth(
            **asdict(self.playout.report()),
            payload_bytes=self.payload_bytes,
            is_paused=self.is_away or self.is_muted or self.says_muted,
        )

    def stats(self, seconds: float | None, now: float | None) -> dict[str, Any]:
        """How the person's stream came in, over all their seats.

        Args:
            seconds: So long ago was `begin_window`; None: there was none, so since the call began.
            now: The time, up to which a gap counts that is still open; None: they are gone.
        """
        window = self.window
        gap_s = window.longest_gap_s
        if now is not None and window.silent_since_s is not None:
            gap_s = max(gap_s, now - window.silent_since_s)
        report = self.playout.report().since(window.before)
        counted = ("lost", "late", "concealed", "duplicates", "refused", "future", "restarts")
        return {
            "name": self.peer.name,
            "received": window.received,
            "latents_per_s": round(window.received / seconds, 2) if seconds else None,
            "payload_bps": round(window.payload_bytes * 8 / seconds) if seconds else None,
            "longest_gap_ms": round(gap_s * 1e3, 1),
            **{name: getattr(report, name) for name in counted},
            "concealed_ratio": round(report.concealed_ratio, 4),
            "playout_delay_ms": round(report.delay_s * 1e3, 2),
            "jitter_ms": round(report.jitter_s * 1e3, 2),
            "age_ms": round(report.age_s * 1e3, 2),
            "clock_offset_ms": round(report.offset_s * 1e3, 1),
        }
