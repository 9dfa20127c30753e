"""The bucket of keys that places rooms on relays, in NATS with JetStream; `Placement` decides.

The bucket repeats (``republish``) each accepted write on a subject, so relays need not poll. A
connection that is lost is made again every `RECONNECT_S`; rooms go on meanwhile.

NATS 2.9.10 crashes when a key is read while the bucket is made, so no key is read before a beat has
been written.
"""

import asyncio
import logging
import secrets
from collections.abc import Callable
from contextlib import suppress
from typing import Final
from urllib.parse import urlsplit

import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.js.api import RePublish
from nats.js.kv import KeyValue

from pica_server.errors import ClusterError
from pica_server.log import say
from pica_server.room.hub import Hub
from pica_server.room.placement import (
    BEAT_S,
    REWRITE_S,
    Placed,
    Placement,
    Request,
    relay_key,
)

BUCKET: Final = "pica_placement"
NEWS: Final = "pica.placement."
CONNECT_S: Final = 3.0
"""Seconds that a connection may take."""
REQUEST_S: Final = 1.0
"""Seconds that an answer may take."""
RECONNECT_S: Final = 0.2
TICK_S: Final = 0.25
STOP_S: Final = 1.0
"""Seconds for removing the keys of this relay when it stops."""
_NUM_WORKERS: Final = 8
_AWAY: Final = (nats.errors.Error, TimeoutError, OSError)

_logger = logging.getLogger(__name__)


