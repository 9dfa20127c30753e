"""The receiving half of a call: who is there, their streams, and their faces at display time.

`Call` is the state: events of the link go in on the network thread, faces come out on the drawing
thread, one lock between them. `Receiver` is the shell that runs a link for it, on the event loop it
is called from or in a thread of its own.

What is wrong with one stream stays with that stream: a payload that cannot be read is counted and
the face is held; a peer whose avatar nobody has gets a seat without a face.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import threading
from collections import deque
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, NamedTuple, Self

from pica_client.avatars import AvatarStore
from pica_client.errors import OptionError
from pica_client.faces import FaceState, FaceStatus
from pica_client.link import Connector, Link, LinkConfig
from pica_client.playout import Playout, PlayoutConfig, PlayoutReport, TimedSample
from pica_client.sender import FACE_TRACK
from pica_core.avatar_file import Avatar
from pica_core.errors import AvatarFileError, LatentError
from pica_core.latent_stream import LatentProfile, decode_latent
from pica_protocol.frames import Frame
from pica_protocol.messages import Joined, Peer, PeerJoined, PeerLeft, Report, StreamReport, Track
from pica_protocol.session import ClientEvent

REPORT_INTERVAL_S = 5.0
"""Between two reports to the relay."""
MAX_DEPARTED = 64
"""Peers remembered for the statistics after they left; drops the oldest."""
MAX_SHOWN = 100_000
"""Shown faces remembered for a latency analysis: eleven minutes of five peers at 30 a second."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CallConfig:
    """How a receiver plays."""

    playout: PlayoutConfig = field(default_factory=PlayoutConfig)
    stale_after_s: float = 2.0
    """A face without a frame for this long is shown as stale."""

    def __post_init__(self) -> None:
        if not self.stale_after_s > 0:
            raise OptionError(f"stale_after_s is {self.stale_after_s:g}; it must be above 0")


class Shown(NamedTuple):
    """One face as it was handed to the display."""

    name: str
    shown_us: int
    """The moment shown, sender's clock; `FaceState.captured_us`."""
    captured_us: int
    """The newest frame that went into it, sender's clock."""
    arrived_us: int
    """When that frame came, our clock."""


class DueFrame(NamedTuple):
    """A frame whose time has come, and whose it is."""

    peer_id: str
    name: str
    avatar_id: str
    frame: TimedSample


@dataclass(kw_only=True, slots=True)
class _Window:
    """What one stream did since the statistics began."""

    received: int = 0
    payload_bytes: int = 0
    longest_gap_s: float = 0.0
    before: PlayoutReport = field(default_factory=PlayoutReport)


class _Seat:
    """One peer with a face, and what has come from it."""

    def __init__(self, peer: Peer, track: Track, config: PlayoutConfig) -> None:
        self.peer = peer
        self.track = track
        self.playout = Playout(config)
        self.profile: LatentProfile | None = None
        self.last_arrival_s: float | None = None
        self.window = _Window()
        self.reported = PlayoutReport()

    def begin_window(self) -> None:
        self.window = _Window(before=self.playout.report())


