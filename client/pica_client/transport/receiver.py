"""The network half of a receiver: runs a link and feeds a call with what comes over it.

Garbage never gets further than here: what breaks the protocol ends the connection, is counted, and
the link comes back; what breaks a payload is counted by the call.
"""

import asyncio
import contextlib
import random
import threading
from collections.abc import Callable, Sequence
from typing import Any, Self

from pica_client.avatars.upload import AvatarGiver
from pica_client.call.call import Call
from pica_client.e2ee.status import SealStatus
from pica_client.publish.face_track import FACE_TRACK, RECORDS_KEY, RECORDS_YES
from pica_client.publish.publisher import Publisher
from pica_client.transport.config import LinkConfig
from pica_client.transport.link import Link
from pica_client.transport.link_news import LinkNews
from pica_client.transport.timers import wait_until
from pica_client.voice.publisher import VoicePublisher
from pica_client.voice.receiver import OnVoice, VoiceReceiver
from pica_protocol.messages import Joined, Moderation, Peer, PeerJoined
from pica_protocol.session import ClientEvent

REPORT_INTERVAL_S = 5.0
"""Time between two reports to the relay."""
JOIN_TIMEOUT_S = 5.0
"""Longest wait for the thread; a link that leaves is gone within its close timeouts."""


class Receiver:
    """Runs a link for a call.

    On an event loop that is there: ``await receiver.run()``. Beside a drawing loop: ``with
    receiver: …`` runs it in a thread, and `check` tells the drawing thread what went wrong there.

    Attributes:
        is_recording: Whether the others are told that what is seen here is kept.
    """

    def __init__(
        self,
        link_config: LinkConfig,
        call: Call,
        *,
        publisher: Publisher | None = None,
        rng: random.Random | None = None,
        giver: AvatarGiver | None = None,
        news: LinkNews | None = None,
        voice: VoicePublisher | None = None,
        on_voice: OnVoice | None = None,
        takes_faces: bool = True,
    ) -> None:
        """Prepare; see `Link` for rng. With a publisher, a face is sent as well, over
        the same link: the relay does not send it back; with a voice, that too. A giver gives its
        avatar's file to each relay that we join; `news` hears of the link. ``on_voice`` is handed
        the voices of the others, see `OnVoice`; without it none are sent to us, and without
        ``takes_faces`` no faces."""
        self.call = call
        call.set_own_name(link_config.name)
        self.publisher = publisher
        self.is_recording = False
        self._giver = giver
        self._news = news
        self.voice = voice
        if publisher is not None:
            publisher.listen_to(voice)
        self.voices = VoiceReceiver(on_voice)
        self._takes_faces = takes_faces
        tracks = tuple(each.track for each in (publisher, voice) if each is not None)
        self.link = Link(link_config, tracks, on_event=self._on_event, rng=rng)
        self.arrived = asyncio.Event()
        """Set by every event; for those who wait on the same loop."""
        self._subscribed = asyncio.Event()
        call.connect(self)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._started = threading.Event()
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    async def run(self) -> None:
        """Receive until `stop`; once.

        Raises:
            RelayError: The relay is not there, or will not have us.
            Exception: What the source of the face or of the voice raised.
        """
        if self._loop is not None:
            raise RuntimeError("a receiver is good for one call")
        self._loop = asyncio.get_running_loop()
        self._started.set()
        stopping = asyncio.Event()
        work = [self._report(), self._tell_subscriptions()]
        work += [own.pace(self.link, stopping) for own in (self.publisher, self.voice) if own]
        try:
            async with asyncio.TaskGroup() as beside:
                tasks = [beside.create_task(each) for each in work]
                await self.link.run()
                for task in tasks:
                    task.cancel()
        except ExceptionGroup as errors:
            raise errors.exceptions[0] from None
        finally:
            if self.publisher is not None:
                self.publisher.close()
            if self._giver is not None:
                await self._giver.close()

    def stop(self) -> None:
        """Make `run` leave the room and return; any thread may call it."""
        self._call_soon(self.link.leave)

    def check(self) -> None:
        """Raise what ended the thread, if anything did, as `run` does."""
        if self._error is not None:
            raise self._error

    def moderate(self, message: Moderation) -> None:
        """Ask the relay to remove, mute or bar somebody, if our token lets us; from any thread."""
        self._call_soon(lambda: self.link.moderate(message))

    def say_recording(self, is_recording: bool) -> None:
        """Tell the others whether what is seen here is kept; any thread may call it."""
        self.is_recording = is_recording
        value = RECORDS_YES if is_recording else ""
        self._call_soon(lambda: self.link.describe(RECORDS_KEY, value))

    def wake(self) -> None:
        """Note that the call wants another share of a stream; any thread may call it."""
        self._call_soon(self._subscribed.set)

    @property
    def seal_status(self) -> SealStatus | None:
        """How the encryption stands; None where nothing is encrypted."""
        return None if self.link.guard is None else self.link.guard.status

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
        stats["resumes"] = counters.resumes
        stats["received_wire_bytes"] = counters.received_wire_bytes
        stats["voices"] = self.voices.stats()
        stats["voice"] = None if self.voice is None else self.voice.stats()
        stats["sent"] = None if self.publisher is None else self.publisher.stats()
        stats["avatar_given"] = "" if self._giver is None else self._giver.outcome
        stats["seal"] = None if self.link.guard is None else self.link.guard.stats()
        return stats

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

    def _on_event(self, event: ClientEvent, now: float) -> None:
        if self.voices.receive_event(event, now):
            return
        self.call.receive_event(event, now)
        for own in (self.publisher, self.voice):
            if own is not None:
                own.receive_event(event)
        if isinstance(event, PeerJoined | Joined):
            self._decline([event.peer] if isinstance(event, PeerJoined) else event.peers)
            self._subscribed.set()
        if isinstance(event, Joined) and self._giver is not None:
            self._giver.begin(self.link.url)
        if self._news is not None:
            self._news.receive_event(event, now)
        self.arrived.set()

    def _decline(self, peers: Sequence[Peer]) -> None:
        """Tell the relay to send nothing of newcomers that is not used here: tracks of unknown
        kinds, further ones of a known kind, voices that are not heard."""
        for peer in peers:
            faces = [track.stream for track in peer.tracks if track.kind == FACE_TRACK]
            used = faces[:1] if self._takes_faces else []
            for stream in (track.stream for track in peer.tracks):
                if stream not in used and not self.voices.is_wanted(stream):
                    self.link.subscribe(stream, 0)

    def _call_soon(self, action: Callable[[], None]) -> None:
        """Call something on the loop; at once as long as there is none."""
        if self._loop is None:
            action()
            return
        with contextlib.suppress(RuntimeError):  # the loop may be closed by now
            self._loop.call_soon_threadsafe(action)

    async def _tell_subscriptions(self) -> None:
        """Tell the relay how much of each stream is wanted, when that changes and when it is
        due."""
        now = asyncio.get_running_loop().time()
        while True:
            self._subscribed.clear()
            timer = None  # who is not in the room waits for the next join
            if self.link.is_joined and self._takes_faces:
                timer = self.call.tell_subscriptions(self.link.subscribe, now)
            now = await wait_until(self._subscribed, timer)

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(REPORT_INTERVAL_S)
            self.link.report(self.call.take_report())
