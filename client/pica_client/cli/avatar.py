"""`pica avatar push`."""

import asyncio
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pica_client.avatars.upload import push_avatar
from pica_client.output import say
from pica_client.transport.config import LinkConfig
from pica_core.avatar.file import avatar_id, load_avatar
from pica_core.avatar.shipped import avatar_file


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarPushOptions:
    """Options of `pica avatar push`."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""
    url: str = "ws://127.0.0.1:8765"
    """Address of the relay, ws:// or wss://."""
    token_file: Path | None = None
    """File with a join token that allows to wear this avatar, see pica token."""
    ca_file: Path | None = None
    """Trust the certificates of this PEM file instead of the system's, at a wss:// address."""


def avatar_push(options: AvatarPushOptions) -> dict[str, Any]:
    """Give a relay an avatar's file, for receivers that do not have it.

    Checks it first, as receivers do. `pica send` gives the avatar that it wears by itself.
    """
    link = LinkConfig(url=options.url, token_file=options.token_file, ca_file=options.ca_file)
    file = avatar_file(options.file)
    load_avatar(file)
    identity = avatar_id(file)
    stored = asyncio.run(push_avatar(link.url, link, file, identity))
    say(f"{file}: the relay {'has it now' if stored.is_new else 'had it already'}")
    return {"sha256": identity, "was_there": not stored.is_new}
