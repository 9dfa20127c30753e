"""The one message that two peers exchange about keys, with all that its sender knows.

A message says the same however often it comes, so one that was lost is mended by the next, and
there is no order to keep. It travels as a whisper: the relay carries it, and may drop or repeat it.

Its bytes stand in ``docs/privacy.md``. Code and wrapped key cover all that stands before them, and
the ids of sender and receiver: a message cannot be turned round, handed to another peer, or used
in another room, and its key cannot be moved to another message, not even by a member.
"""

import hashlib
import hmac
import struct
from collections.abc import Iterable
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pica_client.e2ee.secret import RoomSecret
from pica_client.errors import KeyMessageError
from pica_protocol.messages import Track

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
    the room that was asked for, name, and for each track kind, policy, avatar, stream and
    deadline_ms, numbers in decimal. What may change in a call (metadata) is left out.
    """
    texts = ["pica seal peer", room, name]
    for track in tracks:
        texts += [track.kind, track.policy, track.avatar]
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
        KeyMessageError: The other public key is of small order: anybody would know the key.
    """
    try:
        shared = private.exchange(X25519PublicKey.from_public_bytes(theirs))
    except ValueError as error:
        raise KeyMessageError("a public key that agrees on nothing") from error
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
        KeyMessageError: It was wrapped for another peer, or in another message.
    """
    body, wrapped = data[: _BODY.size], data[_BODY.size : -_CODE_BYTES]
    try:
        return _wrapping(body, way, pair_key).decrypt(bytes(12), wrapped, b"")
    except InvalidTag:
        raise KeyMessageError("a key that is wrapped for another peer") from None


def _wrapping(body: bytes, way: tuple[str, str], pair_key: bytes) -> AESGCM:
    """A cipher for one message alone: with a key of its own, its nonce may be zero."""
    return AESGCM(_mac(pair_key, way, body))


def _mac(key: bytes, way: tuple[str, str], data: bytes) -> bytes:
    # Peer ids hold no zero byte, so the parts cannot run into each other.
    sender, receiver = way
    message = b"\0".join((sender.encode(), receiver.encode(), data))
    return hmac.digest(key, message, "sha256")[:_CODE_BYTES]
