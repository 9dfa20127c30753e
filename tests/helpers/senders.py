"""Many senders on one event loop: the real ones, but sharing a process, and avatars in memory."""

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

from pica_client.endpoint import Sender
from pica_client.local_call.local_call import peer_sources
from pica_client.publish import Outgoing, Publisher, SenderConfig
from pica_client.sources import Source, open_source
from pica_client.transport.connect import LinkConfig
from pica_core.avatar.file import Avatar


class LoadedAvatars:
    """Avatars that are in memory already, by hash."""

    def __init__(self, avatars: Mapping[str, Avatar]) -> None:
        self._avatars = dict(avatars)

    def get(self, identity: str) -> Avatar | None:
        """See `AvatarStore.get`."""
        return self._avatars.get(identity)

    def note(self, identity: str) -> str:
        """See `AvatarStore.note`."""
        return ""


def link_of(url: str, name: str, host: str = "", **options: Any) -> LinkConfig:
    """A link of this name, by a host name of the simulated network: it chooses the route."""
    port = url.rpartition(":")[2]
    return LinkConfig(url=f"ws://{host or name}:{port}", room="kitchen", name=name, **options)


def make_senders(
    links: Sequence[LinkConfig],
    avatars: Sequence[tuple[str, Avatar]],
    *,
    config: SenderConfig,
    sources: Sequence[Source] | None = None,
) -> list[Sender]:
    """One sender per link; avatars, each with its hash, and sources are dealt in turn."""
    played = sources or [open_source(text) for text in peer_sources(None, len(links))]
    senders = []
    for index, link in enumerate(links):
        identity, avatar = avatars[index % len(avatars)]
        source = played[index % len(played)]
        senders.append(Sender(link, Outgoing(face=Publisher(config, source, avatar, identity))))
    return senders


async def run_senders(senders: Sequence[Sender]) -> list[dict[str, Any]]:
    """Run all until each is done, and give their statistics; the first that fails ends the
    others."""
    async with asyncio.TaskGroup() as tasks:
        for sender in senders:
            tasks.create_task(sender.run())
    return [sender.stats() for sender in senders]
