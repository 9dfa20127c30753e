"""The sending half of a call: a publisher and its own link to the relay.

A shell: it owns the link; `publisher` makes the frames.
"""

import asyncio
import random
from typing import Any

from pica_client.avatars.upload import AvatarGiver
from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import Source
from pica_client.transport.config import LinkConfig
from pica_client.transport.link import Link
from pica_client.transport.link_news import LinkNews
from pica_client.voice.publisher import VoicePublisher
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
        rng: random.Random | None = None,
        giver: AvatarGiver | None = None,
        news: LinkNews | None = None,
        voice: VoicePublisher | None = None,
    ) -> None:
        """Prepare; see `Link` for rng. A giver gives the avatar's file to each relay
        that we join; `news` hears of the link; a voice goes over the same link."""
        self._giver = giver
        self._news = news
        self.publisher = Publisher(config, source, avatar, avatar_identity)
        self._voice = voice
        self.publisher.listen_to(voice)
        self._link = Link(
            link_config,
            (self.publisher.track, *(() if voice is None else (voice.track,))),
            on_event=self._on_event,
            rng=rng,
        )
        self._stopping = asyncio.Event()

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
        pacing = asyncio.create_task(self.publisher.pace(self._link, self._stopping), name="pacing")
        linking = asyncio.create_task(self._link.run(), name="link")
        tasks = [pacing, linking]
        if self._voice is not None:
            speaking = self._voice.pace(self._link, self._stopping)
            tasks.append(asyncio.create_task(speaking, name="voice"))
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in [each for each in tasks if each is not linking and each.done()]:
                task.result()
                self._link.leave()
            await linking
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self.publisher.close()
            if self._giver is not None:
                await self._giver.close()
        return self.stats()

    def stats(self) -> dict[str, Any]:
        """What was sent so far, and the link's side of it."""
        seconds, counters = self.publisher.seconds_sent, self._link.counters
        return {
            "name": self._link.config.name,
            **self.publisher.stats(),
            "voice": None if self._voice is None else self._voice.stats(),
            "replaced": counters.frames_replaced,
            "wire_bytes": counters.sent_wire_bytes,
            "wire_bps": round(counters.sent_wire_bytes * 8 / seconds) if seconds else None,
            "reconnects": self._link.reconnects,
            "resumes": counters.resumes,
            "errors": counters.errors,
            "avatar_given": "" if self._giver is None else self._giver.outcome,
            "seal": None if self._link.guard is None else self._link.guard.stats(),
        }

    def _on_event(self, event: ClientEvent, now: float) -> None:
        self.publisher.receive_event(event)
        if self._voice is not None:
            self._voice.receive_event(event)
        if isinstance(event, Joined) and self._giver is not None:
            self._giver.begin(self._link.url)
        if self._news is not None:
            self._news.receive_event(event, now)