class Bucket:
    """The connection of one relay to the bucket.

    Attributes:
        placement: Decides which relay has which room.
    """

    def __init__(
        self,
        urls: str,
        hub: Hub,
        on_events: Callable[[list[Placed]], None],
        unix_time: Callable[[], float],
    ) -> None:
        """Prepare.

        Args:
            urls: Of NATS; several servers of one NATS cluster with commas between.
            hub: The hub whose rooms are placed.
            on_events: Called on the loop with decisions of the placement.
            unix_time: The clock of claims, seconds since 1970.
        """
        me, rooms = secrets.token_hex(8), hub.membership.rooms
        self._requests: asyncio.Queue[Request] = asyncio.Queue()  # at most one for each room
        request = self._requests.put_nowait
        self.placement = Placement(me, rooms, hub.stats, unix_time=unix_time, request=request)
        self._key = relay_key(me)
        self._urls = urls.split(",")
        self._hub = hub
        self._on_events = on_events
        self._url = ""
        self._client: Client | None = None
        self._bucket: KeyValue | None = None
        self._revision = 0
        self._is_away = False  # what is said of it; the first line of a relay is another one
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self, url: str) -> None:
        """Connect to NATS; if it does not answer, go on trying.

        Args:
            url: Where clients reach this relay.

        Raises:
            ClusterError: NATS has no JetStream, or refuses this relay.
        """
        self._url = url
        try:
            await self._connect()
            await self._renew()
        except _AWAY as error:
            if not isinstance(error, TimeoutError | OSError | nats.errors.NoServersError):
                parts = map(urlsplit, self._urls)  # without the password
                places = ",".join(f"{each.hostname}:{each.port or 4222}" for each in parts)
                raise ClusterError(
                    f"--cluster {places}: {type(error).__name__}; start nats-server with -js, and "
                    "give this user access to it"
                ) from error
        loops = [self._keep(), self._tick(), *(self._work() for _ in range(_NUM_WORKERS))]
        self._tasks = [asyncio.create_task(loop) for loop in loops]

    async def stop(self) -> None:
        """Remove the keys of this relay; the hub has closed its rooms before."""
        with suppress(TimeoutError, *_AWAY):
            async with asyncio.timeout(STOP_S):
                await self._requests.join()
                if self._bucket is not None and self.placement.is_up:
                    await self._bucket.delete(self._key)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()  # what ends from now on is no news
        if self._client is not None:
            await self._client.close()

    async def _connect(self) -> None:
        """Connect, subscribe to changes, and make the bucket if it does not exist."""
        client = Client()
        try:
            async with asyncio.timeout(CONNECT_S):
                await client.connect(
                    self._urls,
                    name="pica-relay",
                    allow_reconnect=False,
                    max_reconnect_attempts=1,  # of one call to connect
                    reconnect_time_wait=RECONNECT_S,  # type: ignore[arg-type]
                    connect_timeout=2,
                    error_cb=self._on_error,
                    disconnected_cb=self._on_disconnected,
                    ping_interval=2,
                )
                await client.subscribe(f"{NEWS}>", cb=self._on_news)
            self._client = client
            self._bucket = await self._open(client)
        except BaseException:
            await client.close()
            raise

    async def _open(self, client: Client) -> KeyValue:
        stream = client.jetstream(timeout=REQUEST_S)
        try:
            return await stream.key_value(BUCKET)
        except nats.js.errors.NotFoundError:
            return await stream.create_key_value(
                bucket=BUCKET,
                ttl=3 * REWRITE_S,
                replicas=3 if len(client.servers) >= 3 else 1,
                republish=RePublish(src=f"$KV.{BUCKET}.>", dest=f"{NEWS}>"),
            )

    async def _renew(self) -> None:
        """Write a beat over the last one; if that is missing, read all keys again."""
        assert self._bucket is not None
        hub, placement, now = self._hub, self.placement, self._now()
        data = placement.beat(self._url, hub.num_connections, is_open=hub.takes_rooms(now), now=now)
        try:
            self._revision = await self._bucket.update(self._key, data, last=self._revision)
        except nats.js.errors.KeyWrongLastSequenceError:
            self._revision = await self._bucket.put(self._key, data)
            placement.doubt_all(self._now())
        placement.receive_renewed(self._now())
        if self._is_away:
            self._is_away = False
            say(_logger, "NATS answers", "NATS answers: rooms are placed on all relays")
        self._take_events()

    async def _keep(self) -> None:
        """Keep the connection and renew the beat until cancelled."""
        while True:
            await asyncio.sleep(BEAT_S if self.placement.is_up else RECONNECT_S)
            try:
                if self._client is None or self._client.is_closed:
                    await self._connect()
                elif not self.placement.is_up:
                    self._bucket = await self._open(self._client)
                await self._renew()
            except _AWAY:
                self._note_away()

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            self.placement.tick(self._now())
            self._take_events()

    async def _work(self) -> None:
        """Answer requests of the placement until cancelled."""
        while True:
            key, data, revision = await self._requests.get()
            try:
                found = await self._make(key, data, revision)
            except _AWAY:
                found = None
            self._requests.task_done()
            self.placement.receive_answer(key, found, self._now())
            self._take_events()

    async def _make(self, key: str, data: bytes | None, revision: int) -> tuple[bytes, int] | None:
        """Read or write a key; return its data and revision then, or None if it is not known."""
        bucket = self._bucket
        if bucket is None or self._client is None or self._client.is_closed:
            return None
        if data is None:
            try:
                entry = await bucket.get(key)
            except nats.js.errors.KeyNotFoundError as error:
                return b"", (error.entry and error.entry.revision) or 0
            return entry.value or b"", entry.revision or 0
        if data:
            return data, await bucket.update(key, data, last=revision)
        await bucket.delete(key, last=revision)
        return None

    async def _on_news(self, message: Msg) -> None:
        key = message.subject.removeprefix(NEWS)
        self.placement.receive_news(key, message.data, self._now())
        self._take_events()

    async def _on_error(self, error: Exception) -> None:
        if isinstance(error, nats.errors.SlowConsumerError):  # news were lost
            self.placement.doubt_all(self._now())

    async def _on_disconnected(self) -> None:
        if self._tasks:
            self._note_away()

    def _note_away(self) -> None:
        if not self._is_away:
            self._is_away = True
            spoken = "NATS does not answer: rooms go on, new ones are made where they are asked for"
            say(_logger, "NATS lost", spoken)
        self.placement.receive_away(self._now())
        self._take_events()

    def _take_events(self) -> None:
        if events := self.placement.take_events():
            self._on_events(events)

    def _now(self) -> float:
        return asyncio.get_running_loop().time()
