"""The ends of a call: a `Sender` publishes, a `Receiver` also watches and listens.

Each runs one link to the relay. Garbage never gets further than here: what breaks the protocol ends
the connection, is counted, and the link comes back; what breaks a payload is counted by the call.
"""

import asyncio
import contextlib
import threading
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any, Final, Self

from pica_client.call.call import Call
from pica_client.call.connection_quality import Quality, QualityMeter, own_quality
from pica_client.call.roster import SELF_ID, Member
from pica_client.call.status import CallStatus
from pica_client.playout.buffer import PlayoutReport
from pica_client.publish import Outgoing, Publisher
from pica_client.tracks import FACE_TRACK, RECORDS_KEY, RECORDS_YES, voice_of
from pica_client.transport.connect import LinkConfig
from pica_client.transport.link import Link
from pica_client.voice.source import VoicePublisher
from pica_protocol.frames import Frame
from pica_protocol.invite import Invite, make_link
from pica_protocol.messages import Joined, Moderation, Peer, PeerJoined, Subscribe, Track
from pica_protocol.session import ClientEvent

SUBSCRIBE_INTERVAL_S: Final = 0.02
"""Between two looks at how much of each stream is wanted (chosen: less than a display frame)."""
CHECK_INTERVAL_S: Final = 0.25
"""Time between two timers that tell whether this machine is too busy."""
BUSY_RATIO: Final = 0.05
"""Share of the time by which the timers of the network's thread are late on a machine that is too
busy to take frames as they come (chosen: 12 ms each; a calm machine has 1, and one with six
programs for each core 10 to 80)."""
JOIN_TIMEOUT_S: Final = 5.0
"""Longest wait for the thread; a link that leaves is gone within its close timeouts."""


class Endpoint:
    """A link, and the face and the voice that go over it.

    Attributes:
        own: What is sent; the relay does not send it back.
    """

    def __init__(
        self, link_config: LinkConfig, own: Outgoing, *, say: Callable[[str], None] | None = None
    ) -> None:
        """Prepare. `say` is told what happens to the link, see `Link`."""
        self.own = own
        if own.face is not None:
            own.face.listen_to(own.voice)
        tracks = tuple(each.track for each in (own.face, own.voice) if each is not None)
        self.link = Link(link_config, tracks, on_event=self._on_event, say=say)
        self._stopping = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    def stop(self) -> None:
        """Leave the room; any thread may call it."""
        self._call_soon(self._leave)

    async def run(self) -> None:
        """Stay in the room until `stop`, or until the face was sent for its configured time; once.

        Raises:
            RelayError: The relay is not there, or will not have us.
            Exception: What the source of the face or of the voice raised.
        """
        self._loop = asyncio.get_running_loop()
        try:
            async with asyncio.TaskGroup() as beside:
                tasks = [beside.create_task(each) for each in self._work()]
                await self.link.run()
                for task in tasks:
                    task.cancel()
        except ExceptionGroup as errors:
            raise errors.exceptions[0] from None
        finally:
            self.own.close()
            if self.own.giver is not None:
                await self.own.giver.close()

    def _work(self) -> list[Coroutine[Any, Any, None]]:
        """What runs beside the link."""
        work = []
        if self.own.face is not None:
            work.append(self._publish(self.own.face))
        if self.own.voice is not None:
            work.append(self._publish(self.own.voice))
        return work

    async def _publish(self, publisher: Publisher | VoicePublisher) -> None:
        await publisher.pace(self.link, self._stopping)
        self._leave()

    def _leave(self) -> None:
        self._stopping.set()
        self.link.leave()

    def _on_event(self, event: ClientEvent, now: float) -> None:
        if isinstance(event, Joined) and self.own.giver is not None:
            self.own.giver.begin(self.link.url)
        if isinstance(event, PeerJoined | Joined):
            # The relay is to send nothing of newcomers that is not used here.
            for peer in [event.peer] if isinstance(event, PeerJoined) else event.peers:
                for track in peer.tracks:
                    if not self._wants(track, peer):
                        self.link.tell(Subscribe(stream=track.stream, every=0))

    def _wants(self, track: Track, peer: Peer) -> bool:
        """Return True if a track of a newcomer is used here: the first face, voices that are heard;
        by a sender none."""
        return False

    def _call_soon(self, action: Callable[[], object]) -> None:
        """Call something on the loop; at once as long as there is none."""
        if self._loop is None:
            action()
            return
        with contextlib.suppress(RuntimeError):  # the loop may be closed by now
            self._loop.call_soon_threadsafe(action)

    def _own_stats(self) -> dict[str, Any]:
        guard = self.link.guard
        return {
            "voice": None if self.own.voice is None else self.own.voice.stats(),
            "reconnects": self.link.reconnects,
            "resumes": self.link.resumes,
            "seal": None if guard is None else guard.stats(),
        }


class Sender(Endpoint):
    """Publishes a face, and a voice with it, and takes nothing of the others."""

    def stats(self) -> dict[str, Any]:
        """What was sent so far, and the link's side of it."""
        face, link = self.own.face, self.link
        seconds = 0.0 if face is None else face.seconds_sent
        return {
            "name": link.config.name,
            **({} if face is None else face.stats()),
            **self._own_stats(),
            "replaced": link.num_replaced,
            "wire_bytes": link.sent_wire_bytes,
            "wire_bps": round(link.sent_wire_bytes * 8 / seconds) if seconds else None,
            "errors": link.errors,
        }


