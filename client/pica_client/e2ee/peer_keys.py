"""What was agreed with one peer since we last heard that it came. The room's rules are in `guard`.

    state             becomes         when
    waiting           plain           no key message has come for `SILENT_S`
    any but verified  secret differs  a message comes that no member wrote
    any but verified  relabelled      a member's message describes it otherwise than the relay
    any but verified  waiting         a member's message comes
    any               verified        its key comes, in a message that echoes our challenge
    any               waiting         it came, came back, or took another public key

Made-up or repeated messages cost a verified peer nothing.
"""

from dataclasses import dataclass, field
from typing import Final

from pica_client.e2ee.frames import FrameKey, ReplayWindow, derive_key
from pica_client.e2ee.key_messages import UNKNOWN
from pica_client.e2ee.status import SealState
from pica_protocol.messages import Peer

KEY_IDS: Final = 8
"""Key ids go round: so many fit the config byte of a sealed payload, and cost nothing."""
LATE_FRAMES_S: Final = 2.0
"""How long a key that was replaced still opens what is under way (chosen: longer than a relay lets
a slow reader lag)."""
FIRST_WAIT_S: Final = 0.25
LONGEST_WAIT_S: Final = 8.0
"""Between the first two messages to a peer that does not answer, and between later ones."""
SILENT_S: Final = 3.0
"""A peer that has said nothing of keys for so long counts as one that does not encrypt."""


@dataclass(slots=True)
class OpeningKey:
    """A key of another member, with what it has opened."""

    key: FrameKey
    window: ReplayWindow
    expires_s: float = float("inf")
    """When it opens nothing more; never while it is the newest."""


@dataclass(slots=True)
class PeerKeys:
    """One peer in the room."""

    peer: Peer
    """What the relay tells of it."""
    description: bytes
    """What that amounts to: its own messages must say the same."""
    challenge: bytes
    """Ours for it: a message that echoes it was written after we heard that the peer came."""
    came_s: float
    due_s: float | None
    """When it gets its next message; None: it needs none."""
    wait_s: float = FIRST_WAIT_S
    """From its next message to the one after it."""
    state: SealState = SealState.WAITING
    public_key: bytes = b""
    pair_key: bytes = b""
    its_challenge: bytes = UNKNOWN
    given: int = 0
    """Newest generation of our key that a message took to it."""
    first: int = 0
    """Counter of the first frame under our key that is for it."""
    acknowledged: int = 0
    """Newest generation of our key that it has."""
    newest: int = 0
    """Newest generation of its key that we have had."""
    keys: dict[int, OpeningKey] = field(default_factory=dict)
    """Its keys by key id."""

    @property
    def is_verified(self) -> bool:
        """Return True if the peer has proven to be here, and to know the secret."""
        return self.state is SealState.VERIFIED

    def is_content(self, generation: int) -> bool:
        """Return True if the peer has our key of this generation, and we have one of its."""
        return self.is_verified and self.acknowledged == generation

    def say_more(self, now: float) -> None:
        """There is something new to tell: do so at once, and then again with short waits."""
        self.due_s, self.wait_s = now, FIRST_WAIT_S

    def note_sent(self, generation: int, now: float) -> None:
        """A message has gone out; the next one is due later, if one is needed."""
        if self.is_content(generation):
            self.due_s, self.wait_s = None, FIRST_WAIT_S
        else:
            self.due_s, self.wait_s = now + self.wait_s, min(2 * self.wait_s, LONGEST_WAIT_S)

    def take_key(self, generation: int, base_key: bytes, first: int, now: float) -> None:
        """Take a newer key of the peer, which opens from a counter on."""
        self.keys = {i: key for i, key in self.keys.items() if key.expires_s > now}
        for opening in self.keys.values():
            opening.expires_s = min(opening.expires_s, now + LATE_FRAMES_S)
        key = derive_key(base_key, generation % KEY_IDS)
        self.keys[key.key_id] = OpeningKey(key, ReplayWindow(first))
        self.newest, self.state = generation, SealState.VERIFIED
        self.say_more(now)

    def state_at(self, now: float) -> SealState:
        """Return what is known of its encryption."""
        is_silent = not self.public_key and now - self.came_s >= SILENT_S
        if is_silent and self.state is SealState.WAITING:
            self.state = SealState.PLAIN
        return self.state
