"""The sub-protocol of uploads: what is refused."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_protocol.codec import MAX_CHUNK_BYTES, decode_chunk, encode_chunk
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.limits import is_avatar_id
from pica_protocol.messages import Offer

pytestmark = pytest.mark.unit

ID = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"


@given(st.binary(max_size=200))
def test_any_bytes_are_a_chunk_or_refused(data: bytes) -> None:
    with contextlib.suppress(RemoteProtocolError):
        assert encode_chunk(decode_chunk(data)) == data


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
