"""One relay's place in a cluster, over NATS: the shell around `pica_server.cluster.node`.

Any relay of a cluster takes any participant. A room is on each relay that has peers in it; what
ties them together is one NATS with JetStream:

    pica_nodes        key-value store   slot -> node; renewed each 0.75 s: the node's lease
    pica_rooms        key-value store   hash of a room -> record of who is in it, where
    pica.beat.SLOT    each renewal, as the store repeats it to all nodes
    pica.record.ROOM  each change of a record, as the store repeats it to the nodes in the room
    pica.node.SLOT    what a node is told by others: subscriptions, keyframe requests, whispers
    pica.media.SLOT.ROOM  frames for a node: once for each room and turn, only what it wants

How the nodes agree on a room stands in ``cluster_room``, who lives in ``cluster_liveness``, how
frames travel in ``cluster_media``. Nothing is decided here.

No queue here grows without end. Requests: one for each room. Messages to nodes: a few for each
room; they are dropped while NATS is away, and all is said anew when it is back. Media: what NATS
does not take stays in the outboxes of the links and is thinned there. What NATS brings faster than
it is read is dropped by the client library at the limits below, noticed, and asked for again.
"""

import asyncio
import logging
import random
import secrets
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final
from urllib.parse import urlsplit

import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.aio.subscription import Subscription

from pica_server.cluster.liveness import BEAT_S
from pica_server.cluster.messages import NUM_SLOTS, NodeId
from pica_server.cluster.node import ClusterNode, Command, Tell, Unwatch, Watch
from pica_server.cluster.room import Read, Request, Write
from pica_server.cluster.store import ClusterStore, open_store
from pica_server.errors import ClusterAwayError, ClusterError
from pica_server.ops.log import say
from pica_server.room.hub import Hub

CONNECT_S: Final = 3.0
"""Seconds that the first connection may take."""
REQUEST_S: Final = 1.0
"""Seconds that an answer of the store may take."""
BEATS_PER_CHECK: Final = 4
"""Renewals between two looks at whether the store is still the same (chosen: every 3 s)."""
STOP_S: Final = 1.0
"""Seconds for taking this node's peers out of the records when it stops."""
RECONNECT_S: Final = 0.2
"""Between two attempts to reach NATS again."""
LONGEST_WAIT_S: Final = 5.0
"""Between two attempts before it was there at all (chosen)."""
_NUM_WORKERS: Final = 16
_MAX_UNSENT_BYTES: Final = 131_072
"""Bytes of messages that NATS has not taken; above it media waits in the outboxes."""
_MAX_TOLD: Final = 4096
"""Messages to nodes that may wait."""
_RECORD_LIMITS: Final = (64, 4_194_304)
_NODE_LIMITS: Final = (4096, 4_194_304)
_MEDIA_LIMITS: Final = (4096, 8_388_608)
"""Messages and bytes that may wait to be read, of each subscription."""

_logger = logging.getLogger(__name__)


