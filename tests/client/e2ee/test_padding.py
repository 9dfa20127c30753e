"""Payloads of a few sizes only."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("cryptography", reason="needs the extra seal")

from helpers.sealed_room import Room
from pica_client.e2ee.errors import MalformedFrameError
from pica_client.e2ee.padding import MAX_BUCKET, pad, parse_buckets, unpad
from pica_client.errors import OptionError
from pica_client.transport.config import LinkConfig
from pica_protocol.frames import MAX_PAYLOAD_BYTES, Frame

pytestmark = pytest.mark.unit

buckets = st.sets(st.integers(1, MAX_BUCKET), min_size=1, max_size=5).map(
    lambda sizes: tuple(sorted(sizes))
)


@given(st.binary(max_size=MAX_PAYLOAD_BYTES - 20), buckets)
def test_what_was_padded_comes_back_from_a_size_of_the_buckets(
    payload: bytes, sizes: tuple[int, ...]
) -> None:
    padded = pad(payload, sizes, MAX_PAYLOAD_BYTES - 19)
    assert unpad(padded) == payload
    assert len(padded) in sizes or len(padded) % sizes[-1] == 0 or len(padded) == 1165
    assert len(padded) <= 1165


@pytest.mark.parametrize("padded", [b"", b"\0\0", b"a face", b"a face\0"])
def test_what_has_no_mark_was_not_padded(padded: bytes) -> None:
    with pytest.raises(MalformedFrameError, match="without its mark"):
        unpad(padded)


def test_frames_of_a_padding_sender_have_one_size_and_open_as_they_were() -> None:
    room = Room()
    room.join("ada", pad_to=(32, 64))
    room.join("ben")
    room.run(2)
    payloads = [bytes([number]) * number for number in range(31)]
    sizes = {len(room.send("ada", payload).payload) - 32 for payload in payloads}
    assert sizes <= {17, 18}  # the counter takes a byte more from the eighth frame on
    assert [frame.payload for frame in room.members["ben"].frames] == payloads
    assert len(room.send("ben", b"short").payload) == 5 + 17
    assert room.members["ada"].frames[-1].payload == b"short"


def test_the_largest_payload_still_fits_a_frame() -> None:
    room = Room()
    ada = room.join("ada", pad_to=(1024,))
    room.join("ben")
    room.run(2)
    for size in (1023, 1024, 1164):
        plain = Frame(stream=1, sequence=0, captured_us=0, payload=bytes(size))
        sealed = Frame(stream=1, sequence=0, captured_us=0, payload=ada.guard.seal(plain))
        assert room.show("ben", sealed)
        assert room.members["ben"].frames[-1].payload == plain.payload


def test_bucket_sizes_are_read_and_refused_with_the_fix() -> None:
    assert parse_buckets("off") == ()
    assert parse_buckets("32,64,256") == (32, 64, 256)
    for text in ("", "on", "64,32", "32,32", "0", "-4", "32,", "2000", "32,2000"):
        with pytest.raises(OptionError, match="sizes in bytes that grow"):
            parse_buckets(text)


def test_padding_without_a_secret_is_refused() -> None:
    with pytest.raises(OptionError, match="it needs a secret-file"):
        LinkConfig(pad_to=(32,))
    assert LinkConfig(pad_to=(32,), secret_file=Path("s")).pad_to == (32,)
