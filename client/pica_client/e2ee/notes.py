"""The one message that two peers exchange about keys: a note with all that its sender knows.

A note says the same however often it comes, so one that was lost is mended by the next, and there
is no order to keep. It travels as a whisper: the relay carries it, and may drop or repeat it.

    offset  size  field
    0       1     version        2
    1       1     flags          bit 0: please answer; bit 1: a wrapped key follows; bit 2: nothing
                                 from before this note, please; bit 3: payloads are padded
    2       2     suite          of the wrapped key, as in RFC 9605; 0 without one
    4       32    public key     X25519, of the sender, made for this stay in the room
    36      8     echo           fingerprint of the receiver's public key; zeros: not known yet
    44      4     acknowledged   newest generation of the receiver's key that the sender has had
    48      4     generation     of the wrapped key; 0 without one
    52      4     first          counter of the first frame under the key that is for the receiver
    56      32    description    of the sender, see `pica_client.e2ee.description`
    88      32    wrapped key    only with flag bit 1: base key and tag, see `WrapKey`
    ..      16    code           HMAC-SHA256 under the note key, cut to 16 bytes

All numbers are big-endian. The code also covers who writes to whom: a note cannot be turned round,
handed to somebody else, or used in another room. A note of another version is refused as such:
there is no speaking an older one.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from dataclasses import dataclass
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pica_client.e2ee.description import DESCRIPTION_BYTES
from pica_client.e2ee.errors import NoteError
from pica_client.e2ee.secret import RoomSecret
from pica_client.e2ee.status import SealState

VERSION: Final = 2
BASE_KEY_BYTES: Final = 16
PUBLIC_KEY_BYTES: Final = 32
ECHO_BYTES: Final = 8
CODE_BYTES: Final = 16
WRAPPED_BYTES: Final = BASE_KEY_BYTES + 16
MAX_GENERATION: Final = 2**32 - 1
NOBODY: Final = bytes(ECHO_BYTES)
"""The echo of a sender who does not know the receiver's public key."""

_BODY = struct.Struct(">BBH32s8sIII32s")
NOTE_BYTES: Final = (_BODY.size + CODE_BYTES, _BODY.size + WRAPPED_BYTES + CODE_BYTES)
"""Without and with a wrapped key: 104 and 136."""
_FLAG_ANSWER, _FLAG_KEY, _FLAG_RENEW, _FLAG_PADDED = 1, 2, 4, 8


class RoomKeys(NamedTuple):
    """What a secret gives in one room."""

    note_key: bytes
    """The message authentication key for every note."""
    pair_salt: bytes
    """Goes into every key between two peers: without the secret, no such key."""

    @classmethod
    def of(cls, secret: RoomSecret, room: str) -> RoomKeys:
        """Derive all keys that two peers share."""

        def derive(label: bytes) -> bytes:
            info = b"pica seal 2 " + label + b" " + room.encode()
            return HKDF(SHA256(), 32, salt=b"", info=info).derive(secret.value)

        return cls(note_key=derive(b"note"), pair_salt=derive(b"pair"))


@dataclass(frozen=True, kw_only=True, slots=True)
class Note:
    """See the table above."""

    public_key: bytes
    description: bytes = bytes(DESCRIPTION_BYTES)
    echo: bytes = NOBODY
    acknowledged: int = 0
    wants_answer: bool = False
    wants_newer: bool = False
    generation: int = 0
    first: int = 0
    suite: int = 0
    is_padded: bool = False
    wrapped_key: bytes = b""


