"""The one message that two peers exchange about keys, and what was agreed with one peer since we
last heard that it came. The room's rules are in `guard`.

A message says the same however often it comes, so one that was lost is mended by the next, and
there is no order to keep. It travels as a whisper: the relay carries it, and may drop or repeat it.

Its bytes stand in ``docs/privacy.md``. Code and wrapped key cover all that stands before them, and
the ids of sender and receiver: a message cannot be turned round, handed to another peer, or used
in another room, and its key cannot be moved to another message, not even by a member.

    state             becomes         when
    waiting           plain           no key message has come for `SILENT_S`
    any but verified  secret differs  a message comes that no member wrote
    any but verified  relabelled      a member's message describes it otherwise than the relay
    any but verified  waiting         a member's message comes
    any               verified        its key comes, in a message that echoes our challenge
    any               waiting         it came, came back, or took another public key

Made-up or repeated messages cost a verified peer nothing.
"""

import hashlib
import hmac
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pica_client.e2ee.frames import FrameKey, ReplayWindow, derive_key
from pica_client.e2ee.secret import RoomSecret, SealState
from pica_client.errors import SealError
from pica_protocol.messages import Peer, Track

PUBLIC_KEY_BYTES: Final = 32
CHALLENGE_BYTES: Final = 8
UNKNOWN: Final = bytes(CHALLENGE_BYTES)
"""The echo of a sender that does not know the receiver's challenge."""
MESSAGE_BYTES: Final = 141

_BODY: Final = struct.Struct(">?32s8s8sIII32s")
_WRAPPED_BYTES: Final = 32
_CODE_BYTES: Final = 16


class KeyMessage(NamedTuple):
    """What a message says, but for the wrapped key and the code."""

    wants_answer: bool
    public_key: bytes
    challenge: bytes
    echo: bytes
    acknowledged: int
    generation: int
    first: int
    description: bytes


def describe(room: str, name: str, tracks: Iterable[Track]) -> bytes:
    """Return what a peer says of itself, so that the relay cannot say otherwise.

    SHA-256 of these texts, each with its length before it (2 bytes, then UTF-8): "pica seal peer",
    the room that was asked for, name, and for each track kind, avatar, stream and
    deadline_ms, numbers in decimal. What may change in a call (metadata) is left out.
    """
    texts = ["pica seal peer", room, name]
    for track in tracks:
        texts += [track.kind, track.avatar]
        texts += [str(track.stream), str(track.deadline_ms)]
    encoded = [text.encode() for text in texts]
    return hashlib.sha256(b"".join(len(text).to_bytes(2) + text for text in encoded)).digest()


def room_key(secret: RoomSecret, room: str, purpose: bytes) -> bytes:
    """Return what the members of a room share: the ``code`` key, or the salt of ``pair`` keys."""
    info = b"pica seal " + purpose + b" " + room.encode()
    return HKDF(SHA256(), 32, salt=b"", info=info).derive(secret.value)


def agree(private: X25519PrivateKey, theirs: bytes, salt: bytes) -> bytes:
    """Return the key that two peers, and no others, share.

    Raises:
        SealError: The other public key is of small order: anybody would know the key.
    """
    try:
        shared = private.exchange(X25519PublicKey.from_public_bytes(theirs))
    except ValueError as error:
        raise SealError("a public key that agrees on nothing") from error
    keys = sorted((private.public_key().public_bytes_raw(), theirs))
    return HKDF(SHA256(), 32, salt=salt, info=b"pica seal wrap " + b"".join(keys)).derive(shared)


def encode(
    message: KeyMessage, code_key: bytes, way: tuple[str, str], pair_key: bytes, base_key: bytes
) -> bytes:
    """Return a message from one peer id to another, with a key unless its generation is 0."""
    body = _BODY.pack(*message)
    wrapped = bytes(_WRAPPED_BYTES)
    if message.generation:
        wrapped = _wrapping(body, way, pair_key).encrypt(bytes(12), base_key, b"")
    return body + wrapped + _mac(code_key, way, body + wrapped)


def decode(data: bytes, code_key: bytes, way: tuple[str, str]) -> KeyMessage | None:
    """Return what a member wrote to us; None if no member of this room did."""
    body, code = data[:-_CODE_BYTES], data[-_CODE_BYTES:]
    is_ours = len(data) == MESSAGE_BYTES and hmac.compare_digest(code, _mac(code_key, way, body))
    return KeyMessage(*_BODY.unpack_from(data)) if is_ours else None


def unwrap(data: bytes, way: tuple[str, str], pair_key: bytes) -> bytes:
    """Return the base key in a message that `decode` has taken.

    Raises:
        SealError: It was wrapped for another peer, or in another message.
    """
    body, wrapped = data[: _BODY.size], data[_BODY.size : -_CODE_BYTES]
    try:
        return _wrapping(body, way, pair_key).decrypt(bytes(12), wrapped, b"")
    except InvalidTag:
        raise SealError("a key that is wrapped for another peer") from None


def _wrapping(body: bytes, way: tuple[str, str], pair_key: bytes) -> AESGCM:
    """A cipher for one message alone: with a key of its own, its nonce may be zero."""
    return AESGCM(_mac(pair_key, way, body))


def _mac(key: bytes, way: tuple[str, str], data: bytes) -> bytes:
    # Peer ids hold no zero byte, so the parts cannot run into each other.
    sender, receiver = way
    message = b"\0".join((sender.encode(), receiver.encode(), data))
    return hmac.digest(key, message, "sha256")[:_CODE_BYTES]


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
