"""The way to the relay: one websocket after the other, each with a session on top.

The shell around `pica_protocol.session.ClientSession`. It connects, joins, hands events to its
owner, sends what waits, and comes back by itself when the relay goes away. It keeps nothing for
later: a frame offered without a connection is refused, because a late face is worse than none.

A link that lost the connection comes back to the place it had, if the relay still keeps it; else it
joins again, with another id. Either way its owner gets a ``Joined`` and begins its streams again.
A connection on which nothing comes is pinged, and left if that is not answered. A relay may send us
to another one.

A refusal that waiting cannot mend is final. The rest may pass (`pica_protocol.errors.may_pass`): an
older connection of ours still holds the place, a key file or a clock is being corrected. At the
first join these end the link at once all the same; later it tries again for `RETURN_S`.

Time is that of the event loop, which for asyncio's own loops is `time.monotonic`. On one machine
all processes share that clock (Linux CLOCK_MONOTONIC, macOS and Windows likewise), so benches there
may subtract a sender's capture times from a receiver's clock. Across machines they may not.
"""

import asyncio
import logging
import math
import random
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, cast

from websockets.exceptions import ConnectionClosed

from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_client.stats import wire_bytes
from pica_client.transport.connect import (
    CONNECT_ERRORS,
    LinkConfig,
    RelayConnect,
    RelayWebsocket,
    breaks_protocol,
    read_token,
    redirect_of,
    refusal,
    refusal_of,
    shown_name,
    trouble,
    watch,
)
from pica_protocol import SUBPROTOCOL
from pica_protocol.client_session import ClientSession
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.limits import check_metadata
from pica_protocol.messages import (
    FromMember,
    Joined,
    Metadata,
    Track,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import ClientEvent, Closed, State


def time_after(timer: float | None) -> float:
    """The loop's time after a timer fired: never before the timer's own."""
    now = asyncio.get_running_loop().time()
    return now if timer is None else max(now, timer)


async def wait_until(event: asyncio.Event, timer: float | None) -> float:
    """Wait until an event is set or its time has come, None is never; return the loop's time: at
    least `timer` if that ended the wait."""
    try:
        async with asyncio.timeout_at(timer):
            await event.wait()
    except TimeoutError:
        return time_after(timer)
    return asyncio.get_running_loop().time()


async def sleep_until(timer: float) -> float:
    """Wait until a time has come; return the loop's time, at least that. Costs less than a wait for
    an event that does not come."""
    await asyncio.sleep(max(timer - asyncio.get_running_loop().time(), 0.0))
    return time_after(timer)


if TYPE_CHECKING:  # a link without a secret needs no cryptography
    from pica_client.e2ee.guard import Guard

_log = logging.getLogger(__name__)

EventHandler = Callable[[ClientEvent, float], None]

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
        errors: Connections that ended because one end broke the protocol.
        sent_wire_bytes: With all that lies around a message, see `stats.wire_bytes`.
    """

    def __init__(
        self,
        config: LinkConfig,
        tracks: tuple[Track, ...] = (),
        *,
        on_event: EventHandler | None = None,
        guard: "Guard | None" = None,
    ) -> None:
        """Prepare; `run` does the work.

        Args:
            on_event: Called on the event loop for every event of every session, if given.
            guard: Seals what we send and opens what comes; by default one for the secret of the
                configuration, and without a secret everything is plain.

        Raises:
            SealError: There is no secret in the file.
        """
        if guard is None and config.secret_file is not None:
            # Only here: a link without a secret needs no cryptography.
            from pica_client.e2ee.guard import Guard
            from pica_client.e2ee.secret import load_secret

            guard = Guard(load_secret(config.secret_file))
        self.config = config
        self.url = config.url
        self.connects = self.resumes = self.errors = 0
        self.sent_wire_bytes = self.received_wire_bytes = self.received_messages = 0
        self.guard = guard
        self.tracks = tracks
        self._on_event = on_event
        self._wait_s = FIRST_WAIT_S
        self._refused_since_s: float | None = None
        self._trouble: Exception | None = None
        self._staying: asyncio.Task[None] | None = None
        self._first_join: asyncio.Timeout | None = None
        self._session: ClientSession | None = None
        self._wake = asyncio.Event()
        self._is_leaving = False
        self._drops: Counter[str] = Counter()
        self.metadata: Metadata = ()
        self._told: Metadata = ()
        self._told_s = -math.inf
        self._former: ClientSession | None = None
        self._former_url = ""

    @property
    def is_joined(self) -> bool:
        """Whether frames can be sent right now."""
        return self._session is not None and self._session.state is State.JOINED

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
        self,
        payload: bytes,
        captured_us: int,
        *,
        track: Track | None = None,
        multiple: int = 1,
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

    @property
    def is_admin(self) -> bool:
        """Whether our token lets us moderate the room that we are in."""
        session = self._session  # another thread may ask
        return session is not None and session.is_admin

    def leave(self) -> None:
        """Make `run` leave the room and return."""
        self._is_leaving = True
        self._wake.set()
        if self._staying is not None and self._session is None:
            self._staying.cancel()  # it connects, or waits

    async def run(self) -> None:
        """Connect and stay connected until `leave`.

        Raises:
            RelayUnreachableError: No answer within the first connect timeout.
            RelayRefusedError: The relay, or what answers there, will not have us.
            OptionError: The token file cannot be read.
        """
        self._staying = asyncio.ensure_future(self._stay())
        try:
            await self._staying
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if not self._is_leaving or (task is not None and task.cancelling()):
                raise

    async def _stay(self) -> None:
        """Stay connected; `run` says what may be raised."""
        self._read_token()  # a file that cannot be read is told at once
        limit_s = self.config.connect_timeout_s
        try:
            async with asyncio.timeout(limit_s) as self._first_join:
                while not self._is_leaving:
                    self.url = await self._visit(self.url)
        except TimeoutError as error:
            raise RelayUnreachableError(
                f"no relay answers at {self.config.url} (tried for {limit_s:g} s: "
                f"{self._trouble or 'no answer'}); "
                "start one with `pica relay`, or wait for it with --wait"
            ) from (self._trouble or error)

    async def _visit(self, url: str) -> str:
        """Connect to a relay once, and stay as long as that lasts; then wait until the next try.

        Returns:
            The relay to try next: this one, that to which it sends us, or the configured one.
        """
        loop = asyncio.get_running_loop()
        joined_s, target, longest_s = None, "", LONGEST_REFUSED_S
        try:
            websocket = await RelayConnect(url)
        except CONNECT_ERRORS as error:
            if url != self.config.url:
                return self.config.url
            if reason := refusal(error):
                raise RelayRefusedError(f"{url}: {reason}") from error
            _log.debug("relay not reached", extra={"error": type(error).__name__})
            self._trouble, longest_s = RelayUnreachableError(trouble(error, url)), LONGEST_AWAY_S
            self._trouble.__cause__ = error
        else:
            try:
                joined_s, closed = await self._talk(cast(RelayWebsocket, websocket))
                target = redirect_of(closed, url, self.config)
            except (RelayRefusedError, OptionError) as error:
                self._trouble = error
                self._note_refusal(error, loop.time())
        if joined_s is not None and loop.time() - joined_s >= SETTLED_S:
            self._wait_s = FIRST_WAIT_S
        if not self._is_leaving and not (target and self._wait_s == FIRST_WAIT_S):
            # Chance spreads the return of a full room over time.
            await asyncio.sleep(min(self._wait_s, longest_s) * (0.5 + 0.5 * random.random()))
        self._wait_s = min(2 * self._wait_s, longest_s)
        return target or (self.config.url if joined_s is None else url)

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

    def _read_token(self) -> str:
        return self.config.token or read_token(self.config.token_file)

    async def _talk(self, websocket: RelayWebsocket) -> tuple[float | None, Closed | None]:
        """One connection from its first byte to its last.

        Returns:
            When it joined the room, None if it never did; and how it ended.

        Raises:
            RelayRefusedError: The relay will not have us.
            OptionError: The token file cannot be read.
        """
        loop = asyncio.get_running_loop()
        url = self.url
        if websocket.subprotocol != SUBPROTOCOL:
            raise RelayRefusedError(f"{url}: a websocket server that does not speak {SUBPROTOCOL}")
        token = self._read_token()
        if self.guard is not None:
            self.guard.begin(self.config.room, shown_name(self.config.name, token))
        session = ClientSession(
            room=self.config.room,
            name=self.config.name,
            tracks=self.tracks,
            now=loop.time(),
            seal=None if self.guard is None else self.guard.seal,
            token=token,
            metadata=self.metadata,
            resumable=True,
            # Its secret is one between us and the relay that gave it.
            former=self._former if self._former_url == self.url else None,
            drops=self._drops,
        )
        self._session = session
        self._told, self._told_s = self.metadata, loop.time()
        joined_s: float | None = None

        def handle(events: Sequence[ClientEvent], now: float) -> None:
            nonlocal joined_s
            for event in events:
                if isinstance(event, Joined):
                    joined_s = now
                    if self._first_join is not None:
                        self._first_join.reschedule(None)
                    self._refused_since_s = None
                    self.connects += 1
                    self.resumes += event.resumed
                passed = [event]
                if self.guard is not None:
                    passed = self.guard.receive_event(event, now)
                if self._on_event is not None:
                    for each in passed:
                        self._on_event(each, now)

        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._write(session, websocket))
                watching = tasks.create_task(watch(websocket))
                await self._read(session, websocket, handle)
                watching.cancel()
                self._wake.set()  # let the writer see that it is over
        finally:
            self._session = None
            # One that was refused meanwhile does not cost the place: it is kept for a while.
            if session.is_resumable:
                self._former, self._former_url = session, url
            # In case we are cancelled: no socket outlives its link.
            websocket.transport.abort()
        closed = session.closed
        if closed is not None and not self._is_leaving:
            _log.info("connection to the relay ended", extra={"code": closed.code})
            self.errors += breaks_protocol(closed)
            if (refused := refusal_of(url, closed)) is not None:
                raise refused
        return joined_s, closed

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
                if timer is None:  # in the room; a limit for each message costs as much as the rest
                    data = await websocket.recv()
                else:
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
                self.received_messages += 1
                self.received_wire_bytes += wire_bytes(len(data), is_masked=False)
                events = session.receive_data(data, loop.time())
                handle(events, loop.time())
                if events and isinstance(events[0], Frame):
                    continue  # faces and voices ask for no answer
            self._wake.set()

    async def _write(self, session: ClientSession, websocket: RelayWebsocket) -> None:
        """Drain the session into the socket until one of them is over, then close the socket."""
        now = asyncio.get_running_loop().time()
        try:
            while True:
                self._wake.clear()
                if self._is_leaving:
                    session.close()
                self._whisper_keys(session, now)
                self._describe(session, now)
                for message in session.messages_to_send(now):
                    self.sent_wire_bytes += wire_bytes(len(message), is_masked=True)
                    await websocket.send(message)
                if session.closed is not None:
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
                session.tell(Whisper(peer_id=peer_id, data=data))  # it may be lost

    def _describe(self, session: ClientSession, now: float) -> None:
        """Queue what the others do not know of us yet, once it may be told."""
        due_s = self._tell_timer()
        is_due = due_s is not None and due_s <= now
        if is_due and session.tell(UpdateMetadata(metadata=self.metadata)):
            self._told, self._told_s = self.metadata, now

    def _tell_timer(self) -> float | None:
        """Return when the relay may be told our metadata; None: it knows it."""
        return None if self.metadata == self._told else self._told_s + TELL_INTERVAL_S

    async def _until_woken(self) -> float:
        """Wait until there may be something to write, by a timer too; return the time."""
        timers = [None if self.guard is None else self.guard.next_timer()]
        if self._session is not None and self.is_joined:
            timers += [self._tell_timer(), self._session.frames_due_s]
        timer = min((each for each in timers if each is not None), default=None)
        return await wait_until(self._wake, timer)