class Cluster:
    """The connection of one hub to the other nodes."""

    node: ClusterNode
    _client: Client
    _store: ClusterStore

    def __init__(self, url: str, hub: Hub, capacity: int, on_news: Callable[[], None]) -> None:
        """Prepare.

        Args:
            url: Of NATS; several of one NATS cluster with commas between.
            on_news: Called on the loop when the hub may have got something to send.
        """
        self._urls = url.split(",")
        self._hub = hub
        self._capacity = capacity
        self._on_news = on_news
        self._last_error = "nobody answers"
        self._run = secrets.token_hex(4)
        self._tasks: list[asyncio.Task[None]] = []
        self._requests: asyncio.Queue[Request] = asyncio.Queue()  # at most one for each room
        self._told: deque[Command] = deque()
        self._has_told = asyncio.Event()
        self._has_media = asyncio.Event()
        self._must_renew = asyncio.Event()
        self._watched: dict[str, Subscription] = {}
        self._own: list[Subscription] = []

    async def start(self) -> None:
        """Take a place in the cluster, as soon as NATS answers.

        Raises:
            ClusterError: NATS has no JetStream, no place left, or does not let us in.
        """
        self._client, self._store = await self._connect_patiently()
        try:
            me, self._revision = await self._claim()
            self.node = ClusterNode(self._hub, me, self._capacity, self._now())
            await self._subscribe()
        except BaseException:
            await self._client.close()
            raise
        self._hub.meet(self.node, f"{self._run}-")
        self._must_renew.set()  # all who are there hear of this node
        loops = [self._renew(), self._tick(), self._tell(), self._send_media()]
        loops += [self._work() for _ in range(_NUM_WORKERS)]
        self._tasks = [asyncio.create_task(loop) for loop in loops]

    async def stop(self) -> None:
        """Give up the place; the hub has closed its connections before."""
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                while self.node.num_rooms and self._client.is_connected:
                    self.step()
                    await asyncio.sleep(0.01)
                await self._store.give_up(self.node.me.slot, self._revision)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()
        await self._client.close()

    def step(self) -> None:
        """Do what has come up since the last time; the relay calls this after anything."""
        self.node.step(self._now())
        for command in self.node.take_commands():
            if len(self._told) < _MAX_TOLD or not isinstance(command, Tell):
                self._told.append(command)
        if self._told:
            self._has_told.set()
        if self._hub.forwarding.ready_links:
            self._has_media.set()

    async def _connect_patiently(self) -> tuple[Client, ClusterStore]:
        """Connect when NATS is there: a machine that starts may start a relay first."""
        wait_s = RECONNECT_S
        while True:
            try:
                return await self._connect()
            except ClusterAwayError as error:
                if wait_s == RECONNECT_S:
                    spoken = f"{error}; waiting for it"
                    say(_logger, "waiting for the cluster", spoken, why=self._last_error)
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    async def _connect(self) -> tuple[Client, ClusterStore]:
        """Make a connection, and open the store over it."""
        client = Client()
        places = _places(self._urls)
        try:
            async with asyncio.timeout(CONNECT_S):
                await client.connect(
                    self._urls,
                    name="pica-relay",
                    error_cb=self._on_error,
                    disconnected_cb=self._on_disconnected,
                    reconnected_cb=self._on_reconnected,
                    connect_timeout=2,
                    reconnect_time_wait=RECONNECT_S,  # type: ignore[arg-type]
                    max_reconnect_attempts=-1,
                    ping_interval=2,
                    pending_size=2 * _MAX_UNSENT_BYTES,
                    flush_timeout=REQUEST_S,
                )
        except (TimeoutError, OSError, ValueError, nats.errors.Error) as error:
            await client.close()
            trouble = self._last_error if isinstance(error, TimeoutError) else _words(error)
            is_away = isinstance(error, TimeoutError | OSError | nats.errors.NoServersError)
            raise (ClusterAwayError if is_away else ClusterError)(
                f"--cluster {places}: {trouble}; start `nats-server -js` there, or leave --cluster "
                "out"
            ) from error
        try:
            return client, await open_store(client, REQUEST_S)
        except ClusterError:
            await client.close()
            raise
        except (nats.errors.Error, TimeoutError) as error:
            await client.close()
            raise ClusterError(
                f"--cluster {places}: no JetStream ({_words(error)}); start nats-server with -js, "
                "or give this user access to it"
            ) from error

    async def _claim(self) -> tuple[NodeId, int]:
        for slot in random.sample(range(NUM_SLOTS), NUM_SLOTS):
            me = NodeId(slot, secrets.token_hex(4))
            revision = await self._store.claim(slot, me.name)
            if revision is not None:
                return me, revision
        raise ClusterError(
            f"--cluster {_places(self._urls)}: all {NUM_SLOTS} places are taken; the place of a "
            "node that died is free after ten minutes"
        )

    async def _subscribe(self) -> None:
        slot = self.node.me.slot
        for subject, callback, limits in (
            ("pica.beat.*", self._on_beat, _NODE_LIMITS),
            (f"pica.node.{slot}", self._on_node_message, _NODE_LIMITS),
            (f"pica.media.{slot}.*", self._on_media, _MEDIA_LIMITS),
        ):
            self._own.append(await self._listen(subject, callback, limits))

    async def _listen(
        self, subject: str, callback: Callable[[Msg], Awaitable[None]], limits: tuple[int, int]
    ) -> Subscription:
        return await self._client.subscribe(
            subject, cb=callback, pending_msgs_limit=limits[0], pending_bytes_limit=limits[1]
        )

    # What NATS brings.

    async def _on_beat(self, message: Msg) -> None:
        self.node.receive_lease(message.subject.rpartition(".")[2], message.data, self._now())
        self._on_news()

    async def _on_node_message(self, message: Msg) -> None:
        self.node.receive_node_message(message.data, self._now())
        self._on_news()

    async def _on_media(self, message: Msg) -> None:
        key = message.subject.rpartition(".")[2]
        self.node.receive_media(key, message.data, self._now())
        self._on_news()

    async def _on_record(self, message: Msg) -> None:
        key = message.subject.rpartition(".")[2]
        sequence = (message.headers or {}).get("Nats-Sequence", "")
        if sequence.isdigit():
            self.node.receive_record(key, message.data, int(sequence), self._now())
            self._on_news()

    async def _on_error(self, error: Exception) -> None:
        self._last_error = _words(error)
        if isinstance(error, nats.errors.SlowConsumerError):
            self._hub.stats.cluster["overrun"] += 1
            if error.subject.startswith("pica.record."):
                self.node.receive_loss(error.subject.rpartition(".")[2])
            elif error.subject.startswith("pica.node."):
                self.node.receive_loss_of_all()
            self._on_news()

    async def _on_disconnected(self) -> None:
        if self._tasks:
            _logger.warning("cluster connection lost")

    async def _on_reconnected(self) -> None:
        _logger.warning("cluster connection restored")
        self.node.receive_reconnected(self._now())
        self._must_renew.set()
        self._on_news()

    # What goes to NATS.

    async def _renew(self) -> None:
        """Keep the lease; its owner cancels this."""
        num_beats = 0
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(BEAT_S):
                    await self._must_renew.wait()
            self._must_renew.clear()
            sent_s = self._now()
            num_beats += 1
            try:
                if self._client.is_closed:
                    await self._connect_anew()
                revision = await self._store.renew(
                    self.node.me.slot, self.node.me.name, self._revision
                )
                if revision is None:
                    await self._begin_anew()
                else:
                    self._revision = revision
                    if not self._store.is_lost:
                        self.node.receive_renewed(sent_s, self._now())
                if num_beats % BEATS_PER_CHECK == 0:
                    await self._store.check()
            except (nats.errors.Error, TimeoutError, OSError, ClusterError):
                self._hub.stats.cluster["renewals_failed"] += 1
            if self._store.is_lost:
                await self._open_anew()
            self._on_news()

    async def _open_anew(self) -> None:
        """Open the store again, or make it if NATS has come back without it; each node then says
        who is in its rooms. If this fails, the next renewal fails too."""
        try:
            self._store = await open_store(self._client, REQUEST_S)
        except (nats.errors.Error, TimeoutError, OSError, ClusterError):
            return
        _logger.warning("cluster store opened anew")
        self._hub.stats.cluster["reopened"] += 1
        self.node.receive_loss_of_all()
        self._must_renew.set()

    async def _begin_anew(self) -> None:
        """Take another slot: ours has been given away while we were cut off."""
        _logger.warning("cluster slot lost")
        me, self._revision = await self._claim()
        for subscription in self._own:
            await subscription.unsubscribe()
        self._own.clear()
        self.node.restart(me, self._now())
        await self._subscribe()

    async def _connect_anew(self) -> None:
        """Replace a client that gave up: the library does when NATS refuses it, for whatever
        reason and however short a time."""
        self._client, self._store = await self._connect()
        self._own.clear()
        await self._subscribe()
        for key in list(self._watched):
            self._watched[key] = await self._follow(key)
        self.node.receive_reconnected(self._now())

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(max(self.node.next_timer() - self._now(), 0.01))
            self.node.handle_timer(self._now())
            self._on_news()

    async def _tell(self) -> None:
        """Send what nodes are told, in order, and follow records."""
        while True:
            await self._has_told.wait()
            self._has_told.clear()
            while self._told:
                command = self._told.popleft()
                try:
                    await self._do(command)
                except (nats.errors.Error, TimeoutError, OSError):
                    self._hub.stats.cluster["untold"] += 1

    async def _do(self, command: Command) -> None:
        match command:
            case Tell(slot=slot, data=data):
                if self._client.is_connected:
                    await self._client.publish(f"pica.node.{slot}", data)
            case Watch(key=key):
                if key not in self._watched:
                    self._watched[key] = await self._follow(key)
            case Unwatch(key=key):
                subscription = self._watched.pop(key, None)
                if subscription is not None:
                    await subscription.unsubscribe()
            case Read() | Write():
                # In this order: what is read is followed already, so no change is missed.
                self._requests.put_nowait(command)

    async def _follow(self, key: str) -> Subscription:
        return await self._listen(f"pica.record.{key}", self._on_record, _RECORD_LIMITS)

    async def _work(self) -> None:
        """Make requests, one after the other."""
        while True:
            request = await self._requests.get()
            if isinstance(request, Read):
                answer = await self._store.read(request)
            else:
                answer = await self._store.write(request)
            self.node.receive_answer(request.key, request.ticket, answer, self._now())
            self._on_news()

    async def _send_media(self) -> None:
        while True:
            await self._has_media.wait()
            self._has_media.clear()
            if not self._client.is_connected:
                continue  # it stays, and is thinned
            try:
                for slot, key, data in self.node.exchanges.take_media(self._now()):
                    await self._client.publish(f"pica.media.{slot}.{key}", data)
                    if self._client.pending_data_size > _MAX_UNSENT_BYTES:
                        break
            except (nats.errors.Error, TimeoutError, OSError):
                self._hub.stats.cluster["unsent"] += 1
            if self._hub.forwarding.ready_links:  # NATS is slow: not a turn later, but soon
                await asyncio.sleep(0.005)
                self._has_media.set()

    def _now(self) -> float:
        return asyncio.get_running_loop().time()


def _places(urls: list[str]) -> str:
    """Name the servers without what may stand before the @."""
    parts = [urlsplit(url) for url in urls]
    return ",".join(f"{part.hostname}:{part.port or 4222}" for part in parts)


def _words(error: BaseException) -> str:
    """Say what is wrong without the address, which may hold a password."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return type(error).__name__
