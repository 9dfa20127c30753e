"""The way to the relay: one websocket after the other, each with a session on top.

The shell around `pica_protocol.session.ClientSession`. It connects, joins, hands events to its
owner, sends what waits, and comes back by itself when the relay goes away. It keeps nothing for
later: a frame offered without a connection is refused, because a late face is worse than none.

A link that lost the connection comes back to the place it had, if the relay still keeps it; else it
joins again, with another id. Either way its owner gets a ``Joined``. A connection on which nothing
comes is pinged, and left if that is not answered. A relay may send us to another one.

A refusal that waiting cannot mend is final. The rest may pass (`pica_protocol.errors.MAY_PASS`): an
older connection of ours still holds the place, a key file or a clock is being corrected. At the
first join these end the link at once all the same; later it tries again for `RETURN_S`.

Time is that of the event loop, which for asyncio's own loops is `time.monotonic`. On one machine
all processes share that clock (Linux CLOCK_MONOTONIC, macOS and Windows likewise), so benches there
may subtract a sender's capture times from a receiver's clock. Across machines they may not.
"""

import asyncio
import math
import random
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from websockets.exceptions import ConnectionClosed

from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_client.stats import wire_bytes
from pica_client.transport.connect import (
    CLOSE_TIMEOUT_S,
    PROTOCOL_BROKEN,
    LinkConfig,
    RelayWebsocket,
    open_websocket,
    redirect_of,
    refusal_of,
    shown_name,
)
from pica_protocol.client_session import ClientSession
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.limits import check_metadata
from pica_protocol.messages import (
    FromMember,
    Joined,
    Metadata,
    StreamMuted,
    Track,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import ClientEvent, Closed, State

if TYPE_CHECKING:  # a link without a secret needs no cryptography
    from pica_client.e2ee.guard import Guard


async def wait_until(event: asyncio.Event, timer: float | None) -> float:
    """Wait until an event is set or its time has come, None is never; return the loop's time: at
    least `timer` if that ended the wait."""
    try:
        async with asyncio.timeout_at(timer):
            await event.wait()
    except TimeoutError:
        return max(asyncio.get_running_loop().time(), timer or 0.0)
    return asyncio.get_running_loop().time()


async def sleep_until(timer: float) -> float:
    """Wait until a time has come; return the loop's time, at least that. Costs less than a wait for
    an event that does not come."""
    loop = asyncio.get_running_loop()
    await asyncio.sleep(max(timer - loop.time(), 0.0))
    return max(loop.time(), timer)


EventHandler = Callable[[ClientEvent, float], None]
Say = Callable[[str], None]
"""Takes a line for the user."""

SETTLED_S: Final = 5.0
"""After a stay that lasted this long waits begin with `FIRST_WAIT_S`, and a redirect is followed at
once; other waits double."""
FIRST_WAIT_S: Final = 0.25
"""Before the first new attempt (chosen: a relay that restarts is back within a second)."""
LONGEST_AWAY_S: Final = 1.0
"""Longest wait between two attempts at a relay that does not answer: it is found within this time
of its return."""
LONGEST_REFUSED_S: Final = 8.0
"""Longest wait after a relay answered and did not keep us: it may have too much to do."""
RETURN_S: Final = 60.0
"""So long a link that was in the room is refused before that is final (chosen: old connections end
after 20 s, and a clock or a key file is corrected within a minute or not by itself)."""
TELL_INTERVAL_S: Final = 1.0
"""Between two changes of our metadata: the relay takes no more for long."""


class Link:
    """A connection to the relay that comes back by itself.

    Attributes:
        tracks: What we publish.
        metadata: What we say of ourselves.
        guard: What seals and opens frames, or None.
        url: The relay that we are at, or try: the configured one, or one that it sent us to.
        connects: How often we came into the room.
        resumes: How many of these led back to the old place.
        left_s: When the connection ended on which we were in the room; None: we are, or never were.
        errors: Connections that ended because one end broke the protocol.
        sent_wire_bytes: With all that lies around a message, see `stats.wire_bytes`.
    """

    def __init__(
        self,
        config: LinkConfig,
        tracks: tuple[Track, ...] = (),
        *,
        on_event: EventHandler | None = None,
        say: Say | None = None,
    ) -> None:
        """Prepare; `run` does the work.

        Args:
            on_event: Called on the event loop for every event of every session, if given.
            say: Told when the room is joined, lost and found again, and what an admin does to us.

        Raises:
            SecretFileError: There is no secret in the file.
        """
        self.guard: Guard | None = None
        if config.secret_file is not None:
            # Only here: a link without a secret needs no cryptography.
            from pica_client.e2ee import guard, secret

            self.guard = guard.Guard(secret.load_secret(config.secret_file))
        self.config = config
        self.url = config.url
        self.connects = self.resumes = self.errors = 0
        self.sent_wire_bytes = self.received_wire_bytes = self.received_messages = 0
        self.tracks = tracks
        self.left_s: float | None = None
        self._on_event = on_event
        self._say = say or (lambda line: None)
        self._wait_s = FIRST_WAIT_S
        self._joined_s: float | None = None  # on this connection
        self._refused_since_s: float | None = None
        self._trouble: Exception | None = None
        self._running: asyncio.Task[None] | None = None
        self._first_join: asyncio.Timeout | None = None
        self._session: ClientSession | None = None
        self._former: ClientSession | None = None
        self._former_url = ""
        self._wake = asyncio.Event()
        self._is_leaving = False
        self._drops: Counter[str] = Counter()
        self.metadata: Metadata = ()
        self._told: Metadata = ()
        self._told_s = -math.inf

    @property
    def is_joined(self) -> bool:
        """Whether frames can be sent right now."""
        return self._session is not None and self._session.state is State.JOINED

    @property
    def is_admin(self) -> bool:
        """Whether our token lets us moderate the room that we are in."""
        session = self._session  # another thread may ask
        return session is not None and session.is_admin

    @property
    def muted(self) -> tuple[str, ...]:
        """The kinds of our tracks that an admin has stopped."""
        if (session := self._session) is None:  # another thread may ask
            return ()
        return tuple(track.kind for track in session.tracks if track.stream in session.muted)

    @property
    def reconnects(self) -> int:
        """How often the link came back."""
        return max(self.connects - 1, 0)

    @property
    def num_replaced(self) -> int:
        """How many of our frames a newer one overtook, or came too late, before the socket took
        them."""
        return self._drops.total() - self._drops["muted"]

    def send_frame(
        self, payload: bytes, captured_us: int, *, track: Track | None = None, multiple: int = 1
    ) -> bool:
        """Offer a frame of one of our tracks, by default of the first; see
        `ClientSession.send_frame`.

        Returns:
            False while not joined; the frame is gone then.
        """
        place = 0 if track is None else self.tracks.index(track)
        self._wake.set()
        return self._session is not None and self._session.send_frame(
            payload, captured_us, track=place, multiple=multiple
        )

    def tell(self, message: FromMember) -> bool:
        """Say something to the relay, or through it to another peer.

        Subscriptions end with the connection: ask again after each ``Joined``. A whisper may be
        lost on its way.

        Returns:
            False if it could not be said: not joined, or the network takes nothing.
        """
        self._wake.set()
        return self._session is not None and self._session.tell(message)

    def describe(self, key: str, value: str) -> None:
        """Set an entry of our metadata, which all others see, now and after each join; "" takes it
        away. Of quick changes they hear the last.

        Raises:
            ValueError: It is out of the limits of the protocol.
        """
        entries = {**dict(self.metadata), key: value}
        metadata = tuple((each, text) for each, text in sorted(entries.items()) if text)
        check_metadata("metadata", metadata)
        self.metadata = metadata
        self._wake.set()

    def leave(self) -> None:
        """Make `run` leave the room and return."""
        self._is_leaving = True
        if self._running is not None:
            self._running.cancel()

    async def run(self) -> None:
        """Connect and stay connected until `leave`.

        Raises:
            RelayUnreachableError: No answer within the first connect timeout.
            RelayRefusedError: The relay, or what answers there, will not have us.
            OptionError: The token file cannot be read.
        """
        if self._is_leaving:
            return
        self._running = asyncio.ensure_future(self._stay())
        try:
            await self._running
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if not self._is_leaving or (task is not None and task.cancelling()):
                raise

    async def _stay(self) -> None:
        """Stay connected; `run` says what may be raised."""
        self.config.read_token()  # a file that cannot be read is told at once
        limit_s = self.config.connect_timeout_s
        try:
            async with asyncio.timeout(limit_s) as self._first_join:
                while True:
                    self.url = await self._visit(self.url)
        except TimeoutError as error:
            if isinstance(self._trouble, RelayRefusedError):
                raise RelayUnreachableError(
                    f"the relay at {self.config.url} does not let us in (tried for {limit_s:g} s: "
                    f"{self._trouble}); wait for it with --wait"
                ) from self._trouble
            raise RelayUnreachableError(
                f"no relay answers at {self.config.url} (tried for {limit_s:g} s: "
                f"{self._trouble or 'no answer'}); "
                "start one with `pica relay`, or wait for it with --wait"
            ) from (self._trouble or error)

    async def _visit(self, url: str) -> str:
        """Connect to a relay once, and stay as long as that lasts; then wait until the next try.
        Return the relay to try: this one, that to which it sends us, or the configured one."""
        loop = asyncio.get_running_loop()
        target, longest_s, self._joined_s = "", LONGEST_REFUSED_S, None
        try:
            websocket = await open_websocket(url)
            target = redirect_of(await self._talk(url, websocket), url, self.config)
        except RelayUnreachableError as error:
            self._trouble, longest_s = error, LONGEST_AWAY_S
        except (RelayRefusedError, OptionError) as error:
            self._trouble = error
            self._note_refusal(error, loop.time())
        if self._joined_s is not None and loop.time() - self._joined_s >= SETTLED_S:
            self._wait_s = FIRST_WAIT_S
        if not (target and self._wait_s == FIRST_WAIT_S):
            # Chance spreads the return of a full room over time.
            await asyncio.sleep(min(self._wait_s, longest_s) * (0.5 + 0.5 * random.random()))
        self._wait_s = min(2 * self._wait_s, longest_s)
        return target or (self.config.url if self._joined_s is None else url)

    def _note_refusal(self, error: RelayRefusedError | OptionError, now: float) -> None:
        """Take a refusal, or the trouble with our own token file, and raise it if it is the end: at
        the first join, or if waiting cannot mend it."""
        is_final = isinstance(error, RelayRefusedError) and not error.may_pass
        if is_final or not self.connects:
            raise error
        if self._refused_since_s is None:
            self._refused_since_s = now
        if now - self._refused_since_s >= RETURN_S:
            raise type(error)(f"{error}; tried to come back for {RETURN_S:g} s") from error

    async def _talk(self, url: str, websocket: RelayWebsocket) -> Closed:
        """One connection from its first message to its last; return how it ended, or raise as
        `run`."""
        loop = asyncio.get_running_loop()
        try:
            token = self.config.read_token()
            if self.guard is not None:
                self.guard.begin(self.config.room, shown_name(self.config.name, token))
            session = self._session = ClientSession(
                room=self.config.room,
                name=self.config.name,
                tracks=self.tracks,
                now=loop.time(),
                seal=None if self.guard is None else self.guard.seal,
                token=token,
                metadata=self.metadata,
                resumable=True,
                # Its secret is one between us and the relay that gave it.
                former=self._former if self._former_url == url else None,
                drops=self._drops,
            )
            self._told, self._told_s = self.metadata, loop.time()
            try:
                async with asyncio.TaskGroup() as tasks:
                    watching = tasks.create_task(websocket.watch())
                    tasks.create_task(self._write(session, websocket))
                    await self._read(session, websocket)
                    watching.cancel()
            except asyncio.CancelledError:
                session.close()
                with suppress(TimeoutError):
                    async with asyncio.timeout(CLOSE_TIMEOUT_S):
                        await self._say_goodbye(session, websocket)
                raise
            if session.is_resumable:
                # One that was refused meanwhile does not cost the place: it is kept for a while.
                self._former, self._former_url = session, url
        finally:
            self._session = None
            websocket.transport.abort()  # no socket outlives its link
            if self._joined_s is not None:
                self.left_s = loop.time()
        closed = session.closed
        assert closed is not None  # else it is still read
        self.errors += closed.code in PROTOCOL_BROKEN
        if (refused := refusal_of(url, closed)) is not None:
            raise refused
        if self._joined_s is not None:
            why = f" ({closed.reason})" if closed.reason else ""
            self._say(f"connection to the relay lost{why}; coming back by itself")
        elif closed.reason and not closed.url:
            self._trouble = RelayRefusedError(closed.reason)
        return closed

    async def _read(self, session: ClientSession, websocket: RelayWebsocket) -> None:
        """Feed the session until it is over."""
        loop = asyncio.get_running_loop()
        try:
            while session.closed is None:
                data = await websocket.recv()
                self.received_messages += 1
                self.received_wire_bytes += wire_bytes(len(data), is_masked=False)
                events = session.receive_data(data, loop.time())
                self._handle(session, events, loop.time())
                if not (events and isinstance(events[0], Frame)):
                    self._wake.set()  # faces and voices ask for no answer
        except ConnectionClosed as error:
            code, reason = CloseCode.CONNECTION_LOST, ""
            if error.rcvd is not None:
                code, reason = error.rcvd.code, error.rcvd.reason  # type: ignore[assignment]
            self._handle(session, session.receive_close(code, reason, loop.time()), loop.time())
            self._wake.set()

    async def _write(self, session: ClientSession, websocket: RelayWebsocket) -> None:
        """Drain the session into the socket until one of them is over, then close the socket."""
        self._wake.set()  # the join goes out at once
        with suppress(ConnectionClosed):  # the reader hears of it too, and tells the session
            while session.closed is None:
                now = await wait_until(self._wake, self._next_timer(session))
                self._wake.clear()
                self._handle(session, session.handle_timer(now), now)
                if self.guard is not None and session.state is State.JOINED:
                    # Before the frames that need them; they may be lost, as any whisper.
                    for peer_id, data in self.guard.messages_to_send(now):
                        session.tell(Whisper(peer_id=peer_id, data=data))
                is_told = (due_s := self._tell_timer()) is None or due_s > now
                if not is_told and session.tell(UpdateMetadata(metadata=self.metadata)):
                    self._told, self._told_s = self.metadata, now
                await self._flush(session, websocket, now)
        await self._say_goodbye(session, websocket)

    async def _flush(self, session: ClientSession, websocket: RelayWebsocket, now: float) -> None:
        for message in session.messages_to_send(now):
            self.sent_wire_bytes += wire_bytes(len(message), is_masked=True)
            await websocket.send(message)

    async def _say_goodbye(self, session: ClientSession, websocket: RelayWebsocket) -> None:
        """Send the last words of a session that is over, and close the websocket."""
        with suppress(ConnectionClosed):
            await self._flush(session, websocket, 0.0)
        if session.closed is not None:
            await websocket.close(session.closed.code, session.closed.reason)

    def _tell_timer(self) -> float | None:
        """Return when the relay may be told our metadata; None: it knows it."""
        return None if self.metadata == self._told else self._told_s + TELL_INTERVAL_S

    def _next_timer(self, session: ClientSession) -> float | None:
        """Return when there may be something to write, or to give up."""
        timers = [session.next_timer()]
        if session.state is State.JOINED:
            timers += [self._tell_timer(), session.frames_due_s]
            timers += [] if self.guard is None else [self.guard.next_timer()]
        return min((each for each in timers if each is not None), default=None)

    def _handle(self, session: ClientSession, events: Sequence[ClientEvent], now: float) -> None:
        """Take note of events, and hand them on."""
        for event in events:
            match event:
                case Joined():
                    self._note_joined(event, now)
                case StreamMuted(stream=stream, is_muted=is_muted):
                    for kind in (each.kind for each in session.tracks if each.stream == stream):
                        does = "stops" if is_muted else "no longer stops"
                        self._say(f"an admin {does} your {kind}")
            passed = [event] if self.guard is None else self.guard.receive_event(event, now)
            if self._on_event is not None:
                for each in passed:
                    self._on_event(each, now)

    def _note_joined(self, event: Joined, now: float) -> None:
        if self._first_join is not None:
            self._first_join.reschedule(None)
        self._refused_since_s = None
        self.connects += 1
        self.resumes += event.resumed
        if self.left_s is None:
            config = self.config
            self._say(f"in room {config.room} at {config.url} as {event.name or config.name}")
        else:
            self._say(f"back in the room after {now - self.left_s:.1f} s")
        self._joined_s, self.left_s = now, None
