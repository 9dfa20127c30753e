"""The way out for webhooks, by httpx: one connection for each event, and nothing decided here.

The relay's own work never waits for it: an event is put into a bounded queue, and a task of its own
does the rest.
"""

import asyncio
import logging
import random
import secrets
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import httpx

from pica_server.config.relay import WebhookConfig
from pica_server.errors import ConfigurationError
from pica_server.hooks import webhooks
from pica_server.ops.certificate import trusting

MIN_SECRET_BYTES: Final = 16

_logger = logging.getLogger(__name__)
logging.getLogger("httpx").setLevel(logging.WARNING)  # else it has a line for each attempt


class WebhookSender:
    """Delivers events until it is stopped."""

    def __init__(
        self,
        config: WebhookConfig,
        counts: Counter[str],
        *,
        unix_time: Callable[[], float] = time.time,
    ) -> None:
        """Prepare; ``unix_time`` is the clock that stands in events and signatures.

        Raises:
            ConfigurationError: The secret, or the certificates to trust, cannot be read.
        """
        self.queue = webhooks.WebhookQueue(
            max_waiting=config.max_waiting,
            give_up_s=config.give_up_s,
            new_id=lambda: secrets.token_hex(16),
            random=random.random,
            counts=counts,
        )
        self._config = config
        self._secret = _read_secret(config)
        self._unix_time = unix_time
        self._tls = trusting("--webhook.ca-file", config.ca_file)
        self._wake = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self._task: asyncio.Task[None] | None = None
        self._has_failed = False

    def notify(self, event: webhooks.RoomEvent) -> None:
        """Queue an event."""
        now = asyncio.get_running_loop().time()
        self.queue.offer(event, unix_s=self._unix_time(), now=now)
        self._wake.set()
        self._idle.clear()

    def start(self) -> None:
        """Begin to deliver."""
        self._task = asyncio.get_running_loop().create_task(self._run(), name="webhooks")

    async def stop(self, limit_s: float) -> None:
        """Stop when nothing waits any more, or when time is up."""
        assert self._task is not None, "it was started"
        with suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                await self._idle.wait()
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task

    async def _run(self) -> None:
        loop, queue = asyncio.get_running_loop(), self.queue
        now = loop.time()
        while True:
            self._wake.clear()
            delivery = queue.take(now)
            if delivery is None:
                timer = queue.next_timer()
                with suppress(TimeoutError):
                    async with asyncio.timeout_at(timer):
                        await self._wake.wait()
                        timer = None
                # A loop may fire a timer up to its clock's resolution too early.
                now = max(loop.time(), timer or 0.0)
                continue
            try:
                async with asyncio.timeout(self._config.timeout_s):
                    status = await self._post(delivery)
                trouble = "" if 200 <= status < 300 else f"HTTP {status}"
            except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError) as error:
                trouble = type(error).__name__
            now = loop.time()
            if trouble:
                queue.failed(now)
            else:
                queue.delivered()
            if not queue:
                self._idle.set()
            if bool(trouble) != self._has_failed:  # news, not one line for each attempt
                self._has_failed = bool(trouble)
                _logger.warning(
                    "webhook fails" if trouble else "webhook works again", extra={"why": trouble}
                )

    async def _post(self, delivery: webhooks.Delivery) -> int:
        """Send one event and return the status of the answer, the rest of which is not read."""
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "pica-relay",
            "Connection": "close",
            webhooks.ID_HEADER: delivery.event_id,
        }
        if self._secret:
            signed = webhooks.signature(self._secret, delivery.body, int(self._unix_time()))
            headers[webhooks.SIGNATURE_HEADER] = signed
        # It follows no redirects, and no proxy that the environment names.
        async with (
            httpx.AsyncClient(verify=self._tls, trust_env=False, timeout=None) as client,
            client.stream(
                "POST", self._config.url, content=delivery.body, headers=headers
            ) as response,
        ):
            return response.status_code


def _read_secret(config: WebhookConfig) -> bytes:
    path = config.secret_file
    if path is None:
        return b""
    try:
        secret = path.read_bytes().strip()
    except OSError as error:
        raise ConfigurationError(f"--webhook.secret-file {path}: {error.strerror}") from error
    if len(secret) < MIN_SECRET_BYTES:
        raise ConfigurationError(
            f"--webhook.secret-file {path}: a secret has {MIN_SECRET_BYTES} bytes or more; "
            "`openssl rand -hex 32` makes one"
        )
    return secret
