"""One payload sealed, and opened again. Pure: keys and counters are arguments.

    sealed = header | encrypted payload | tag of 16 bytes
    header = config byte | key id, 0 to 8 bytes | counter, 0 to 8 bytes      (RFC 9605 4.3)

The cipher is AES_128_GCM_SHA256_128 of RFC 9605. The tag covers the header and the *metadata*: the
fields of the media header that travel in the clear (`pica_protocol.frames.clear_header`). A payload
that is moved to another stream, sequence number or time does not open.
"""

from dataclasses import dataclass, field
from typing import Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pica_client.errors import SealError

BASE_KEY_BYTES: Final = 16
TAG_BYTES: Final = 16
FACE_BYTES: Final = 48
"""Every face is padded to this size before it is sealed, so that sizes do not tell who speaks; a
larger one to the next multiple (chosen: coded faces take 28 bytes at most, see docs/privacy.md)."""
WINDOW: Final = 1024
"""Counters that are remembered: 12 s of a face at 30 frames a second and a voice at 50 (chosen:
longer than any delay that a playout would wait for)."""

_SUITE: Final = 4
_NONCE_BYTES: Final = 12
_PADDING_MARK: Final = b"\x80"


@dataclass(frozen=True, slots=True)
class FrameKey:
    """A key ready for use; its parts never leave this process."""

    key_id: int
    cipher: AESGCM = field(repr=False)
    salt: bytes = field(repr=False)

    def nonce(self, counter: int) -> bytes:
        """Return the nonce of one frame: salt xor counter (RFC 9605 4.4.3)."""
        return (int.from_bytes(self.salt) ^ counter).to_bytes(_NONCE_BYTES)


def derive_key(base_key: bytes, key_id: int) -> FrameKey:
    """Derive key and salt from a sender's base key (RFC 9605 4.4.2)."""
    suffix = key_id.to_bytes(8) + _SUITE.to_bytes(2)

    def expand(label: bytes, length: int) -> bytes:
        return HKDF(SHA256(), length, salt=b"", info=label + suffix).derive(base_key)

    key = expand(b"SFrame 1.0 Secret key ", 16)
    return FrameKey(key_id, AESGCM(key), expand(b"SFrame 1.0 Secret salt ", _NONCE_BYTES))


def encode_header(key_id: int, counter: int) -> bytes:
    """Return the header's bytes, 1 to 17, each number in the least bytes (RFC 9605 4.3)."""
    config, tails = 0, b""
    for number in (key_id, counter):
        tail = b"" if number < 8 else number.to_bytes((number.bit_length() + 7) // 8)
        config = config << 4 | (7 + len(tail) if tail else number)
        tails += tail
    return bytes([config]) + tails


def decode_header(sealed: bytes) -> tuple[int, int, int]:
    """Return key id and counter of a sealed payload, and how many bytes its header takes.

    Raises:
        SealError: It is cut off, or a number takes more bytes than it needs.
    """
    numbers, end = list[int](), 1
    for bits in (sealed[0] >> 4, sealed[0] & 15) if sealed else ():
        begin, end = end, end + max(bits - 7, 0)
        numbers.append(bits if bits < 8 else int.from_bytes(sealed[begin:end]))
    if not numbers or encode_header(*numbers) != sealed[:end]:
        raise SealError(f"no header in a payload of {len(sealed)} bytes")
    return numbers[0], numbers[1], end


def seal(payload: bytes, metadata: bytes, key: FrameKey, counter: int) -> bytes:
    """Encrypt a payload and authenticate it together with its metadata, which is not carried.

    The counter must never be the same twice with one key: two payloads under one nonce give away
    their difference, and the means to forge.
    """
    header = encode_header(key.key_id, counter)
    return header + key.cipher.encrypt(key.nonce(counter), payload, header + metadata)


def open_(sealed: bytes, metadata: bytes, key: FrameKey) -> bytes:
    """Return the payload that a sender with the same key sealed with the same metadata.

    Raises:
        SealError: Another key, other metadata, or a bit that is not as it was.
    """
    key_id, counter, start = decode_header(sealed)
    if key_id != key.key_id:
        raise SealError(f"sealed with key {key_id}, not {key.key_id}")
    associated = sealed[:start] + metadata
    try:
        return key.cipher.decrypt(key.nonce(counter), sealed[start:], associated)
    except InvalidTag:
        raise SealError("the tag does not fit") from None


def pad(face: bytes) -> bytes:
    """Return a face padded to the one size, or its next multiple: the face, the byte 80, zeros."""
    marked = face + _PADDING_MARK
    return marked + bytes(-len(marked) % FACE_BYTES)


def unpad(padded: bytes) -> bytes:
    """Return the face that was padded.

    Raises:
        SealError: It is not padded.
    """
    face = padded.rstrip(b"\0")
    if not face.endswith(_PADDING_MARK):
        raise SealError("a face without the mark of its padding")
    return face[:-1]


class ReplayWindow:
    """Lets every counter through once, in any order within the window."""

    def __init__(self, first: int = 0) -> None:
        """Begin with a counter; whatever is below it counts as seen."""
        self._highest = first - 1
        self._seen = (1 << WINDOW) - 1  # bit i: counter highest - i

    def is_new(self, counter: int) -> bool:
        """Return True if this counter has not been seen, as far as that can be told."""
        age = self._highest - counter
        return age < 0 or (age < WINDOW and not self._seen >> age & 1)

    def mark(self, counter: int) -> None:
        """Remember a counter that `is_new`, once its frame has opened: a forgery uses up none."""
        ahead = counter - self._highest
        if ahead > 0:
            shifted = self._seen << ahead if ahead < WINDOW else 0
            self._seen = (shifted | 1) & ((1 << WINDOW) - 1)
            self._highest = counter
        else:
            self._seen |= 1 << -ahead
