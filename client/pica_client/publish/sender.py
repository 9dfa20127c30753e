"""The sending half of a call: a publisher and its own link to the relay.

A shell: it owns the link; `publisher` makes the frames.
"""

import asyncio
import random
from collections import deque
from collections.abc import Callable
from typing import Any

from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import Source
from pica_client.transport.config import LinkConfig
from pica_client.transport.link import Connector, Link
from pica_core.avatar.file import Avatar
from pica_protocol.messages import Joined
from pica_protocol.session import ClientEvent

__all__ = ["Sender", "SenderConfig"]


class Sender:
    """One sender; `run` it, `stop` it."""

    def __init__(
        self,
        config: SenderConfig,
        link_config: LinkConfig,
        source: Source,
        avatar: Avatar,
        avatar_identity: str,
        *,
        connector: Connector | None = None,
        rng: random.Random | None = None,
        on_joined: Callable[[], None] | None = None,
    ) -> None:
        """Prepare; see `Link` for connector and rng; ``on_joined`` is called after each join."""
        self.config = config
        self._on_joined = on_joined
        self._publisher = Publisher(config, source, avatar, avatar_identity)
        self._link = Link(
            link_config,
            (self._publisher.track,),
            on_event=self._on_event,
            connector=connector,
            rng=rng,
        )
        self._stopping = asyncio.Event()

    @property
    def relay_url(self) -> str:
        """The relay that the sender is at, or tries next."""
        return self._link.url

    @property
    def frame_log(self) -> deque[tuple[int, int]]:
        """The times of frames that were sent; see `Publisher.frame_log`."""
        return self._publisher.frame_log

    def stop(self) -> None:
        """Make `run` leave the room and return."""
        self._stopping.set()

    async def run(self) -> dict[str, Any]:
        """Send until `stop`, or for the configured time.

        Returns:
            The statistics, see `stats`.

        Raises:
            RelayError: The relay is not there, or will not have us.
        """
        pacing = asyncio.create_task(
            self._publisher.pace(self._link, self._stopping), name="pacing"
        )
        linking = asyncio.create_task(self._link.run(), name="link")
        try:
            await asyncio.wait({pacing, linking}, return_when=asyncio.FIRST_COMPLETED)
            if pacing.done():
                pacing.result()
                self._link.leave()
            await linking
        finally:
            for task in (pacing, linking):
                task.cancel()
            await asyncio.gather(pacing, linking, return_exceptions=True)
        return self.stats()

    def stats(self) -> dict[str, Any]:
        """What was sent so far, and the link's side of it."""
        seconds, counters = self._publisher.seconds_sent, self._link.counters
        return {
            "name": self._link.config.name,
            **self._publisher.stats(),
            "replaced": counters.frames_replaced,
            "wire_bytes": counters.sent_wire_bytes,
            "wire_bps": round(counters.sent_wire_bytes * 8 / seconds) if seconds else None,
            "reconnects": self._link.reconnects,
            "resumes": counters.resumes,
            "errors": counters.errors,
            "seal": None if self._link.guard is None else self._link.guard.stats(),
        }

    def _on_event(self, event: ClientEvent, now: float) -> None:
        self._publisher.receive_event(event)
        if isinstance(event, Joined) and self._on_joined is not None:
            self._on_joined()
