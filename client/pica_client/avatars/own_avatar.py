"""The avatar that a person wears, and whether its file goes to the relay."""

import hashlib
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import AvatarGiver
from pica_client.errors import AvatarLookupError
from pica_client.transport.config import LinkConfig
from pica_core.avatar.file import Avatar
from pica_core.avatar.shipped import shipped_avatar_files

GiveAvatar = Literal["auto", "yes", "no"]
"""Whether the relay gets the file. auto: unless it ships with this package, so that everybody has
it, or faces are encrypted: whoever runs the relay can look at the file."""
SALT = "pica"
"""Goes before a name that is hashed (chosen: so the names of this documentation's examples fall on
as many shipped avatars)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OwnAvatar:
    """An avatar that is loaded, to be worn."""

    identity: str
    """The SHA-256 of its file, hexadecimal."""
    avatar: Avatar
    path: Path

    def giver(
        self, link: LinkConfig, say: Callable[[str], None], give: GiveAvatar = "auto"
    ) -> AvatarGiver | None:
        """What gives the file to the relays of a link; None if it is not to be given."""
        is_needed = link.secret_file is None and self.path not in shipped_avatar_files()
        if give == "no" or (give == "auto" and not is_needed):
            return None
        return AvatarGiver(link, self.path, self.identity, say)


def choose_own_avatar(given: str | None, name: str, library: AvatarLibrary) -> OwnAvatar:
    """Load the avatar of one's own face.

    Args:
        given: A shipped one by its name, or a .pica file; None takes one by the name.
        library: The avatars of this machine, which knows the file afterwards.

    Raises:
        AvatarLookupError: It is not there, or none ships and none is given.
        AvatarFileError: It must not be used.
    """
    identity = library.find(given or avatar_by_name(name, library.names))
    return OwnAvatar(identity=identity, avatar=library.load(identity), path=library.path(identity))


def avatar_by_name(name: str, avatars: Sequence[str]) -> str:
    """The avatar of who has chosen none: always the same for one name, and for two names seldom
    the same.

    Raises:
        AvatarLookupError: There are none.
    """
    if not avatars:
        raise AvatarLookupError("no avatar ships with this package; name one with --avatar FILE")
    text = SALT + unicodedata.normalize("NFC", name).casefold().strip()
    number = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8])
    return avatars[number % len(avatars)]
