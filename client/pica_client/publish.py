"""A face on its way out: source -> expression encoder -> payload -> frame, at a steady rate; and
controls of it while it is sent: choose another source, see what the tracker sees.

The link is run by an endpoint: a `Sender`, which does nothing else, or a
`Receiver`, which also listens. Encoding takes a fraction of a millisecond and so
runs on the event loop itself; a thread would cost more than it saves.
"""

import asyncio
import logging
import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import AvatarGiver, GiveAvatar, avatar_by_name, giver_of
from pica_client.errors import OptionError, SourceError, check_ranges
from pica_client.sources import Source, Tracker, open_source
from pica_client.sources.source import Present, Unseen
from pica_client.tracks import FACE_KEY, FACE_LOST, FACE_TRACK, FaceMode
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link, sleep_until
from pica_client.voice.mouth import SpokenFace
from pica_client.voice.source import VoicePublisher
from pica_core.avatar.arkit import ExpressionFrame
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import BEST_QUALITY, DEFAULT_QUALITY, EncodedFrame, LatentEncoder
from pica_core.types import Image
from pica_protocol.messages import Track

_log = logging.getLogger(__name__)

OnSent = Callable[[EncodedFrame, int, float], None]
"""Takes a frame that was sent, its capture time in microseconds, and the time, seconds."""
MAX_AGE_US = 200_000
"""Oldest face that a tracker's delay explains."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SenderConfig:
    """How fast and how long to send."""

    fps: float = 30.0
    """Frames a second, 1 to 240."""
    seconds: float = 0.0
    """How long to send, once the relay has let us in; 0 is until Ctrl-C."""
    quality: int = DEFAULT_QUALITY
    """Fineness of the coded stream, 0 to 7; each step up costs a quarter more bits."""

    def __post_init__(self) -> None:
        check_ranges(self, fps=(1, 240), quality=(0, BEST_QUALITY))
        if not self.seconds >= 0:
            raise OptionError(f"seconds is {self.seconds:g}; 0 (for ever) or more is allowed")


class Publisher:
    """Sends one face over a link.

    Args:
        config: How fast and how long.
        avatar_identity: Hash of the avatar's file.

    Attributes:
        avatar: Whose expression encoder makes the latents.
        mode: How the face is sent from the next frame on, as its owner chose; any thread may set
            it.
        seen: The source's latest face, whether it is sent or not; None before the first.
    """

    def __init__(
        self, config: SenderConfig, source: Source, avatar: Avatar, avatar_identity: str
    ) -> None:
        self.config = config
        self.avatar = avatar
        self._watcher: OnSent | None = None
        self.source = source
        self.seen: ExpressionFrame | None = None
        self._expressions = ExpressionEncoder(avatar)
        self._stream = LatentEncoder(avatar, fps=config.fps, quality=config.quality)
        self.track = Track(kind=FACE_TRACK, avatar=avatar_identity)
        self._first_sent_s: float | None = None
        self._last_sent_s = 0.0
        self.num_sent = self._faceless = self._payload_bytes = 0
        self._num_joins = 0
        self.mode: FaceMode = "sent"
        self._mode_before: FaceMode = "sent"
        self._is_lost = False
        self._spoken: SpokenFace | None = None
        self._begin_s = 0.0
        self._told_trouble = ""
        self._told = ""

    def listen_to(self, voice: VoicePublisher | None) -> None:
        """Let the owner's voice move the mouth while the tracker sees no face."""
        if voice is not None:
            spoken = self._spoken = SpokenFace(stays=isinstance(self.source, Present))
            voice.listeners.append(
                lambda pcm, captured_us: spoken.hear(pcm, captured_us / 1e6 - self._begin_s)
            )

    def watch(self, watcher: OnSent) -> None:
        """Let a watcher have each frame that is sent from now on; the next one is sent however
        still the face is."""
        self._watcher = watcher
        self._stream.restart()

    @property
    def trouble(self) -> str:
        """What is wrong with the tracker, for its user; empty: nothing, or there is none."""
        source = self.source  # another thread may replace it
        return source.trouble if isinstance(source, Tracker) else ""

    def replace_source(self, source: Source) -> None:
        """Take the face from another source from the next frame on, and let go of the one before.
        Any thread may call it."""
        before, self.source = self.source, source
        if isinstance(before, Tracker):
            before.close()

    def close(self) -> None:
        """Let go of the tracker."""
        self.replace_source(Unseen())

    async def pace(self, link: Link, stopping: asyncio.Event) -> None:
        """Send until told to stop, or for the configured time."""
        loop = asyncio.get_running_loop()
        begin_s, joined_s = loop.time(), math.inf
        self._begin_s, index = begin_s, 0
        while not stopping.is_set():
            # Frame k is due k / fps after the first, so small delays never add up.
            now = await sleep_until(begin_s + index / self.config.fps)
            if stopping.is_set():
                return
            if link.is_joined:
                joined_s = min(joined_s, now)
            if 0 < self.config.seconds <= now - joined_s:
                return
            self._tell_mode(link)
            self._tell_trouble()
            self._send_face(link, now - begin_s, now)
            # A sender late by more than a frame sends the present face, not those that were missed.
            # The tolerance is for a frame that ends exactly on the next one's time.
            newest = math.floor((max(loop.time(), now) - begin_s) * self.config.fps + 1e-6)
            index = max(index + 1, newest)

    def stats(self) -> dict[str, Any]:
        """What was sent so far; rates are over the time from the first frame to the last."""
        seconds = self.seconds_sent
        return {
            "seconds": round(seconds, 3),
            "sent": self.num_sent,
            "without_face": self._faceless,
            "payload_bytes": self._payload_bytes,
            "payload_bps": round(self._payload_bytes * 8 / seconds) if seconds else None,
        }

    @property
    def seconds_sent(self) -> float:
        """Time from the first frame to the last."""
        return self._last_sent_s - (self._first_sent_s or 0.0)

    def _tell_mode(self, link: Link) -> None:
        """Let the others know why no face is sent."""
        reason = self.mode if self.mode != "sent" else FACE_LOST if self._is_lost else ""
        if reason != self._told:
            self._told = reason
            link.describe(FACE_KEY, reason)

    def _tell_trouble(self) -> None:
        """Let the face's owner know what is wrong with the tracker."""
        trouble = self.trouble
        if trouble != self._told_trouble:
            self._told_trouble = trouble
            _log.warning(trouble or "the tracker is there again")

    def _face(self, time_s: float) -> ExpressionFrame:
        """The face to send: the source's, moved by the voice where that lacks one."""
        frame = self.seen = self.source.frame_at(time_s)
        if self._spoken is not None:
            frame = self._spoken.fill(frame, time_s)
        self._is_lost = not frame.has_face
        return replace(frame, has_face=False) if self.mode == "muted" else frame

    def _send_face(self, link: Link, time_s: float, now: float) -> None:
        """Sample, encode and offer one face."""
        if not link.is_joined:
            return
        if link.connects != self._num_joins:
            self._num_joins = link.connects
            self._stream.restart()  # the room has seen nothing of us, or of the last of it
        if self.mode != self._mode_before:
            if self._mode_before == "muted":
                self._stream.restart()  # they have seen nothing for a while
            self._mode_before = self.mode
        frame = self._face(time_s)
        if not frame.has_face:
            self._faceless += 1  # nothing to say: the receivers see the stream fall silent
            return
        # When a tracker saw it, which is before now.
        age_us = round(time_s * 1e6) - frame.captured_us
        captured_us = max(round(now * 1e6) - min(max(age_us, 0), MAX_AGE_US), 0)
        latent = self._expressions.encode(frame.arkit)
        coded = self._stream.encode(
            frame.arkit, frame.rotation, frame.translation_m, captured_us, latent=latent
        )
        if coded is None:
            self._last_sent_s = now
            return  # still: the receivers know, and hold the face
        if link.send_frame(coded.payload, captured_us, multiple=coded.multiple):
            if self._watcher is not None:
                self._watcher(coded, captured_us, now)
            self._first_sent_s = now if self._first_sent_s is None else self._first_sent_s
            self._last_sent_s = now
            self.num_sent += 1
            self._payload_bytes += len(coded.payload)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Outgoing:
    """What one end of a call sends; by default nothing."""

    face: Publisher | None = None
    voice: VoicePublisher | None = None
    giver: AvatarGiver | None = None
    """Gives the avatar's file to each relay that we join."""

    def close(self) -> None:
        """Let go of the tracker."""
        if self.face is not None:
            self.face.close()


