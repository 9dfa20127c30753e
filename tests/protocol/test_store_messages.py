"""The sub-protocol of uploads: its bytes, and what is refused."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from golden.wire_samples import CHUNK, GOLDEN, STORE_MESSAGES, store_bytes
from pica_protocol.codec import (
    MAX_CHUNK_BYTES,
    decode_chunk,
    decode_message,
    decode_store_message,
    encode_chunk,
    encode_message,
)
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.limits import is_avatar_id
from pica_protocol.messages import Leave, Offer

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())["store"]
ID = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"


@pytest.mark.parametrize("name", VECTORS)
def test_samples_are_the_golden_bytes_both_ways(name: str) -> None:
    data = bytes.fromhex(VECTORS[name])
    assert store_bytes()[name] == data
    if name == "chunk":
        assert decode_chunk(data) == CHUNK
    else:
        assert decode_store_message(data) == STORE_MESSAGES[name]


def test_the_golden_file_holds_every_sample() -> None:
    assert set(VECTORS) == set(store_bytes())


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_a_chunk_or_refused(data: bytes) -> None:
    for decode in (decode_store_message, decode_chunk):
        try:
            decode(data)
        except RemoteProtocolError:
            continue


def test_neither_sub_protocol_takes_the_messages_of_the_other() -> None:
    with pytest.raises(RemoteProtocolError, match="unknown message type 'leave'"):
        decode_store_message(encode_message(Leave()))
    with pytest.raises(RemoteProtocolError, match="unknown message type 'offer'"):
        decode_message(encode_message(Offer(sha256=ID, size=1)))


@pytest.mark.parametrize(
    "text",
    ["", ID[:-1], ID + "0", ID.upper(), ID[:-1] + "/", "../" + ID[3:], ID + "\n", ID[:-1] + "\x00"],
)
def test_only_64_lower_case_hexadecimal_digits_are_an_id(text: str) -> None:
    assert is_avatar_id(ID)
    assert not is_avatar_id(text)
    with pytest.raises(ValueError, match=r"offer\.sha256 must"):
        Offer(sha256=text, size=1)


@pytest.mark.parametrize("size", [0, -1, 2**41])
def test_an_offer_of_no_size_or_an_absurd_one_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=r"offer\.size must be in 1\.\."):
        Offer(sha256=ID, size=size)


@pytest.mark.parametrize("size", [0, MAX_CHUNK_BYTES + 1])
def test_a_chunk_has_a_size_that_fits_one_message(size: int) -> None:
    with pytest.raises(ValueError, match=r"a chunk has 1\.\."):
        encode_chunk(bytes(size))
    with pytest.raises(RemoteProtocolError, match="a chunk of"):
        decode_chunk(b"\x03" + bytes(size))