class Receiver(Endpoint):
    """Feeds a call with what comes from the others, and may publish as well.

    On an event loop that is there: ``await receiver.run()``. Beside a drawing loop: ``with
    receiver: …`` runs it in a thread, and `check` tells the drawing thread what went wrong there.

    Attributes:
        late_s: By how much timers of the network's thread were late in all, seconds.
    """

    def __init__(
        self,
        link_config: LinkConfig,
        call: Call,
        own: Outgoing | None = None,
        *,
        say: Callable[[str], None] | None = None,
    ) -> None:
        """Prepare; see `Endpoint`. Without ears of the call no voices are sent to us."""
        super().__init__(link_config, own or Outgoing(), say=say)
        self.call = call
        self.late_s = 0.0
        self._started = threading.Event()
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None
        self._uplink = QualityMeter()
        self._looked: tuple[float, float] | None = None  # when, and by how much timers were late
        call.own_name = link_config.name
        call.guard = self.link.guard

    def check(self) -> None:
        """Raise what ended the thread, if anything did, as `run` does."""
        if self._error is not None:
            raise self._error

    def moderate(self, message: Moderation) -> None:
        """Ask the relay to remove, mute or bar a member, if our token allows it; from any
        thread."""
        self._call_soon(lambda: self.link.tell(message))

    def say_recording(self, is_recording: bool) -> None:
        """Tell the others whether what is seen here is kept; any thread may call it."""
        value = RECORDS_YES if is_recording else ""
        self._call_soon(lambda: self.link.describe(RECORDS_KEY, value))

    def stats(self, now: float) -> dict[str, Any]:
        """`Call.stats`, and the link's side of it."""
        stats = self.call.stats(now)
        return stats | {
            **self._own_stats(),
            "errors": stats["errors"] + self.link.errors,
            "received_wire_bytes": self.link.received_wire_bytes,
            "sent": None if self.own.face is None else self.own.face.stats(),
        }

    def status(self, now: float) -> CallStatus:
        """How the call stands at `now`, seconds, for the texts over the picture; to be asked about
        twice a second."""
        link, face = self.link, self.own.face
        is_busy = self._is_busy(now)
        room = self.call.room(now, is_busy=is_busy)
        quality = [member.quality for member in room.participants]
        muted = " and ".join(link.muted)
        tracks = tuple(replace(track, stream=i) for i, track in enumerate(link.tracks, 1))
        own = Member(
            peer=Peer(
                peer_id=SELF_ID, name=self.call.own_name, tracks=tracks, metadata=link.metadata
            ),
            is_away=not link.is_joined,
            note="muted by an admin" if muted else "",
        )
        return replace(
            room,
            participants=(own, *room.participants),
            room=link.config.room,
            invitation=make_link(Invite(url=link.config.url, room=link.config.room)),
            is_encrypted=link.guard is not None,
            code="" if link.guard is None else link.guard.status.code,
            is_connected=link.is_joined,
            away_s=0.0 if link.left_s is None else now - link.left_s,
            own_quality=own_quality(quality, self._sent_quality(now, is_busy)),
            is_admin=link.is_admin,
            muted_by_admin=muted,
            own_trouble="" if face is None else face.trouble,
        )

    def _is_busy(self, now: float) -> bool:
        """Return True if this machine was too busy, since the last look, to say how frames come."""
        before_s, late_before_s = self._looked or (now, self.late_s)
        self._looked = now, self.late_s
        return self.late_s - late_before_s > BUSY_RATIO * (now - before_s)

    def _sent_quality(self, now: float, is_busy: bool) -> Quality:
        """How the network takes our own frames; unknown while we send none."""
        face = self.own.face
        if face is None or not self.link.is_joined:
            return self._uplink.pause()
        if is_busy:
            return self._uplink.skip()
        missed_s = self.link.num_replaced / face.config.fps
        return self._uplink.receive(PlayoutReport(received=face.num_sent, missed_s=missed_s), now)

    def __enter__(self) -> Self:
        def work() -> None:
            try:
                asyncio.run(self.run())
            except Exception as error:  # for the other thread to see, see `check`
                self._error = error

        self._thread = threading.Thread(target=work, name="receiver", daemon=True)
        self._thread.start()
        self._started.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout=JOIN_TIMEOUT_S)

    def _work(self) -> list[Coroutine[Any, Any, None]]:
        self._started.set()
        return [*super()._work(), self._time_loop(), self._tell_subscriptions()]

    def _on_event(self, event: ClientEvent, now: float) -> None:
        self.call.receive_event(event, now)
        if not isinstance(event, Frame):
            super()._on_event(event, now)

    def _wants(self, track: Track, peer: Peer) -> bool:
        first = next((each for each in peer.tracks if each.kind == FACE_TRACK), None)
        return track == first or (self.call.ears is not None and track == voice_of(peer))

    async def _tell_subscriptions(self) -> None:
        """Tell the relay how much of each stream is wanted, when that changes."""
        loop = asyncio.get_running_loop()
        while True:
            if self.link.is_joined:
                self.call.tell_subscriptions(self.link.tell, loop.time())
            await asyncio.sleep(SUBSCRIBE_INTERVAL_S)

    async def _time_loop(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due_s = loop.time() + CHECK_INTERVAL_S
            await asyncio.sleep(CHECK_INTERVAL_S)
            self.late_s += max(loop.time() - due_s, 0.0)
