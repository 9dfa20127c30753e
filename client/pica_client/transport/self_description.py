"""What we say of ourselves to everybody in the room, no faster than a relay lets us. Pure."""

import binascii
import json
import math
from base64 import urlsafe_b64decode
from typing import Final

from pica_protocol.limits import check_metadata
from pica_protocol.messages import Metadata

TELL_INTERVAL_S: Final = 1.0
"""Between two changes: the relay takes no more for long."""


class SelfDescription:
    """A few short texts by key, and whether the relay knows them.

    Attributes:
        metadata: All of it, as it travels.
    """

    def __init__(self) -> None:
        self.metadata: Metadata = ()
        self._told: Metadata = ()
        self._told_s = -math.inf

    def say(self, key: str, value: str) -> None:
        """Say something under a key from now on; "" says nothing under it any more.

        Raises:
            ValueError: It is out of the limits of the protocol.
        """
        entries = {**dict(self.metadata), key: value}
        metadata = tuple((each, text) for each, text in sorted(entries.items()) if text)
        check_metadata("metadata", metadata)
        self.metadata = metadata

    def next_timer(self) -> float | None:
        """When the relay may be told what it does not know; None: it knows all."""
        return None if self.metadata == self._told else self._told_s + TELL_INTERVAL_S

    def note_told(self, now: float) -> None:
        """Note that the relay was told all of it."""
        self._told, self._told_s = self.metadata, now


def shown_name(name: str, token: str) -> str:
    """Return the name that others are shown: that of the join token, if it has one, or the given
    one. Who signed the token does not matter here: we ask what our own pass says of us."""
    try:
        claims = json.loads(urlsafe_b64decode(token.split(".")[1] + "=="))
        said = claims.get("name", "")
    except (IndexError, binascii.Error, ValueError, AttributeError, RecursionError):
        said = ""
    return said if isinstance(said, str) and said else name
