"""The own face in a call: what plays it, what it looks like, and what sends it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import AvatarGiver, GiveAvatar, choose_own_avatar
from pica_client.publish.publisher import Publisher, SenderConfig
from pica_client.sources import open_source
from pica_client.transport.config import LinkConfig

DEFAULT_SOURCE: Final = "performance:talk"
"""Default source."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FaceChoice:
    """Which face to send."""

    source: str = DEFAULT_SOURCE
    """What plays it, as `sources.open_source` takes it; empty sends nothing: a watcher."""
    avatar: str | None = None
    """A shipped avatar by its name, or a .pica file; None takes one by the wearer's name."""
    give: GiveAvatar = "auto"
    """Whether the relay gets the avatar's file."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OutgoingFace:
    """A face that is ready to be sent."""

    publisher: Publisher
    giver: AvatarGiver | None
    """Gives the avatar's file to the relay; None if it is not to be given."""


def open_own_face(
    choice: FaceChoice,
    link: LinkConfig,
    library: AvatarLibrary,
    say: Callable[[str], None],
) -> OutgoingFace | None:
    """Make ready what was chosen; None for a watcher.

    Raises:
        SourceError: The source cannot be opened.
        AvatarLookupError: The avatar is not there.
        AvatarFileError: It must not be used.
    """
    if not choice.source:
        return None
    own = choose_own_avatar(choice.avatar, link.name, library)
    source = open_source(choice.source, person=link.name)
    publisher = Publisher(SenderConfig(), source, own.avatar, own.identity)
    return OutgoingFace(publisher=publisher, giver=own.giver(link, say, choice.give))