class Call:
    """Everybody in the room and how their faces look; implements `pica_client.faces.FaceSource`.

    Attributes:
        errors: Payloads that could not be read.
        without_avatar: Frames whose avatar is not there, or not yet.
        strays: Frames of streams that nobody owns, as when their peer has just left.
    """

    def __init__(
        self,
        avatars: AvatarStore,
        config: CallConfig | None = None,
        *,
        log_shown: bool = False,
    ) -> None:
        self.config = config or CallConfig()
        self.errors = self.without_avatar = self.strays = 0
        # Drops its oldest when full.
        self._shown: deque[Shown] = deque(maxlen=MAX_SHOWN if log_shown else 0)
        self._avatars = avatars
        self._lock = threading.Lock()
        self._seats: dict[str, _Seat] = {}  # bounded by the protocol's limit on peers
        self._by_stream: dict[int, _Seat] = {}
        self._departed: deque[_Seat] = deque(maxlen=MAX_DEPARTED)
        self._window_begin_s: float | None = None

    # The network's side

    def receive_event(self, event: ClientEvent, now: float) -> None:
        """Take an event of the link's session."""
        with self._lock:
            match event:
                case Frame():
                    self._receive_frame(event, now)
                case Joined(peers=peers):
                    # Another relay may give an old id to somebody else: only who is the same in
                    # every respect keeps the seat.
                    for peer_id, seat in list(self._seats.items()):
                        if seat.peer not in peers:
                            self._remove(peer_id)
                    for peer in peers:
                        self._add(peer)
                case PeerJoined(peer=peer):
                    self._add(peer)
                case PeerLeft(peer_id=peer_id):
                    self._remove(peer_id)
                case _:
                    pass  # a keyframe is all we ever send; a closed session is the link's affair

    def take_report(self) -> Report:
        """How the streams arrived since the last report, for the relay."""
        with self._lock:
            streams = []
            for stream, seat in self._by_stream.items():
                report, before = seat.playout.report(), seat.reported
                seat.reported = report
                streams.append(
                    StreamReport(
                        stream=stream,
                        received=report.received - before.received,
                        lost=max(report.lost - before.lost, 0),
                        concealed=report.concealed - before.concealed,
                    )
                )
            return Report(streams=tuple(streams))

    # The display's side

    def faces(self, now: float) -> list[FaceState]:
        """See `FaceSource.faces`."""
        with self._lock:
            return [self._face(seat, now) for seat in self._seats.values()]

    def avatar(self, avatar_id: str) -> Avatar | None:
        """See `FaceSource.avatar`; an avatar that nobody here has is an error with the fix."""
        if not self._avatars.has(avatar_id):
            raise AvatarFileError(
                f"avatar {avatar_id[:8] or '(none)'} is not on this machine; "
                "get its file and name it with --avatar"
            )
        return self._avatars.get(avatar_id)

    # Instead of the display: every frame once

    def due_frames(self, now: float) -> list[DueFrame]:
        """Take every frame that is due; not to be mixed with `faces`."""
        with self._lock:
            return [
                DueFrame(seat.peer.peer_id, seat.peer.name, seat.track.avatar, frame)
                for seat in self._seats.values()
                for frame in seat.playout.due_frames(now)
            ]

    def next_timer(self) -> float | None:
        """When the next frame becomes due, or None."""
        with self._lock:
            timers = [seat.playout.next_timer() for seat in self._seats.values()]
        return min((timer for timer in timers if timer is not None), default=None)

    # Statistics

    @property
    def num_live(self) -> int:
        """Peers of whom a frame has been read."""
        with self._lock:
            return sum(seat.last_arrival_s is not None for seat in self._seats.values())

    @property
    def num_waiting(self) -> int:
        """Frames held by all playout buffers together."""
        with self._lock:
            return sum(seat.playout.num_waiting for seat in self._seats.values())

    def names(self) -> dict[str, str]:
        """Name by peer id of everybody with a face."""
        with self._lock:
            return {peer_id: seat.peer.name for peer_id, seat in self._seats.items()}

    def begin_window(self, now: float) -> None:
        """Let the statistics begin here: what came before was warming up."""
        with self._lock:
            self._window_begin_s = now
            self._departed.clear()
            self._shown.clear()
            for seat in self._seats.values():
                seat.begin_window()

    def take_shown(self) -> list[Shown]:
        """The faces shown in the window, if they were to be logged."""
        with self._lock:
            shown = list(self._shown)
            self._shown.clear()
        return shown

    def stats(self, now: float) -> dict[str, Any]:
        """How the streams came in since `begin_window`, or since the call began."""
        with self._lock:
            begin_s = self._window_begin_s
            seconds = None if begin_s is None else now - begin_s
            peers = [self._seat_stats(seat, seconds) for seat in self._all_seats()]
            return {
                "seconds": None if seconds is None else round(seconds, 3),
                "peers": peers,
                "dropped": sum(peer["lost"] for peer in peers),
                "concealed": sum(peer["concealed"] for peer in peers),
                "errors": self.errors,
                "without_avatar": self.without_avatar,
                "strays": self.strays,
            }

    def _all_seats(self) -> list[_Seat]:
        return [*self._departed, *self._seats.values()]

    def _seat_stats(self, seat: _Seat, seconds: float | None) -> dict[str, Any]:
        window, report = seat.window, seat.playout.report()
        return {
            "name": seat.peer.name,
            "received": window.received,
            "latents_per_s": round(window.received / seconds, 2) if seconds else None,
            "payload_bps": round(window.payload_bytes * 8 / seconds) if seconds else None,
            "longest_gap_ms": round(window.longest_gap_s * 1e3, 1),
            "lost": report.lost - window.before.lost,
            "late": report.late - window.before.late,
            "concealed": report.concealed - window.before.concealed,
            "restarts": report.restarts - window.before.restarts,
            "playout_delay_ms": round(report.delay_s * 1e3, 2),
        }

    def _add(self, peer: Peer) -> None:
        if peer.peer_id in self._seats:
            return
        for track in peer.tracks:
            if track.kind == FACE_TRACK:
                self._avatars.get(track.avatar)  # it is loaded by the time the first frame comes
                seat = _Seat(peer, track, self.config.playout)
                self._seats[peer.peer_id] = self._by_stream[track.stream] = seat
                return  # one face a person

    def _remove(self, peer_id: str) -> None:
        seat = self._seats.pop(peer_id, None)
        if seat is not None:
            self._by_stream.pop(seat.track.stream, None)
            self._departed.append(seat)

    def _receive_frame(self, frame: Frame, now: float) -> None:
        seat = self._by_stream.get(frame.stream)
        if seat is None:
            self.strays += 1
            return
        if seat.profile is None:
            try:
                avatar = self._avatars.get(seat.track.avatar)
            except AvatarFileError:
                avatar = None  # the viewer asks for it too, and shows what is wrong with it
            if avatar is None:
                self.without_avatar += 1
                return
            seat.profile = LatentProfile.from_manifest(avatar.manifest)
        try:
            sample = decode_latent(frame.payload, seat.profile)
        except LatentError:
            self.errors += 1
            return
        seat.playout.receive_frame(frame.sequence, frame.captured_us, sample, now)
        if seat.window.received and seat.last_arrival_s is not None:
            gap_s = now - seat.last_arrival_s
            seat.window.longest_gap_s = max(seat.window.longest_gap_s, gap_s)
        seat.last_arrival_s = now
        seat.window.received += 1
        seat.window.payload_bytes += len(frame.payload)

    def _face(self, seat: _Seat, now: float) -> FaceState:
        played = seat.playout.sample_at(now)
        if played is None:
            return FaceState(
                peer_id=seat.peer.peer_id,
                name=seat.peer.name,
                avatar_id=seat.track.avatar,
                latent=None,
                status="waiting",
            )
        status: FaceStatus = "concealed" if played.is_concealed else "live"
        if seat.last_arrival_s is not None and now - seat.last_arrival_s > (
            self.config.stale_after_s
        ):
            status = "stale"
        newest = played.newest
        self._shown.append(
            Shown(
                seat.peer.name,
                played.captured_us,
                newest.captured_us,
                round(newest.arrived_s * 1e6),
            )
        )
        return FaceState(
            peer_id=seat.peer.peer_id,
            name=seat.peer.name,
            avatar_id=seat.track.avatar,
            latent=played.sample.latent,
            rotation=played.sample.rotation,
            translation_m=played.sample.translation_m,
            captured_us=max(played.captured_us, 0),
            status=status,
        )


