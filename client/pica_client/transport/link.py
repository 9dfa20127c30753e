"""The way to the relay: one websocket after the other, each with a session on top.

The shell around `pica_protocol.session.ClientSession`. It connects, joins, hands events to its
owner, sends what waits, and comes back by itself when the relay goes away. It keeps nothing for
later: a frame offered without a connection is refused, because a late face is worse than none.

Who lost the connection comes back to the place it had, if the relay still keeps it; else it joins
anew, with another id. Either way its owner gets a ``Joined`` and begins its streams anew. When the
relay falls silent, another websocket is opened beside the one that is there, and takes its place if
that is still silent by then (`lookout`). Several addresses are tried in order (`addresses`).

A refusal ends the link, unless it may pass and we were in the room (`refusals`).

Time is that of the event loop, which for asyncio's own loops is `time.monotonic`. On one machine
all processes share that clock (Linux CLOCK_MONOTONIC, macOS and Windows likewise), so benches there
may subtract a sender's capture times from a receiver's clock. Across machines nobody may.
"""

import asyncio
import logging
import random
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from websockets.exceptions import ConnectionClosed

from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_client.stats import wire_bytes
from pica_client.transport.backoff import SETTLED_S, Backoff
from pica_client.transport.config import LinkConfig, read_token
from pica_client.transport.connect import SOFTWARE, RelayWebsocket, open_websocket
from pica_client.transport.dialer import Connector, Dialer
from pica_client.transport.lookout import Lookout
from pica_client.transport.redirects import refused_redirect
from pica_client.transport.refusals import Refusals, breaks_protocol, refusal_of
from pica_client.transport.self_description import SelfDescription, shown_name
from pica_client.transport.silence import Silence
from pica_client.transport.timers import time_after, wait_until
from pica_protocol.client_session import ClientSession, Ticket
from pica_protocol.errors import CloseCode
from pica_protocol.messages import (
    FromMember,
    Joined,
    KeyframeRequest,
    Moderation,
    Report,
    Track,
    UpdateMetadata,
    Want,
    Whisper,
)
from pica_protocol.session import ClientEvent, Closed, State

if TYPE_CHECKING:  # who does not encrypt needs no cryptography
    from pica_client.e2ee.guard import Guard

_log = logging.getLogger(__name__)

EventHandler = Callable[[ClientEvent, float], None]


@dataclass(kw_only=True, slots=True)
class LinkCounters:
    """What went over the link since it was made."""

    connects: int = 0
    resumes: int = 0
    """How many of them led back to the old place in the room."""
    errors: int = 0
    """Connections that ended because somebody broke the protocol."""
    sent_messages: int = 0
    sent_wire_bytes: int = 0
    """Bytes with all that lies around a message, see `stats.wire_bytes`."""
    received_messages: int = 0
    received_wire_bytes: int = 0
    frames_replaced: int = 0
    """Frames that newer ones overtook, or that were thinned, before the socket took them."""