class WrapKey:
    """Wraps base keys on the way from one peer to another: AES-GCM under an X25519 agreement."""

    def __init__(self, shared: bytes, salt: bytes, sender_key: bytes, receiver_key: bytes) -> None:
        info = b"pica seal 2 wrap " + sender_key + receiver_key
        self._cipher = AESGCM(HKDF(SHA256(), 16, salt=salt, info=info).derive(shared))

    def wrap(self, base_key: bytes, generation: int, suite: int) -> bytes:
        """Encrypt the key of one generation.

        The nonce is the generation: one generation has one base key, so the same nonce comes back
        with the same bytes only.
        """
        return self._cipher.encrypt(generation.to_bytes(12), base_key, suite.to_bytes(2))

    def unwrap(self, wrapped: bytes, generation: int, suite: int) -> bytes:
        """Return the base key.

        Raises:
            NoteError: Wrapped for other keys, or not by this peer.
        """
        try:
            return self._cipher.decrypt(generation.to_bytes(12), wrapped, suite.to_bytes(2))
        except InvalidTag:
            raise NoteError("a key that is wrapped for somebody else") from None


def agree(private: X25519PrivateKey, own: bytes, theirs: bytes, salt: bytes) -> tuple[WrapKey, ...]:
    """Return what wraps our keys for a peer, and what unwraps theirs.

    Raises:
        NoteError: Their public key is none.
    """
    try:
        shared = private.exchange(X25519PublicKey.from_public_bytes(theirs))
    except ValueError as error:  # of small order: the agreement would be known to all
        raise NoteError("a public key that agrees on nothing") from error
    return WrapKey(shared, salt, own, theirs), WrapKey(shared, salt, theirs, own)


def fingerprint(public_key: bytes) -> bytes:
    """Return what stands for a public key in an echo."""
    return hashlib.sha256(public_key).digest()[:ECHO_BYTES]


def encode_note(note: Note, note_key: bytes, sender: str, receiver: str) -> bytes:
    """Return the bytes of a note from one peer to another."""
    flags = _FLAG_ANSWER * note.wants_answer | _FLAG_KEY * bool(note.wrapped_key)
    flags |= _FLAG_RENEW * note.wants_newer | _FLAG_PADDED * note.is_padded
    body = _BODY.pack(
        VERSION,
        flags,
        note.suite,
        note.public_key,
        note.echo,
        note.acknowledged,
        note.generation,
        note.first,
        note.description,
    )
    body += note.wrapped_key
    return body + _code(body, note_key, sender, receiver)


def decode_note(data: bytes, note_key: bytes, sender: str, receiver: str) -> Note:
    """Return the note that a peer wrote to us.

    Raises:
        NoteError: Of a wrong length or version, or by somebody without the secret.
    """
    if data and data[0] != VERSION:
        raise NoteError(
            f"notes of version {data[0]}, not {VERSION}: install the same version of this program",
            SealState.OTHER_VERSION,
        )
    if len(data) not in NOTE_BYTES:
        raise NoteError(f"{len(data)} bytes that are no note")
    body = data[:-CODE_BYTES]
    if not hmac.compare_digest(data[-CODE_BYTES:], _code(body, note_key, sender, receiver)):
        raise NoteError(
            "notes by somebody without the secret of this room: compare the secret files",
            SealState.SECRET_DIFFERS,
        )
    _, flags, suite, public_key, echo, acknowledged, generation, first, description = (
        _BODY.unpack_from(body)
    )
    wrapped_key = body[_BODY.size :]
    if bool(flags & _FLAG_KEY) != bool(wrapped_key):
        raise NoteError("a note that does not say whether it has a key")
    return Note(
        public_key=public_key,
        description=description,
        echo=echo,
        acknowledged=acknowledged,
        wants_answer=bool(flags & _FLAG_ANSWER),
        wants_newer=bool(flags & _FLAG_RENEW),
        generation=generation,
        first=first,
        suite=suite,
        is_padded=bool(flags & _FLAG_PADDED),
        wrapped_key=wrapped_key,
    )


def _code(body: bytes, note_key: bytes, sender: str, receiver: str) -> bytes:
    # Peer ids hold no zero byte, so the two cannot run into each other.
    message = b"\0".join((sender.encode(), receiver.encode(), body))
    return hmac.digest(note_key, message, "sha256")[:CODE_BYTES]
