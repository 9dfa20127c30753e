"""How the encryption of a call stands, for people to see. Free of ciphers: anybody may import it.

A `Guard` puts a new `SealStatus` in the place of the old one at each change, so any thread may read
`Guard.status` at any time.
"""

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
    """What is known of a peer's encryption."""

    WAITING = "waiting"
    """Keys are on their way; nothing is known yet."""
    VERIFIED = "verified"
    """It encrypts, knows the room secret and our present key, and is what the relay says it is."""
    PLAIN = "plain"
    """It has said nothing of keys for seconds: it does not encrypt, or is kept from saying so."""
    SECRET_DIFFERS = "secret differs"
    """Its notes are not made with our secret and room."""
    RELABELLED = "relabelled"
    """It describes itself otherwise than the relay does: name, avatar, tracks, profile, streams."""
    OTHER_VERSION = "other version"
    """Its encryption is of another version than ours."""


_NOTES: Final = {
    SealState.PLAIN: "not encrypted",
    SealState.SECRET_DIFFERS: "secret differs: compare the secret files",
    SealState.RELABELLED: "not who the relay says it is",
    SealState.OTHER_VERSION: "encrypted by another version",
}


@dataclass(frozen=True, slots=True)
class PeerSeal:
    """How the encryption of one peer stands. Only who is VERIFIED is shown and counted."""

    state: SealState = SealState.WAITING
    reason: str = "keys are on their way"
    """One line for people: what is wrong, and the remedy if there is one."""

    @property
    def note(self) -> str:
        """What is wrong in the few words that fit under a name; empty if nothing is known to be."""
        return _NOTES.get(self.state, "")


@dataclass(frozen=True, kw_only=True)
class SealStatus:
    """How the encryption of the call stands, as of when we were last in the room."""

    room: str = ""
    """The room that we asked for."""
    peers: Mapping[str, PeerSeal] = field(default_factory=dict)
    """Everybody else in the room, by peer id."""
    members: tuple[tuple[bytes, bytes], ...] = ()
    """Public key and description of us, and of each peer that was given our key: who is verified,
    and whoever else may read us."""

    @property
    def num_verified(self) -> int:
        """How many others are verified."""
        return sum(peer.state is SealState.VERIFIED for peer in self.peers.values())

    @cached_property
    def code(self) -> str:
        """Thirty digits in six groups, to be read aloud; empty while nobody else can read us.

        Everybody who sees the same people in the same room has the same code: it covers the room
        and the public key, name, avatar, tracks and streams of each who can read us. It changes
        when somebody comes, goes or reconnects. If somebody has another code, the relay shows the
        two of you different people. Takes milliseconds the first time it is asked for.
        """
        if len(self.members) < 2:
            return ""
        text = b"".join(map(b"".join, sorted(self.members)))
        salt = b"pica seal 2 code " + self.room.encode()
        digest = hashlib.pbkdf2_hmac("sha512", text, salt, CODE_ROUNDS, 5 * CODE_GROUPS)
        groups = (digest[i : i + 5] for i in range(0, len(digest), 5))
        return " ".join(f"{int.from_bytes(group) % 100_000:05d}" for group in groups)
