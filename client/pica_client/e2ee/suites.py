"""The cipher suites: authenticated encryption with the names and numbers of RFC 9605.

Two kinds. AES-GCM always has its full tag of 16 bytes here. A GCM tag cut short is weaker than its
length: every forgery that succeeds tells something about the hash key, after which more succeed,
and NIST SP 800-38D (appendix C) ties tags of 64 bits to limits on lengths and on failed attempts.
RFC 9605 registers no such suite either. AES in counter mode with a truncated HMAC has no such
weakness: a forger of 64 bits guesses, once in 2^64 tries, and learns nothing from it. Where bytes
matter, that is the suite to take.
"""

import hmac
from dataclasses import dataclass
from typing import Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers import Cipher as BlockCipher
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.ciphers.modes import CTR

from pica_client.e2ee.errors import ForgedFrameError

NONCE_BYTES: Final = 12
_AES_KEY_BYTES: Final = 16


class GcmAead:
    """AES-GCM with a tag of 16 bytes."""

    def __init__(self, key: bytes, tag_bytes: int) -> None:
        self._cipher = AESGCM(key)

    def encrypt(self, nonce: bytes, data: bytes, associated: bytes) -> bytes:
        """Return the encrypted data with the tag behind it."""
        return self._cipher.encrypt(nonce, data, associated)

    def decrypt(self, nonce: bytes, data: bytes, associated: bytes) -> bytes:
        """Return the plain data, or raise `ForgedFrameError` if the tag does not fit."""
        try:
            return self._cipher.decrypt(nonce, data, associated)
        except InvalidTag:
            raise ForgedFrameError("the tag does not fit") from None


class CtrHmacAead:
    """AES in counter mode, then HMAC-SHA256 cut to the tag's length (RFC 9605 4.5.1)."""

    def __init__(self, key: bytes, tag_bytes: int) -> None:
        self._cipher_key, self._tag_key = AES(key[:_AES_KEY_BYTES]), key[_AES_KEY_BYTES:]
        self._tag_bytes = tag_bytes

    def encrypt(self, nonce: bytes, data: bytes, associated: bytes) -> bytes:
        """Return the encrypted data with the tag behind it."""
        encrypted = self._apply_keystream(nonce, data)
        return encrypted + self._tag(nonce, encrypted, associated)

    def decrypt(self, nonce: bytes, data: bytes, associated: bytes) -> bytes:
        """Return the plain data, or raise `ForgedFrameError` if the tag does not fit."""
        encrypted, tag = data[: -self._tag_bytes], data[-self._tag_bytes :]
        if not hmac.compare_digest(tag, self._tag(nonce, encrypted, associated)):
            raise ForgedFrameError("the tag does not fit")
        return self._apply_keystream(nonce, encrypted)

    def _apply_keystream(self, nonce: bytes, data: bytes) -> bytes:
        cipher = BlockCipher(self._cipher_key, CTR(nonce + bytes(4))).encryptor()
        return cipher.update(data) + cipher.finalize()

    def _tag(self, nonce: bytes, encrypted: bytes, associated: bytes) -> bytes:
        lengths = (len(associated), len(encrypted), self._tag_bytes)
        message = b"".join(length.to_bytes(8) for length in lengths)
        message += nonce + associated + encrypted
        return hmac.digest(self._tag_key, message, "sha256")[: self._tag_bytes]


Aead = GcmAead | CtrHmacAead
"""Authenticated encryption under one key."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Suite:
    """One row of the registry of RFC 9605 (8.1)."""

    number: int
    """The suite's number as registered; keys are derived with it and announced with it."""
    name: str
    key_bytes: int
    tag_bytes: int
    aead: type[GcmAead] | type[CtrHmacAead]


AES_128_GCM_SHA256_128: Final = Suite(
    number=4, name="AES_128_GCM_SHA256_128", key_bytes=16, tag_bytes=16, aead=GcmAead
)
AES_128_CTR_HMAC_SHA256_80: Final = Suite(
    number=1, name="AES_128_CTR_HMAC_SHA256_80", key_bytes=48, tag_bytes=10, aead=CtrHmacAead
)
AES_128_CTR_HMAC_SHA256_64: Final = Suite(
    number=2, name="AES_128_CTR_HMAC_SHA256_64", key_bytes=48, tag_bytes=8, aead=CtrHmacAead
)

SUITES: Final = {
    suite.number: suite
    for suite in (AES_128_GCM_SHA256_128, AES_128_CTR_HMAC_SHA256_80, AES_128_CTR_HMAC_SHA256_64)
}
"""What we seal and open with. The suite with 32 bits is left out: at a million guesses a second a
forgery would succeed about once in an hour (RFC 9605 7.5)."""