class Receiver:
    """Runs a link for a call.

    On an event loop that is there: ``await receiver.run()``. Beside a drawing loop: ``with
    receiver: …`` runs it in a thread, and `check` tells the drawing thread what went wrong there.
    """

    def __init__(
        self,
        link_config: LinkConfig,
        call: Call,
        *,
        connector: Connector | None = None,
        rng: random.Random | None = None,
    ) -> None:
        """Prepare; see `Link` for connector and rng."""
        self.call = call
        self.link = Link(link_config, on_event=self._on_event, connector=connector, rng=rng)
        self.arrived = asyncio.Event()
        """Set by every event; for those who wait on the same loop."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    async def run(self) -> None:
        """Receive until `stop`.

        Raises:
            RelayError: The relay is not there, or will not have us.
        """
        self._loop = asyncio.get_running_loop()
        reporting = asyncio.create_task(self._report(), name="reports")
        try:
            await self.link.run()
        finally:
            reporting.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reporting

    def stop(self) -> None:
        """Make `run` leave the room and return; any thread may call it."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop may be closed by now
                self._loop.call_soon_threadsafe(self.link.leave)

    def check(self) -> None:
        """Raise what ended the thread, if anything did.

        Raises:
            RelayError: As `run`.
        """
        if self._error is not None:
            raise self._error

    @property
    def is_connected(self) -> bool:
        """Whether the relay has us in the room right now."""
        return self.link.is_joined

    def stats(self, now: float) -> dict[str, Any]:
        """`Call.stats`, and the link's side of it."""
        stats = self.call.stats(now)
        counters = self.link.counters
        stats["errors"] += counters.errors
        stats["reconnects"] = self.link.reconnects
        stats["received_wire_bytes"] = counters.received_wire_bytes
        return stats

    def __enter__(self) -> Self:
        started = threading.Event()

        async def main() -> None:
            self._loop = asyncio.get_running_loop()
            started.set()
            await self.run()

        def work() -> None:
            try:
                asyncio.run(main())
            except Exception as error:  # for the other thread to see, see `check`
                self._error = error
            finally:
                started.set()

        self._thread = threading.Thread(target=work, name="receiver", daemon=True)
        self._thread.start()
        started.wait()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()
        if self._thread is not None:
            # A link that is told to leave is gone within its close timeouts.
            self._thread.join(timeout=5.0)

    def _on_event(self, event: ClientEvent, now: float) -> None:
        self.call.receive_event(event, now)
        self.arrived.set()

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(REPORT_INTERVAL_S)
            self.link.report(self.call.take_report())
