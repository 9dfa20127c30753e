"""How the encryption of a call stands, for people to see. Free of ciphers."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Final

CODE_GROUPS: Final = 6
CODE_ROUNDS: Final = 5000
"""Rounds of PBKDF2 behind the code (chosen: 3 ms; to have two groups of people see the same 30
digits takes 2^50 tries by the birthday bound, each as slow)."""


class SealState(Enum):
    """What is known of a peer's encryption. Only a verified peer is shown and counted."""

    note: str
    """What is wrong, in the few words that fit under a name; empty if nothing is known to be."""

    WAITING = "waiting", ""
    """Keys are on their way; nothing is known yet."""
    VERIFIED = "verified", ""
    """It knows the room secret, answered our challenge with its key, and describes itself as the
    relay does."""
    PLAIN = "plain", "not encrypted"
    """It has said nothing of keys for seconds: it does not encrypt, or is kept from saying so."""
    SECRET_DIFFERS = "secret differs", "secret differs: compare the secret files"
    """Its key messages are not made with our secret and room."""
    RELABELLED = "relabelled", "not who the relay says it is"
    """It describes itself otherwise than the relay does: name, avatar, tracks, streams."""

    def __new__(cls, value: str, note: str) -> "SealState":
        """Make a state of its name and its note."""
        state = object.__new__(cls)
        state._value_, state.note = value, note
        return state


@dataclass(frozen=True, kw_only=True)
class SealStatus:
    """How the encryption of the call stands, as of when we were last in the room."""

    room: str = ""
    """The room that we asked for."""
    peers: Mapping[str, SealState] = field(default_factory=dict)
    """Everybody else in the room, by peer id."""
    members: tuple[tuple[bytes, bytes], ...] = ()
    """Public key and description of us, and of each peer that was given our key."""

    @property
    def verified(self) -> frozenset[str]:
        """Ids of the peers that have proven to be here, and to know the secret."""
        return frozenset(who for who, state in self.peers.items() if state is SealState.VERIFIED)

    @cached_property
    def code(self) -> str:
        """Thirty digits in six groups, to be read aloud; empty while no other member can read us.

        It covers the room, and public key, name, avatar, tracks and streams of each who can read
        us, so it changes when a member comes, goes or reconnects. If two have different
        codes, the relay shows them different people. Takes milliseconds the first time.
        """
        if len(self.members) < 2:
            return ""
        text = b"".join(map(b"".join, sorted(self.members)))
        salt = b"pica seal code " + self.room.encode()
        digest = hashlib.pbkdf2_hmac("sha512", text, salt, CODE_ROUNDS, 5 * CODE_GROUPS)
        groups = (digest[i : i + 5] for i in range(0, len(digest), 5))
        return " ".join(f"{int.from_bytes(group) % 100_000:05d}" for group in groups)
