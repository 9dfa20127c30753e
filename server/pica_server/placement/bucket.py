"""A bucket of keys in NATS with JetStream, which all relays of a cluster share.

The bucket repeats (``republish``) each accepted write on a subject, so relays need not poll. NATS
2.9.10 crashes when a key is read while the bucket is made, so no key is read before a beat has been
written.
"""

import asyncio
from collections.abc import Callable
from typing import Final
from urllib.parse import urlsplit

import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.js.api import RePublish
from nats.js.kv import KeyValue

from pica_server.config import ConfigurationError

BUCKET: Final = "pica_placement"
NEWS: Final = "pica.placement."
TTL_S: Final = 600.0
"""Keys that were not written for so long are dropped."""
CONNECT_S: Final = 3.0
"""Seconds that a connection may take."""
REQUEST_S: Final = 1.0
"""Seconds that an answer may take."""
RECONNECT_S: Final = 0.2
AWAY: Final = (nats.errors.Error, TimeoutError, OSError)
"""What is raised while NATS does not answer."""


class Bucket:
    """One connection to the bucket; a lost one is made again by ``connect``.

    Attributes:
        on_news: Told the key and data of every write, empty if the key was removed.
        on_doubt: Told when news were lost.
        on_lost: Told when the connection has ended.
    """

    on_news: Callable[[str, bytes], None]
    on_doubt: Callable[[], None]
    on_lost: Callable[[], None]

    def __init__(self, urls: str) -> None:
        """Prepare; several servers of one NATS cluster stand with commas between."""
        self._urls = urls.split(",")
        self._client: Client | None = None
        self._keys: KeyValue | None = None

    @property
    def is_connected(self) -> bool:
        """Whether keys can be asked for."""
        return self._client is not None and not self._client.is_closed

    async def connect(self) -> None:
        """Connect, subscribe to changes, and make the bucket if it does not exist.

        Raises:
            ConfigurationError: NATS has no JetStream, or refuses this relay.
            OSError: It does not answer; or what else is in `AWAY`.
        """
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
                await client.subscribe(f"{NEWS}>", cb=self._on_message)
            self._client = client
            await self.open()
        except BaseException as error:
            await client.close()
            is_away = isinstance(error, TimeoutError | OSError | nats.errors.NoServersError)
            if is_away or not isinstance(error, nats.errors.Error):
                raise
            parts = map(urlsplit, self._urls)  # without the password
            places = ",".join(f"{each.hostname}:{each.port or 4222}" for each in parts)
            raise ConfigurationError(
                f"--cluster {places}: {type(error).__name__}; start nats-server with -js, and "
                "give this user access to it"
            ) from error

    async def open(self) -> None:
        """Find the bucket, which a NATS that has lost its memory does not have any more."""
        assert self._client is not None
        stream = self._client.jetstream(timeout=REQUEST_S)
        try:
            self._keys = await stream.key_value(BUCKET)
        except nats.js.errors.NotFoundError:
            self._keys = await stream.create_key_value(
                bucket=BUCKET,
                ttl=TTL_S,
                replicas=3 if len(self._client.servers) >= 3 else 1,
                republish=RePublish(src=f"$KV.{BUCKET}.>", dest=f"{NEWS}>"),
            )

    async def close(self) -> None:
        """End the connection."""
        if self._client is not None:
            await self._client.close()

    async def read(self, key: str) -> tuple[bytes, int]:
        """Return the data of a key, empty if there is none, and its revision."""
        try:
            entry = await self._open_keys().get(key)
        except nats.js.errors.KeyNotFoundError as error:
            return b"", (error.entry and error.entry.revision) or 0
        return entry.value or b"", entry.revision or 0

    async def write(self, key: str, data: bytes, revision: int | None) -> int | None:
        """Write a key over a revision, or over any (None), or remove it (empty data); return its
        revision, or None if it has another one."""
        keys = self._open_keys()
        try:
            if not data:
                return int(await keys.delete(key, last=revision))
            if revision is None:
                return int(await keys.put(key, data))
            return int(await keys.update(key, data, last=revision))
        except nats.js.errors.KeyWrongLastSequenceError:
            return None

    def _open_keys(self) -> KeyValue:
        if self._keys is None or not self.is_connected:
            raise ConnectionError("NATS is away")
        return self._keys

    async def _on_message(self, message: Msg) -> None:
        self.on_news(message.subject.removeprefix(NEWS), message.data)

    async def _on_error(self, error: Exception) -> None:
        if isinstance(error, nats.errors.SlowConsumerError):
            self.on_doubt()

    async def _on_disconnected(self) -> None:
        self.on_lost()