DEFAULT_SOURCE: Final = "performance:talk"
"""Default source."""


def open_face(
    source: str,
    link: LinkConfig,
    library: AvatarLibrary,
    say: Callable[[str], None],
    *,
    avatar: str | None = None,
    give: GiveAvatar = "auto",
    config: SenderConfig | None = None,
) -> Outgoing:
    """Make a face ready to be sent.

    Args:
        source: What plays it, as `sources.open_source` takes it.
        avatar: A shipped one by its name, or a .pica file; None takes one by the wearer's name.
        give: Whether the relay gets the avatar's file.
        config: How fast and how long.

    Raises:
        SourceError: The source cannot be opened.
        OptionError: The avatar is not there.
        AvatarFileError: It must not be used.
    """
    identity = library.find(avatar or avatar_by_name(link.name, library.names))
    worn = library.load(identity)
    played = open_source(source, person=link.name)
    face = Publisher(config or SenderConfig(), played, worn, identity)
    giver = giver_of(library.path(identity), identity, link, say, give)
    return Outgoing(face=face, giver=giver)


class FaceControls:
    """Steers one publisher. All methods are for one thread, which need not be the publisher's.

    Args:
        person: Whose calibrations are meant.
        source: What plays the face, as `sources.open_source` took it.
    """

    def __init__(self, publisher: Publisher, person: str, source: str) -> None:
        self.publisher = publisher
        self.source = source
        self._person = person
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="own-face")
        self._opening: tuple[str, Future[None]] | None = None

    def close(self) -> None:
        """Wait for a source that is being opened."""
        self._pool.shutdown()

    def choose(self, source: str) -> None:
        """Take another source once it is open; the one before stays where that fails."""
        if self._opening is None and source != self.source:
            self._opening = source, self._pool.submit(self._open, source)

    def take_notice(self) -> str:
        """What became of the choice, for the user, once that is known."""
        if self._opening is None or not self._opening[1].done():
            return ""
        (source, opening), self._opening = self._opening, None
        try:
            opening.result()
        except (SourceError, ModuleNotFoundError) as error:
            return str(error)
        self.source = source
        return f"Your face comes from {source}"

    def preview(self) -> tuple[bool, Image | None] | None:
        """Whether the tracker sees a face, for its owner alone, and a camera's picture, uint8
        ``[H, W, 3]``; None where no tracker plays the face."""
        source, frame = self.publisher.source, self.publisher.seen
        if not isinstance(source, Tracker) or frame is None:
            return None
        return frame.has_face, source.preview()

    def _open(self, source: str) -> None:
        self.publisher.replace_source(Unseen())  # both may want the same port or camera
        try:
            opened = open_source(source, person=self._person)
        except (SourceError, ModuleNotFoundError):
            self.publisher.replace_source(open_source(self.source, person=self._person))
            raise
        self.publisher.replace_source(opened)
