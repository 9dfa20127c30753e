"""One payload sealed, and opened again. Pure: keys and counters are arguments.

    sealed = header | encrypted payload | tag
    header = config byte | key id, 0 to 8 bytes | counter, 0 to 8 bytes      (RFC 9605 4.3)

    config byte   bit 7     the key id follows in (bits 6..4) + 1 bytes; else bits 6..4 are it
                  bit 3     the counter follows in (bits 2..0) + 1 bytes; else bits 2..0 are it

The tag covers the header and the *metadata*: the fields of the media header that travel in the
clear. Who moves a payload to another stream, sequence number, layer or time breaks it.
"""

import struct
from dataclasses import dataclass
from typing import Final

from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pica_client.e2ee.errors import ForgedFrameError, MalformedFrameError
from pica_client.e2ee.suites import NONCE_BYTES, Aead, Suite
from pica_protocol.frames import FLAG_KEYFRAME, Frame

MAX_NUMBER: Final = 2**64 - 1
"""The largest key id or counter that a header can carry."""

_METADATA = struct.Struct(">HHBBQ")


@dataclass(frozen=True, slots=True)
class SealHeader:
    """What stands in front of a sealed payload."""

    key_id: int
    counter: int


@dataclass(frozen=True, slots=True)
class FrameKey:
    """A key ready for use; its parts never leave this process."""

    key_id: int
    suite: Suite
    aead: Aead
    salt: bytes

    def __repr__(self) -> str:
        return f"FrameKey(key_id={self.key_id}, suite={self.suite.name})"

    def nonce(self, counter: int) -> bytes:
        """Return the nonce of one frame: salt xor counter (RFC 9605 4.4.3)."""
        return (int.from_bytes(self.salt) ^ counter).to_bytes(NONCE_BYTES)


def derive_key(base_key: bytes, key_id: int, suite: Suite) -> FrameKey:
    """Derive key and salt from a sender's base key (RFC 9605 4.4.2)."""
    suffix = key_id.to_bytes(8) + suite.number.to_bytes(2)

    def expand(label: bytes, length: int) -> bytes:
        return HKDF(SHA256(), length, salt=b"", info=label + suffix).derive(base_key)

    key = expand(b"SFrame 1.0 Secret key ", suite.key_bytes)
    salt = expand(b"SFrame 1.0 Secret salt ", NONCE_BYTES)
    return FrameKey(key_id, suite, suite.aead(key, suite.tag_bytes), salt)


def encode_header(header: SealHeader) -> bytes:
    """Return the header's bytes: 1 to 17."""
    key_bits, key_tail = _encode_number("key id", header.key_id)
    counter_bits, counter_tail = _encode_number("counter", header.counter)
    return bytes([key_bits << 4 | counter_bits]) + key_tail + counter_tail


def decode_header(sealed: bytes) -> tuple[SealHeader, int]:
    """Return the header of a sealed payload, and how many bytes it takes.

    Raises:
        MalformedFrameError: It is cut off, or a number takes more bytes than it needs.
    """
    if not sealed:
        raise MalformedFrameError("an empty payload is not sealed")
    key_id, end = _decode_number(sealed, sealed[0] >> 4, 1)
    counter, end = _decode_number(sealed, sealed[0] & 15, end)
    return SealHeader(key_id, counter), end


def metadata_of(frame: Frame) -> bytes:
    """Return what the tag covers of a frame's clear header: 14 bytes that do not travel again.

    The length is left out: a payload of another length does not open anyway.
    """
    flags = FLAG_KEYFRAME if frame.is_keyframe else 0
    return _METADATA.pack(frame.stream, frame.sequence, frame.layer, flags, frame.captured_us)


def seal(payload: bytes, metadata: bytes, key: FrameKey, counter: int) -> bytes:
    """Encrypt a payload and authenticate it together with its metadata.

    Args:
        metadata: Authenticated, not carried; see `metadata_of`.
        counter: Never the same twice with one key: two payloads under one nonce give away their
            difference and, with AES-GCM, the means to forge.
    """
    header = encode_header(SealHeader(key.key_id, counter))
    return header + key.aead.encrypt(key.nonce(counter), payload, header + metadata)


def open_(sealed: bytes, metadata: bytes, key: FrameKey) -> bytes:
    """Return the payload that a sender with the same key sealed with the same metadata.

    Raises:
        MalformedFrameError: Cut off, or no header.
        ForgedFrameError: Another key, other metadata, or a bit that is not as it was.
    """
    header, start = decode_header(sealed)
    if len(sealed) - start < key.suite.tag_bytes:
        raise MalformedFrameError(f"a sealed payload of {len(sealed)} bytes has no room for a tag")
    if header.key_id != key.key_id:
        raise ForgedFrameError(f"sealed with key {header.key_id}, not {key.key_id}")
    associated = sealed[:start] + metadata
    return key.aead.decrypt(key.nonce(header.counter), sealed[start:], associated)


def _encode_number(name: str, value: int) -> tuple[int, bytes]:
    """Four bits for the config byte, and what follows it."""
    if not 0 <= value <= MAX_NUMBER:
        raise ValueError(f"{name} must be in 0..{MAX_NUMBER}, got {value}")
    if value < 8:
        return value, b""
    length = (value.bit_length() + 7) // 8
    return 8 | (length - 1), value.to_bytes(length)


def _decode_number(data: bytes, bits: int, start: int) -> tuple[int, int]:
    if bits < 8:
        return bits, start
    end = start + (bits & 7) + 1
    if end > len(data):
        raise MalformedFrameError(f"header cut off after {len(data)} bytes")
    value = int.from_bytes(data[start:end])
    # One value, one encoding: the least number of bytes (RFC 9605 4.3).
    if value < 8 or value.bit_length() <= (end - start - 1) * 8:
        raise MalformedFrameError(f"{value} encoded in {end - start} bytes")
    return value, end
