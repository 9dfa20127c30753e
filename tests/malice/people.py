"""The people on a malicious relay: their clients, their lines, and what they keep when they go."""

import random
from dataclasses import dataclass, field

from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar, toy_payload
from pica_client.call.call import ArrivedFace, Call
from pica_client.e2ee.guard import Guard
from pica_client.e2ee.secret import RoomSecret
from pica_protocol.client_session import ClientSession
from pica_protocol.messages import Peer
from pica_protocol.session import State

SECRET = RoomSecret(bytes(range(32)))
ROOM = "r"
NAMES = ("Ada", "Ben", "Cho", "Dee")
_TOY = make_toy_avatar()
AVATARS = tuple(f"{number:064x}" for number in range(1, len(NAMES) + 1))
_STORE = LoadedAvatars(dict.fromkeys(AVATARS, _TOY))
FACE = toy_payload()


class BrokenPromiseError(AssertionError):
    """What must never happen, and the seed that makes it happen."""


@dataclass(eq=False)
class Line:
    """One connection as the relay has it."""

    person: "Person"
    peer: Peer | None = None
    """As it truly joined, under the id that it was told."""
    waiting: list[bytes] = field(default_factory=list)
    held_until_s: float = 0.0


class Person:
    """A client: session, guard and call, and a face to send."""

    def __init__(self, index: int, seed: str) -> None:
        self.index, self.name = index, NAMES[index]
        self.randomness = random.Random(f"{seed}/{index}")
        self.guard = Guard(SECRET, random_bytes=self.randomness.randbytes)
        self.seen: list[ArrivedFace] = []
        self.call = Call(_STORE, on_face=self.seen.append)
        self.session: ClientSession | None = None
        self.line: Line | None = None
        self.captured_us = index
        self.parted: set[str] = set()
        """Peer ids whose leaving we have heard of, on this connection."""
        self.never_members: set[str] = set()
        """Peer ids of people who had gone before we heard of them."""

    @property
    def is_joined(self) -> bool:
        """Whether it can send."""
        return self.session is not None and self.session.state is State.JOINED


@dataclass
class Leaver:
    """Somebody who left, and keeps what it had."""

    peer_id: str
    guard: Guard
    public_key: bytes
