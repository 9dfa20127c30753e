"""What the nodes of a cluster keep together, in two key-value stores of JetStream.

A key is written only over the revision that was read. The store repeats each accepted write on a
subject of its own (``republish``), so nobody has to poll, and nobody hears of a write that was
refused.
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.js import JetStreamContext
from nats.js.api import Header, RePublish
from nats.js.kv import KV_DEL, KV_OP, KeyValue

from pica_server.cluster import room
from pica_server.errors import ClusterError

NODES: Final = "pica_nodes"
ROOMS: Final = "pica_rooms"
SLOT_KEPT_S: Final = 600.0
"""A slot that nobody renews is free after that: its streams may be in somebody's hands until all
have noticed that its node is gone."""
_WRONG_REVISION: Final = (10071, 10164)


@dataclass(eq=False)
class ClusterStore:
    """Leases and records."""

    _stream: JetStreamContext
    _nodes: KeyValue
    _rooms: KeyValue
    _made: str
    is_lost: bool = False
    """Whether it seems to be gone, or to have been made anew, since it was opened."""

    async def claim(self, slot: int, name: str) -> int | None:
        """Take a slot; return the revision, or None if it is somebody's."""
        try:
            return await self._nodes.create(str(slot), name.encode())
        except nats.js.errors.KeyWrongLastSequenceError:
            return None

    async def renew(self, slot: int, name: str, revision: int) -> int | None:
        """Renew a lease; return the new revision, or None if the slot is somebody else's now.

        Raises:
            nats.errors.Error: Nobody knows what became of it.
        """
        for _ in range(3):
            try:
                return await self._nodes.update(str(slot), name.encode(), last=revision)
            except nats.js.errors.KeyWrongLastSequenceError:
                pass
            except nats.js.errors.NoStreamResponseError:
                self.is_lost = True
                raise
            try:
                entry = await self._nodes.get(str(slot))
            except nats.js.errors.KeyNotFoundError as error:
                revision = 0 if error.entry is None else error.entry.revision or 0
                self.is_lost = self.is_lost or error.entry is None
                continue
            if entry.value != name.encode():
                return None
            revision = entry.revision or 0  # an answer was lost
        return None

    async def check(self) -> None:
        """See whether the records are still those that were opened: news of a store that another
        node has made since looks old here, as it counts from one.

        Raises:
            nats.errors.Error: Nobody knows.
        """
        try:
            self.is_lost = self.is_lost or await _made_when(self._stream) != self._made
        except nats.js.errors.NotFoundError:
            self.is_lost = True

    async def give_up(self, slot: int, revision: int) -> None:
        """Free a slot in good order; that it fails does no harm."""
        try:
            await self._nodes.delete(str(slot), last=revision)
        except (nats.errors.Error, TimeoutError, OSError):
            return

    async def read(self, request: room.Read) -> room.Answer:
        """Fetch a record."""
        try:
            entry = await self._rooms.get(request.key)
        except nats.js.errors.KeyNotFoundError as error:
            return room.Found(b"", 0 if error.entry is None else error.entry.revision or 0)
        except (nats.errors.Error, TimeoutError, OSError):
            return room.Failed()
        return room.Found(entry.value or b"", entry.revision or 0)

    async def write(self, request: room.Write) -> room.Answer:
        """Put a record, or remove it."""
        try:
            if request.data:
                return room.Written(
                    await self._rooms.update(request.key, request.data, last=request.revision)
                )
            return room.Written(await self._remove(request))
        except nats.js.errors.KeyWrongLastSequenceError:
            return room.Conflict()
        except nats.js.errors.APIError as error:
            return room.Conflict() if error.err_code in _WRONG_REVISION else room.Failed()
        except nats.js.errors.NoStreamResponseError:
            self.is_lost = True
            return room.Failed()
        except (nats.errors.Error, TimeoutError, OSError):
            return room.Failed()

    async def _remove(self, request: room.Write) -> int:
        subject = f"$KV.{ROOMS}.{request.key}"
        headers = {
            KV_OP: KV_DEL,
            Header.EXPECTED_LAST_SUBJECT_SEQUENCE.value: str(request.revision),
        }
        removed = (await self._stream.publish(subject, headers=headers)).seq
        with suppress(nats.errors.Error, TimeoutError, OSError):  # else it goes with age
            # Up to the mark of the removal, and no newer record.
            await self._stream.purge_stream(f"KV_{ROOMS}", subject=subject, seq=removed + 1)
        return removed


async def open_store(client: Client, timeout_s: float) -> ClusterStore:
    """Open both stores; make them if they are not there.

    Raises:
        ClusterError: One is there and was not made for this.
        nats.errors.Error: There is no JetStream.
    """
    stream = client.jetstream(timeout=timeout_s)
    # Of a cluster of servers one may die. They know of each other, so one of them in the URL does.
    num_replicas = 3 if len(client.servers) >= 3 else 1
    nodes = await _open(stream, NODES, "pica.beat.>", SLOT_KEPT_S, num_replicas)
    rooms = await _open(stream, ROOMS, "pica.record.>", 4 * room.REWRITE_S, num_replicas)
    return ClusterStore(stream, nodes, rooms, await _made_when(stream))


async def _made_when(stream: JetStreamContext) -> str:
    return str((await stream.stream_info(f"KV_{ROOMS}")).created)


async def _open(
    stream: JetStreamContext, bucket: str, subject: str, kept_s: float, num_replicas: int
) -> KeyValue:
    source = f"$KV.{bucket}.>"
    try:
        kept = await stream.key_value(bucket)
    except nats.js.errors.NotFoundError:
        republish = RePublish(src=source, dest=subject)
        return await stream.create_key_value(
            bucket=bucket, republish=republish, ttl=kept_s, replicas=num_replicas
        )
    config = (await stream.stream_info(f"KV_{bucket}")).config
    if config.republish is None or (config.republish.src, config.republish.dest) != (
        source,
        subject,
    ):
        raise ClusterError(
            f"--cluster: the key-value store {bucket} does not repeat {source} on {subject}; "
            f"remove it with `nats kv del {bucket}`, and a relay makes it as it must be"
        )
    return kept
