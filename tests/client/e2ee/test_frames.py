"""Sealed payloads: the bytes of RFC 9605, and that nothing but the right bytes opens.

The known answers are those that RFC 9605 publishes in appendix C, for the suites we use.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("cryptography", reason="needs the extra seal")

from pica_client.e2ee.errors import ForgedFrameError, MalformedFrameError, OpenError
from pica_client.e2ee.frames import (
    SealHeader,
    decode_header,
    derive_key,
    encode_header,
    metadata_of,
    open_,
    seal,
)
from pica_client.e2ee.peer_keys import WINDOW, ReplayWindow
from pica_client.e2ee.suites import (
    AES_128_CTR_HMAC_SHA256_64,
    AES_128_CTR_HMAC_SHA256_80,
    AES_128_GCM_SHA256_128,
    SUITES,
    CtrHmacAead,
    Suite,
)
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit

BASE_KEY = bytes(range(16))
PLAIN = bytes.fromhex("64726166742d696574662d736672616d652d656e63")
METADATA = bytes.fromhex("4945544620534672616d65205747")
SEALED = {
    AES_128_CTR_HMAC_SHA256_80: (
        "9901234567449408b6f490086165b9d6f62b24ae1a59a56486b4ae8ed036b88912e24f11"
    ),
    AES_128_CTR_HMAC_SHA256_64: (
        "99012345673f31438db4d09434e43afa0f8a2f00867a2be085046a9f5cb4f101d607"
    ),
    AES_128_GCM_SHA256_128: (
        "9901234567b7412c2513a1b66dbb48841bbaf17f598751176ad847681a69c6d0b091c07018ce4adb34eb"
    ),
}
SALTS = {
    AES_128_CTR_HMAC_SHA256_80: "50b29329a04dc0f184ac3168",
    AES_128_CTR_HMAC_SHA256_64: "e68ac8dd3d02fbcd368c5577",
    AES_128_GCM_SHA256_128: "75234edefe07819026751816",
}
HEADERS = {
    (0, 0): "00",
    (0, 1): "01",
    (0, 255): "08ff",
    (0, 256): "090100",
    (0, 65536): "0a010000",
    (1, 65535): "19ffff",
    (255, 0): "80ff",
    (255, 255): "88ffff",
    (256, 1): "910100",
    (65535, 16777216): "9bffff01000000",
    (4294967296, 0): "c00100000000",
    (72057594037927936, 256): "f901000000000000000100",
    (2**64 - 1, 2**64 - 1): "ff" * 17,
}
FRAME = Frame(stream=7, sequence=65535, captured_us=123456789, payload=b"", layer=2)

every_suite = pytest.mark.parametrize("suite", SUITES.values(), ids=lambda suite: suite.name)
suites = st.sampled_from(list(SUITES.values()))


@every_suite
def test_payloads_are_sealed_as_the_rfc_shows(suite: Suite) -> None:
    key = derive_key(BASE_KEY, 0x123, suite)
    assert key.salt.hex() == SALTS[suite]
    sealed = seal(PLAIN, METADATA, key, 0x4567)
    assert sealed.hex() == SEALED[suite]
    assert open_(sealed, METADATA, key) == PLAIN


@pytest.mark.parametrize(
    ("suite", "encrypted"),
    [
        (
            AES_128_CTR_HMAC_SHA256_80,
            "6339af04ada1d064688a442b8dc69d5b6bfa40f4bef0583e8081069cc60705",
        ),
        (AES_128_CTR_HMAC_SHA256_64, "6339af04ada1d064688a442b8dc69d5b6bfa40f4be6e93b7da076927bb"),
    ],
    ids=["80", "64"],
)
def test_counter_mode_with_hmac_is_that_of_the_rfc(suite: Suite, encrypted: str) -> None:
    aead = CtrHmacAead(bytes(range(48)), suite.tag_bytes)
    nonce = bytes(range(16, 28))
    assert aead.encrypt(nonce, PLAIN, METADATA).hex() == encrypted


@pytest.mark.parametrize(("numbers", "encoded"), HEADERS.items(), ids=str)
def test_headers_are_encoded_as_the_rfc_shows(numbers: tuple[int, int], encoded: str) -> None:
    header = SealHeader(*numbers)
    assert encode_header(header).hex() == encoded
    assert decode_header(bytes.fromhex(encoded) + b"rest") == (header, len(encoded) // 2)


@given(st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1))
def test_every_header_comes_back(key_id: int, counter: int) -> None:
    header = SealHeader(key_id, counter)
    encoded = encode_header(header)
    assert decode_header(encoded) == (header, len(encoded))
    for end in range(len(encoded)):
        with pytest.raises(MalformedFrameError):
            decode_header(encoded[:end])


@pytest.mark.parametrize("encoded", ["0807", "090007", "0900ff", "8007", "900007"])
def test_a_number_in_more_bytes_than_it_needs_is_refused(encoded: str) -> None:
    with pytest.raises(MalformedFrameError, match="encoded in"):
        decode_header(bytes.fromhex(encoded))


@given(st.integers(max_value=-1) | st.integers(min_value=2**64))
def test_a_counter_that_no_header_carries_is_our_own_mistake(counter: int) -> None:
    with pytest.raises(ValueError, match="counter must be in"):
        encode_header(SealHeader(0, counter))


@given(suites, st.binary(max_size=64), st.binary(max_size=32), st.integers(0, 2**20))
def test_what_was_sealed_opens(suite: Suite, payload: bytes, metadata: bytes, counter: int) -> None:
    key = derive_key(BASE_KEY, 5, suite)
    sealed = seal(payload, metadata, key, counter)
    assert open_(sealed, metadata, key) == payload
    assert len(payload) + suite.tag_bytes < len(sealed) <= len(payload) + 17 + suite.tag_bytes


@every_suite
def test_no_flipped_bit_opens(suite: Suite) -> None:
    key = derive_key(BASE_KEY, 5, suite)
    metadata = metadata_of(FRAME)
    sealed = seal(b"a face", metadata, key, 70_000)
    for place in range(len(sealed) * 8):
        flipped = bytearray(sealed)
        flipped[place // 8] ^= 1 << place % 8
        with pytest.raises(OpenError):
            open_(bytes(flipped), metadata, key)
    for place in range(len(metadata) * 8):
        flipped = bytearray(metadata)
        flipped[place // 8] ^= 1 << place % 8
        with pytest.raises(ForgedFrameError):
            open_(sealed, bytes(flipped), key)


@every_suite
def test_nothing_opens_that_was_cut_or_lengthened(suite: Suite) -> None:
    key = derive_key(BASE_KEY, 5, suite)
    sealed = seal(b"a face", METADATA, key, 300)
    for other in [sealed[:end] for end in range(len(sealed))] + [sealed + b"\0"]:
        with pytest.raises(OpenError):
            open_(other, METADATA, key)


@given(suites, st.binary(max_size=100), st.binary(max_size=20))
def test_any_other_bytes_are_refused_with_a_reason(
    suite: Suite, data: bytes, metadata: bytes
) -> None:
    with pytest.raises(OpenError):
        open_(data, metadata, derive_key(BASE_KEY, 0, suite))


@every_suite
def test_a_key_opens_neither_with_another_number_nor_for_another_suite(suite: Suite) -> None:
    sealed = seal(PLAIN, METADATA, derive_key(BASE_KEY, 1, suite), 9)
    others = [derive_key(BASE_KEY, 2, suite), derive_key(bytes(16), 1, suite)]
    others += [derive_key(BASE_KEY, 1, other) for other in SUITES.values() if other is not suite]
    for other in others:
        with pytest.raises(OpenError):
            open_(sealed, METADATA, other)


def test_every_field_of_the_clear_header_is_covered() -> None:
    changed = [
        replace(FRAME, stream=8),
        replace(FRAME, sequence=0),
        replace(FRAME, captured_us=123456790),
        replace(FRAME, layer=1),
        replace(FRAME, is_keyframe=True),
    ]
    assert len({metadata_of(frame) for frame in [FRAME, *changed]}) == 6


def test_a_key_does_not_print_itself() -> None:
    key = derive_key(BASE_KEY, 3, AES_128_GCM_SHA256_128)
    assert repr(key) == "FrameKey(key_id=3, suite=AES_128_GCM_SHA256_128)"


def test_a_counter_passes_once_in_any_order() -> None:
    window = ReplayWindow()
    for counter in (3, 0, 2, 1500, 1400, 1):
        assert window.is_new(counter) == (counter != 1)  # 1 has left the window
        if window.is_new(counter):
            window.mark(counter)
    assert not any(window.is_new(counter) for counter in (0, 2, 3, 1400, 1500))
    assert window.is_new(1500 - WINDOW + 1)
    assert not window.is_new(1500 - WINDOW)


@given(st.lists(st.integers(0, 3 * WINDOW), max_size=200))
def test_the_window_agrees_with_a_plain_set(counters: list[int]) -> None:
    window, seen = ReplayWindow(), set[int]()
    for counter in counters:
        is_new = counter not in seen and counter > max(seen, default=-1) - WINDOW
        assert window.is_new(counter) == is_new
        if is_new:
            window.mark(counter)
            seen.add(counter)
