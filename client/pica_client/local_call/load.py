"""Simulated peers: many senders on one event loop, for tests and for load.

The senders are the real ones; what is simulated is that they share a process. A relay sees no
difference, the machine does: `pica demo` and `pica bench call` use a process for each.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Sequence
from typing import Any

from pica_client.publish.sender import Sender, SenderConfig
from pica_client.sources import Source, open_source, start_later
from pica_client.transport.config import LinkConfig
from pica_core.avatar.file import Avatar

DEFAULT_SOURCES = (
    "performance:talk#1",
    "performance:range_of_motion#2",
    "performance:talk#3@7",
    "performance:listen#4",
    "performance:talk#5@21",
)
"""What the peers of a demo play, in turn: three who talk, one who tries every muscle, one who
listens."""
SOURCE_STEP_S = 23.7
"""Between the starting points of peers that play the same recording (chosen: no two in phase)."""


def peer_sources(source: str | None, num_peers: int) -> list[str]:
    """What each of some peers plays.

    Args:
        source: One source for all, each starting elsewhere in it; None for `DEFAULT_SOURCES`.
        num_peers: How many.
    """
    if source is None:
        return [DEFAULT_SOURCES[index % len(DEFAULT_SOURCES)] for index in range(num_peers)]
    return [start_later(source, index * SOURCE_STEP_S) for index in range(num_peers)]


def make_senders(
    links: Sequence[LinkConfig],
    avatars: Sequence[tuple[str, Avatar]],
    *,
    config: SenderConfig,
    sources: Sequence[Source] | None = None,
    seed: int = 0,
) -> list[Sender]:
    """One sender per link, avatars and sources dealt in turn.

    Args:
        links: Where each connects, and as whom.
        avatars: Hash and avatar, at least one.
        config: Rate and duration of all.
        sources: What they play; `DEFAULT_SOURCES` by default.
        seed: Of what chance there is.
    """
    played = sources or [open_source(text) for text in peer_sources(None, len(links))]
    senders = []
    for index, link in enumerate(links):
        identity, avatar = avatars[index % len(avatars)]
        rng = random.Random(f"{seed}/{index}")
        source = played[index % len(played)]
        senders.append(Sender(config, link, source, avatar, identity, rng=rng))
    return senders


async def run_senders(senders: Sequence[Sender]) -> list[dict[str, Any]]:
    """Run all until each is done; the first that fails ends the others.

    Returns:
        Their statistics, in order.
    """
    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(sender.run()) for sender in senders]
    return [task.result() for task in running]
