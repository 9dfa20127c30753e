"""What is held of keys: our own, and of each peer in the room. The rules are in `keys`."""

from dataclasses import dataclass, field
from typing import Final

from pica_client.e2ee.frames import FrameKey
from pica_client.e2ee.notes import WrapKey
from pica_client.e2ee.status import PeerSeal
from pica_protocol.messages import Peer

WINDOW: Final = 1024
"""Counters that are remembered: 12 s of a face at 30 frames a second and a voice at 50 (chosen:
longer than any delay that a playout would wait for)."""


class ReplayWindow:
    """Lets every counter through once, in any order within the window.

    Ask `is_new` before a frame is opened, `mark` it once it has been: a forged frame must not use
    up a counter.
    """

    def __init__(self, first: int = 0) -> None:
        """Begin with a counter; whatever is below it counts as seen."""
        self._highest = first - 1
        self._seen = (1 << WINDOW) - 1  # bit i: counter highest - i

    def is_new(self, counter: int) -> bool:
        """Whether this counter has not been seen, as far as that can be told."""
        age = self._highest - counter
        return age < 0 or (age < WINDOW and not self._seen >> age & 1)

    def mark(self, counter: int) -> None:
        """Remember a counter that `is_new`."""
        ahead = counter - self._highest
        if ahead > 0:
            shifted = self._seen << ahead if ahead < WINDOW else 0
            self._seen = (shifted | 1) & ((1 << WINDOW) - 1)
            self._highest = counter
        else:
            self._seen |= 1 << -ahead


FIRST_WAIT_S: Final = 0.25
"""Between the first two notes to a peer that does not answer."""


@dataclass(slots=True)
class OpeningKey:
    """A key of somebody else, with what it has opened."""

    generation: int
    key: FrameKey
    is_padded: bool
    window: ReplayWindow
    expires_s: float | None = None
    """When it is forgotten; None while it is the newest."""


@dataclass(slots=True)
class OwnKey:
    """The key that we seal with."""

    generation: int
    base_key: bytes
    key: FrameKey
    made_s: float
    counter: int = 0


@dataclass(slots=True)
class PeerKeys:
    """One peer in the room, and what we agreed with it."""

    peer: Peer
    """What the relay tells of it."""
    description: bytes
    """What that amounts to: its own notes must say the same."""
    came_s: float
    due_s: float | None
    """When it gets its next note; None: it needs none."""
    public_key: bytes | None = None
    wrap: WrapKey | None = None
    unwrap: WrapKey | None = None
    knows_us: bool = False
    given: int = 0
    """Newest generation of our key that a note took to it."""
    first: int = 0
    """Counter of the first frame under our key that is for it."""
    acknowledged: int = 0
    """Newest generation of our key that it has."""
    is_returned: bool = False
    """Whether its id or its public key was here before: then what it says may be old."""
    proof: int = 1
    """The generation of our key that it must acknowledge before it counts."""
    keys: dict[int, OpeningKey] = field(default_factory=dict)
    """Keys by key id, oldest first."""
    newest: int = 0
    sent_s: float = float("-inf")
    wait_s: float = FIRST_WAIT_S
    is_repeat: bool = False
    """Whether its next note says nothing new: then it must ask for an answer."""
    seal: PeerSeal = field(default_factory=PeerSeal)

    @property
    def is_verified(self) -> bool:
        """Whether it has our key of now, and we have one of its."""
        return self.acknowledged >= self.proof and bool(self.keys)
