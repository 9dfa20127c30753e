"""One peer with a face: what has come of its stream, and the face it makes at display time. Pure.

`call.Call` owns the participants and holds its lock around them. The roster knows who they are.

How much is wanted goes up at once and down late, so a head that comes and goes at the edge of the
screen costs a message or two a second at most, and its stream is there whenever it is seen.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from pica_client.avatars.library import AvatarStore
from pica_client.call.connection_quality import QualityMeter
from pica_client.call.roster import Member
from pica_client.playout.buffer import PlayedFace, Playout, PlayoutReport
from pica_client.tracks import FACE_KEY, FACE_LOST
from pica_core.codec.latent_stream import LatentDecoder, LatentSample
from pica_core.errors import AvatarFileError
from pica_protocol.frames import Frame
from pica_protocol.messages import Peer, Subscribe, Track

LOWER_AFTER_S: Final = 0.5
"""Less is asked for when nothing more was wanted for so long (chosen: longer than a glance
aside)."""
LOWER_INTERVAL_S: Final = 1.0
"""Shortest time between two requests for less of one stream."""
STALE_AFTER_S: Final = 2.0
"""A face without a frame for this long is shown as stale."""
FACE_NOTES: Final = {
    "muted": "face is off",
    FACE_LOST: "no face in front of the tracker",
}
"""Why no face comes, by what its owner says under `FACE_KEY`."""

Tell = Callable[[Subscribe], bool]
"""Tells the relay; returns False if that was not possible."""


class Participant:
    """One peer with a face, and what has come from it.

    Attributes:
        played: The face shown last; None before the first.
        told: The relay sends every so many frames, as far as it was told; 0: none.
    """

    def __init__(self, member: Member, track: Track) -> None:
        self.member = member
        self.track = track
        self.playout = Playout()
        self._is_held = False  # from when nothing is sent until the first frame after it
        self.played: PlayedFace | None = None
        self.last_arrival_s: float | None = None
        self.told = self._wanted = 1  # a relay that was told nothing sends everything
        self._before = PlayoutReport()  # when the statistics began
        self._meter = QualityMeter()
        self._decoder: LatentDecoder | None = None
        self._lower_s = math.inf  # when less is asked for
        self._lowered_s = -math.inf

    # Who it is

    def stays(self, peer: Peer | None) -> bool:
        """Return True if the peer that has this id after we joined again is the same one.

        A relay may deal old ids to other peers: only one that is the same in every respect goes on.
        """
        return peer is not None and replace(peer, metadata=()) == replace(
            self.member.peer, metadata=()
        )

    @property
    def note(self) -> str:
        """What is wrong with the stream, for people."""
        if self._is_muted_by_admin:
            return "muted by an admin"
        if self.member.is_away:
            return "connection lost"
        return FACE_NOTES.get(self._face_mode, "")

    @property
    def says_absent(self) -> bool:
        """Whether its owner has said that the tracker sees no face."""
        return self._face_mode == FACE_LOST

    def is_stale(self, now: float) -> bool:
        """Return True if frames are missing for so long that it is to be shown."""
        silent_s = 0.0 if self.last_arrival_s is None else now - self.last_arrival_s
        return silent_s > STALE_AFTER_S and self.told != 0

    # How much is wanted

    def subscribe(self, every: int, now: float) -> None:
        """Note that every so many frames are wanted, 0 for none."""
        if every == self._wanted:
            return
        self._wanted = every
        if _rate(every) >= _rate(self.told):
            self._lower_s = math.inf
        elif self._lower_s == math.inf:
            self._lower_s = max(now + LOWER_AFTER_S, self._lowered_s + LOWER_INTERVAL_S)

    def tell_subscription(self, tell: Tell, now: float) -> None:
        """Tell the relay how much is wanted, if that is due."""
        is_more = _rate(self._wanted) > _rate(self.told)
        if not is_more and now < self._lower_s:
            return
        if not tell(Subscribe(stream=self.track.stream, every=self._wanted)):
            return  # as while the network takes nothing
        if not is_more:
            self._lowered_s = now
        self._lower_s = math.inf
        self._note_told(self._wanted, now)

    def join_again(self, now: float) -> None:
        """Begin a connection: the relay sends everything again, so less is due now."""
        self._lower_s = math.inf if self._wanted == 1 else now
        self._note_told(1, now)

    def _note_told(self, every: int, now: float) -> None:
        if self.told == 0 and self.last_arrival_s is not None:
            self.last_arrival_s = now  # until now none was expected
        self.told = every
        self._is_held |= every == 0

    # The stream

    def receive_frame(self, frame: Frame, now: float, avatars: AvatarStore) -> LatentSample | None:
        """Take a frame off the wire and return its face; None while the avatar is not here.

        Raises:
            LatentError: It cannot be read.
        """
        if self._decoder is None and not self._open_decoder(avatars):
            return None
        assert self._decoder is not None
        sample = self._decoder.decode(frame.payload)
        if self.told:  # else it was under way when it was unsubscribed
            self.playout.receive(frame, sample, now)
            self._is_held = False
        self.last_arrival_s = now
        return sample

    def _open_decoder(self, avatars: AvatarStore) -> bool:
        with suppress(AvatarFileError):  # the viewer asks for it too, and shows what is wrong
            if (avatar := avatars.get(self.track.avatar)) is not None:
                self._decoder = LatentDecoder(avatar)
        return self._decoder is not None

    def play(self, now: float, heard_us: int | None = None) -> tuple[PlayedFace | None, bool]:
        """The face to show now, None before the first one; and whether the stream is stopped on
        purpose: then the face stands still, and nothing is concealed. ``heard_us`` as in
        `Playout.sample_at`."""
        if not self._is_held:
            self.played = self.playout.sample_at(now, heard_us)
        return self.played, self._is_held

    # Statistics

    def begin_window(self) -> None:
        """Begin the statistics here."""
        self._before = self.playout.report()

    def rated(self, now: float, *, is_busy: bool) -> Member:
        """The member with how well its stream comes in; asked about twice a second.

        Args:
            is_busy: Whether this machine was too busy to say how frames come.
        """
        if self.member.is_away or self._is_muted:
            quality = self._meter.pause()
        else:
            report = self.playout.report()
            quality = self._meter.skip() if is_busy else self._meter.receive(report, now)
        return replace(self.member, quality=quality)

    def stats(self, seconds: float | None) -> dict[str, Any]:
        """How the stream came in.

        Args:
            seconds: So long ago was `begin_window`; None: there was none, so since the peer came.
        """
        report, before = self.playout.report(), self._before
        received, shown = report.received - before.received, report.shown - before.shown
        concealed = report.concealed - before.concealed
        return {
            "name": self.member.peer.name,
            "received": received,
            "latents_per_s": round(received / seconds, 2) if seconds else None,
            "concealed": concealed,
            "concealed_ratio": round(concealed / shown, 4) if shown else 0.0,
            "playout_delay_ms": round(report.delay_s * 1e3, 2),
        }

    @property
    def _face_mode(self) -> str:
        return dict(self.member.peer.metadata).get(FACE_KEY, "")

    @property
    def _is_muted_by_admin(self) -> bool:
        return self.track.stream in self.member.muted_streams

    @property
    def _is_muted(self) -> bool:
        return self._is_muted_by_admin or self._face_mode == "muted"


def _rate(every: int) -> float:
    """The share of the frames that are sent."""
    return 1 / every if every else 0.0
