"""Sealed payloads: the bytes of RFC 9605, and that nothing but the right bytes opens.

The known answers are those of RFC 9605: headers of appendix C.1, and of appendix C.3 the case with
cipher suite 4, AES_128_GCM_SHA256_128.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("cryptography", reason="needs the extra seal")

from pica_client.e2ee.frames import (
    FACE_BYTES,
    TAG_BYTES,
    WINDOW,
    ReplayWindow,
    decode_header,
    derive_key,
    encode_header,
    open_,
    pad,
    seal,
    unpad,
)
from pica_client.errors import SealError
from pica_protocol.frames import Frame, clear_header

pytestmark = pytest.mark.unit

BASE_KEY = bytes(range(16))
PLAIN = bytes.fromhex("64726166742d696574662d736672616d652d656e63")
METADATA = bytes.fromhex("4945544620534672616d65205747")
SEALED = "9901234567b7412c2513a1b66dbb48841bbaf17f598751176ad847681a69c6d0b091c07018ce4adb34eb"
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
FRAME = Frame(stream=7, sequence=65535, captured_us=123456789, payload=b"")


def test_payloads_are_sealed_as_the_rfc_shows() -> None:
    key = derive_key(BASE_KEY, 0x123)
    assert key.salt.hex() == "75234edefe07819026751816"
    assert key.nonce(0x4567).hex() == "75234edefe07819026755d71"
    assert seal(PLAIN, METADATA, key, 0x4567).hex() == SEALED
    assert open_(bytes.fromhex(SEALED), METADATA, key) == PLAIN


@pytest.mark.parametrize(("numbers", "encoded"), HEADERS.items(), ids=str)
def test_headers_are_encoded_as_the_rfc_shows(numbers: tuple[int, int], encoded: str) -> None:
    assert encode_header(*numbers).hex() == encoded
    assert decode_header(bytes.fromhex(encoded) + b"rest") == (*numbers, len(encoded) // 2)


@given(st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1))
def test_every_header_comes_back_and_none_that_was_cut(key_id: int, counter: int) -> None:
    encoded = encode_header(key_id, counter)
    assert decode_header(encoded) == (key_id, counter, len(encoded))
    for end in range(len(encoded)):
        with pytest.raises(SealError):
            decode_header(encoded[:end])


@pytest.mark.parametrize("encoded", ["0807", "090007", "0900ff", "8007", "900007"])
def test_a_number_in_more_bytes_than_it_needs_is_refused(encoded: str) -> None:
    with pytest.raises(SealError, match="no header"):
        decode_header(bytes.fromhex(encoded))


@given(st.binary(max_size=64), st.binary(max_size=32), st.integers(0, 2**16 - 1))
def test_what_was_sealed_opens_and_costs_nineteen_bytes_at_most(
    payload: bytes, metadata: bytes, counter: int
) -> None:
    key = derive_key(BASE_KEY, 5)
    sealed = seal(payload, metadata, key, counter)
    assert open_(sealed, metadata, key) == payload
    assert len(payload) + TAG_BYTES < len(sealed) <= len(payload) + 3 + TAG_BYTES


def test_no_flipped_bit_opens() -> None:
    key, metadata = derive_key(BASE_KEY, 5), clear_header(FRAME)
    sealed = seal(b"a face", metadata, key, 70_000)
    for place in range((len(sealed) + len(metadata)) * 8):
        flipped = bytearray(sealed + metadata)
        flipped[place // 8] ^= 1 << place % 8
        with pytest.raises(SealError):
            open_(bytes(flipped[: len(sealed)]), bytes(flipped[len(sealed) :]), key)


def test_nothing_opens_that_was_cut_or_lengthened() -> None:
    key = derive_key(BASE_KEY, 5)
    sealed = seal(b"a face", METADATA, key, 300)
    for other in [sealed[:end] for end in range(len(sealed))] + [sealed + b"\0"]:
        with pytest.raises(SealError):
            open_(other, METADATA, key)


def test_another_key_or_key_id_does_not_open() -> None:
    sealed = seal(PLAIN, METADATA, derive_key(BASE_KEY, 1), 9)
    for other in (derive_key(BASE_KEY, 2), derive_key(bytes(16), 1)):
        with pytest.raises(SealError):
            open_(sealed, METADATA, other)


def test_a_key_does_not_print_itself() -> None:
    assert repr(derive_key(BASE_KEY, 3)) == "FrameKey(key_id=3)"


@given(st.binary(max_size=3 * FACE_BYTES))
def test_a_padded_face_comes_back_from_one_size_or_its_multiple(face: bytes) -> None:
    padded = pad(face)
    assert unpad(padded) == face
    assert len(padded) == FACE_BYTES * (1 + len(face) // FACE_BYTES)


@pytest.mark.parametrize("padded", [b"", b"\0\0", b"a face", b"a face\0"])
def test_what_has_no_mark_was_not_padded(padded: bytes) -> None:
    with pytest.raises(SealError, match="without the mark"):
        unpad(padded)


@given(st.lists(st.integers(0, 3 * WINDOW), max_size=200))
def test_a_counter_passes_once_in_any_order_within_the_window(counters: list[int]) -> None:
    window, seen = ReplayWindow(), set[int]()
    for counter in counters:
        is_new = counter not in seen and counter > max(seen, default=-1) - WINDOW
        assert window.is_new(counter) == is_new
        if is_new:
            window.mark(counter)
            seen.add(counter)