class Link:
    """A connection to the relay that comes back by itself.

    Attributes:
        guard: What seals and opens frames, or None.
        last_closed: How the latest connection ended, or None.
        lookout: Tries another way when the relay has fallen silent.
    """

    def __init__(
        self,
        config: LinkConfig,
        tracks: tuple[Track, ...] = (),
        *,
        on_event: EventHandler | None = None,
        connector: Connector | None = None,
        rng: random.Random | None = None,
        guard: "Guard | None" = None,
    ) -> None:
        """Prepare; `run` does the work.

        Args:
            on_event: Called on the event loop for every event of every session, if given.
            connector: Opens one websocket to an address; plain TCP or TLS by default.
            rng: Spreads reconnects; seeded by tests.
            guard: Seals what we send and opens what comes; by default one for the secret of the
                configuration, and without a secret everything is plain.

        Raises:
            SecretFileError: There is no secret in the file.
        """
        if guard is None and config.secret_file is not None:
            # Only here: who does not encrypt needs no cryptography.
            from pica_client.e2ee.guard import Guard
            from pica_client.e2ee.secret import load_secret

            guard = Guard(load_secret(config.secret_file))
        self.config = config
        self.counters = LinkCounters()
        self.last_closed: Closed | None = None
        self._tracks = tracks
        self._on_event = on_event
        self.guard = guard
        connector = connector or (lambda url: open_websocket(url, config.ca_file))
        self._dialer = Dialer(config.urls, connector)
        self._addresses = self._dialer.addresses
        chance = (rng or random.Random()).random
        self._backoff = Backoff(chance)
        self.lookout = Lookout(self._dialer, Silence(chance))
        self._refusals = Refusals()
        self._session: ClientSession | None = None
        self._wake = asyncio.Event()
        self._is_leaving = False
        self._description = SelfDescription()
        self._ticket: Ticket | None = None
        self._ticket_url = ""

    @property
    def url(self) -> str:
        """The relay that we are at, or try: one of the configured, or where that has sent us."""
        return self._addresses.current

    @property
    def is_joined(self) -> bool:
        """Whether frames can be sent right now."""
        return self._session is not None and self._session.state is State.JOINED

    @property
    def reconnects(self) -> int:
        """How often the link came back."""
        return max(self.counters.connects - 1, 0)

    def send_frame(
        self,
        payload: bytes,
        captured_us: int,
        *,
        track: Track | None = None,
        layer: int = 0,
        is_keyframe: bool = True,
    ) -> bool:
        """Offer a frame of one of our tracks, by default of the first.

        When the network is too slow for the stream, and with the first frame of a connection unless
        it is a keyframe, the frame is dropped and ``on_event`` gets a ``KeyframeRequest``.

        Returns:
            False while not joined; the frame is gone then.
        """
        if self._session is None or not self.is_joined:
            return False
        events = self._session.send_frame(
            payload,
            captured_us,
            track=0 if track is None else self._tracks.index(track),
            layer=layer,
            is_keyframe=is_keyframe,
        )
        if self._on_event is not None:
            for event in events:
                self._on_event(event, asyncio.get_running_loop().time())
        self._wake.set()
        return True

    def want(self, stream: int, layer: int | None) -> bool:
        """Ask the relay for the frames of a stream up to ``layer``, or for none.

        It ends with the connection: ask anew after each ``Joined``.

        Returns:
            False if it could not be told: not joined, or the network takes nothing.
        """
        return self._tell(Want(stream=stream, layer=layer))

    def request_keyframe(self, stream: int) -> bool:
        """Ask the publisher of a stream for a keyframe; returns as `want`."""
        return self._tell(KeyframeRequest(stream=stream))

    def whisper(self, peer_id: str, data: bytes) -> bool:
        """Send opaque bytes to one peer in the room; it gets a ``Whisper`` with our peer id.

        It may be lost on its way: when the peer has just gone, or when we whisper more than the
        relay allows. Returns as `want`.

        Raises:
            ValueError: More than ``MAX_WHISPER_BYTES``, or no peer id.
        """
        return self._tell(Whisper(peer_id=peer_id, data=data))

    def describe(self, key: str, value: str) -> None:
        """Say something of ourselves to the others under a key, now and after each join; "" says
        nothing under it any more. Of quick changes they hear the last.

        Raises:
            ValueError: It is out of its limits.
        """
        self._description.say(key, value)
        self._wake.set()

    def report(self, report: Report) -> None:
        """Tell the relay how streams arrived, if it is there."""
        self._tell(report)

    def moderate(self, message: Moderation) -> None:
        """Ask the relay to remove, mute or bar somebody; dropped while nothing can be sent."""
        self._tell(message)

    @property
    def is_admin(self) -> bool:
        """Whether our token lets us moderate the room that we are in."""
        session = self._session  # another thread may ask
        return session is not None and session.is_admin

    @property
    def muted_streams(self) -> frozenset[int]:
        """Streams of the room that an admin has stopped."""
        session = self._session
        return frozenset() if session is None else session.muted

    def _tell(self, message: FromMember) -> bool:
        """Have the session take one more message, if it can, and let the writer look."""
        session = self._session
        if session is None or not session.can_queue:
            return False
        self._wake.set()
        session.tell(message)
        return True

    def leave(self) -> None:
        """Make `run` go in good order and return."""
        self._is_leaving = True
        self._wake.set()

    async def run(self) -> None:
        """Connect and stay connected until `leave`.

        Raises:
            RelayUnreachableError: Nobody answered within the first connect timeout.
            RelayRefusedError: The relay, or what answers there, will not have us.
            OptionError: The token file, or that of certificates to trust, cannot be read.
        """
        try:
            await self._stay()
        finally:
            if (unused := self.lookout.take_successor()) is not None:
                unused.transport.abort()

    async def _stay(self) -> None:
        """Stay connected; `run` says what may be raised."""
        loop = asyncio.get_running_loop()
        limit_s = self.config.connect_timeout_s
        give_up_s = None if limit_s is None else loop.time() + limit_s
        troubles: dict[str, Exception] = {}  # by address, and the latest alone
        num_redirects = 0  # since the room was joined
        while not self._is_leaving:
            joined_s, is_last, websocket = None, False, self.lookout.take_successor()
            elsewhere = ""
            try:
                token = self.config.token or read_token(self.config.token_file)
                websocket = websocket or await self._connect_or_leave(give_up_s)
                if websocket is None:
                    return
                joined_s = await self._talk(websocket, token)
                elsewhere = self._elsewhere()
            except (RelayUnreachableError, RelayRefusedError, OptionError) as error:
                if websocket is not None:
                    websocket.transport.abort()
                # A file of our own is in the way of all addresses alike.
                is_last = not self._addresses.num_left or isinstance(error, OptionError)
                self._refusals.receive(error, loop.time(), is_last=is_last)
                troubles[self.url] = error
            if self._is_leaving:
                return
            if self.lookout.has_successor:
                continue
            if elsewhere or joined_s is not None:
                self._addresses.begin_with(elsewhere or self.url)
            elif not is_last and self._addresses.num_left:
                continue
            lasted_s = 0.0 if joined_s is None else loop.time() - joined_s
            num_redirects = num_redirects + 1 if elsewhere and joined_s is None else 0
            if num_redirects == 1:
                continue
            wait_s = self._backoff.next_wait_s(lasted_s)
            if elsewhere and lasted_s >= SETTLED_S:
                # The relay that sends us away spreads its clients over time. Two that send us to
                # and fro are another matter.
                wait_s = 0.0
            was_never_there = self.counters.connects == 0
            if was_never_there and give_up_s is not None and loop.time() + wait_s >= give_up_s:
                raise RelayUnreachableError(
                    f"no relay answers at {self.config.url} (tried for {limit_s:g} s: "
                    f"{'; '.join(map(str, troubles.values())) or 'it does not let us in'}); "
                    "start one with `pica relay`, or wait for it with --wait"
                ) from next(iter(troubles.values()), None)
            await self._sleep(wait_s)

    def _elsewhere(self) -> str:
        """The other relay that the latest connection ended with, if we may go there."""
        closed = self.last_closed
        if closed is None or closed.code != CloseCode.GOING_AWAY or not closed.url:
            return ""
        refused = refused_redirect(closed.url, self.url, self.config.urls)
        if refused:
            _log.warning("the relay sends us elsewhere; not going: %s", refused)
        return "" if refused else closed.url

    async def _connect_or_leave(self, give_up_s: float | None) -> RelayWebsocket | None:
        """Open a websocket to the next address, unless `leave` is called first."""
        deadline = give_up_s if self.counters.connects == 0 else None
        opening = asyncio.ensure_future(self._dialer.open_next(deadline))
        leaving = asyncio.ensure_future(self._until_leaving())
        try:
            await asyncio.wait({opening, leaving}, return_when=asyncio.FIRST_COMPLETED)
            return await opening if opening.done() else None
        finally:
            for task in (opening, leaving):
                task.cancel()
            await asyncio.gather(opening, leaving, return_exceptions=True)

    async def _until_leaving(self) -> None:
        while not self._is_leaving:
            self._wake.clear()
            await self._wake.wait()

    async def _sleep(self, wait_s: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(wait_s):
                await self._until_leaving()

    async def _talk(self, websocket: RelayWebsocket, token: str) -> float | None:
        """One connection from its first byte to its last.

        Returns:
            When it joined the room, or None if it never did.

        Raises:
            RelayRefusedError: The relay will not have us.
        """
        loop = asyncio.get_running_loop()
        url = self.url
        if self.guard is not None:
            self.guard.begin(self.config.room, shown_name(self.config.name, token))
        session = ClientSession(
            room=self.config.room,
            name=self.config.name,
            tracks=self._tracks,
            software=SOFTWARE,
            now=loop.time(),
            seal=None if self.guard is None else self.guard.seal,
            token=token,
            metadata=self._description.metadata,
            resumable=True,
            # It is a secret between us and the relay that gave it.
            ticket=self._ticket if self._ticket_url == self.url else None,
        )
        self._session = session
        self._description.note_told(loop.time())
        joined_s: float | None = None

        def handle(events: Sequence[ClientEvent], now: float) -> None:
            nonlocal joined_s
            for event in events:
                if isinstance(event, Joined):
                    joined_s = now
                    self._refusals.note_joined()
                    self.counters.connects += 1
                    self.counters.resumes += event.resumed
                passed = [event]
                if self.guard is not None:
                    passed = self.guard.receive_event(event, now)
                if self._on_event is not None:
                    for each in passed:
                        self._on_event(each, now)

        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._write(session, websocket))
                watching = tasks.create_task(self.lookout.watch(websocket))
                await self._read(session, websocket, handle)
                watching.cancel()
                self._wake.set()  # let the writer see that it is over
        finally:
            self._session = None
            # One that was refused meanwhile does not cost the place: it is kept for a while.
            if session.ticket is not None:
                self._ticket, self._ticket_url = session.ticket, url
            self.counters.frames_replaced += session.drops.total()
            # In case we are cancelled: no socket outlives its link.
            websocket.transport.abort()
        self.last_closed = closed = session.closed
        if closed is not None and not self._is_leaving:
            _log.info("connection to the relay ended", extra={"code": closed.code})
            self.counters.errors += breaks_protocol(closed)
            if (refused := refusal_of(url, closed)) is not None:
                raise refused
        return joined_s

    async def _read(
        self,
        session: ClientSession,
        websocket: RelayWebsocket,
        handle: Callable[[Sequence[ClientEvent], float], None],
    ) -> None:
        """Feed the session until it is over."""
        loop = asyncio.get_running_loop()
        while session.closed is None:
            timer = session.next_timer()
            try:
                async with asyncio.timeout_at(timer):
                    data = await websocket.recv()
            except TimeoutError:
                now = time_after(timer)
                handle(session.handle_timer(now), now)
            except ConnectionClosed as error:
                code, reason = CloseCode.CONNECTION_LOST, ""
                if error.rcvd is not None:
                    code, reason = error.rcvd.code, error.rcvd.reason  # type: ignore[assignment]
                handle(session.receive_close(code, reason, loop.time()), loop.time())
            else:
                self.counters.received_messages += 1
                self.counters.received_wire_bytes += wire_bytes(len(data), is_masked=False)
                handle(session.receive_data(data, loop.time()), loop.time())
            self._wake.set()

    async def _write(self, session: ClientSession, websocket: RelayWebsocket) -> None:
        """Drain the session into the socket until one of them is over, then close the socket."""
        now = asyncio.get_running_loop().time()
        try:
            while True:
                self._wake.clear()
                if self._is_leaving:
                    session.leave(now)
                self._whisper_keys(session, now)
                self._describe(session, now)
                for message in session.messages_to_send(now):
                    self.counters.sent_messages += 1
                    self.counters.sent_wire_bytes += wire_bytes(len(message), is_masked=True)
                    await websocket.send(message)
                if session.closed is not None or session.state is State.LEAVING:
                    break
                now = await self._until_woken()
        except ConnectionClosed:
            return  # the reader hears of it too, and tells the session
        closed = session.closed
        if closed is None or closed.code in (CloseCode.CONNECTION_LOST, 1005):
            await websocket.close(CloseCode.NORMAL)
        else:
            await websocket.close(closed.code, closed.reason)

    def _whisper_keys(self, session: ClientSession, now: float) -> None:
        """Queue what the guard has to tell others: it goes before the frames that need it."""
        if self.guard is not None and session.state is State.JOINED:
            for peer_id, data in self.guard.messages_to_send(now):
                if session.can_queue:  # else it is lost, as a whisper may be
                    session.tell(Whisper(peer_id=peer_id, data=data))

    def _describe(self, session: ClientSession, now: float) -> None:
        """Queue what the others do not know of us yet, once it may be said."""
        due_s = self._description.next_timer()
        if due_s is not None and due_s <= now and session.can_queue:
            session.tell(UpdateMetadata(metadata=self._description.metadata))
            self._description.note_told(now)

    async def _until_woken(self) -> float:
        """Wait until there may be something to write, by a timer too; return the time."""
        timers = [None if self.guard is None else self.guard.next_timer()]
        if self._session is not None and self.is_joined:
            timers += [self._description.next_timer(), self._session.frames_due_s]
        timer = min((each for each in timers if each is not None), default=None)
        return await wait_until(self._wake, timer)
