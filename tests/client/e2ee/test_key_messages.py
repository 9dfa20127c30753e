"""Messages about keys: nothing but what a member wrote, to us, in this room, is believed."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("cryptography", reason="needs the extra seal")

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from helpers.sealed_room import SECRET
from pica_client.e2ee.peer_keys import (
    MESSAGE_BYTES,
    KeyMessage,
    agree,
    decode,
    encode,
    room_key,
    unwrap,
)
from pica_client.errors import SealError

pytestmark = pytest.mark.unit

CODE_KEY = room_key(SECRET, "r", b"code")
WAY = ("ada", "ben")
PAIR_KEY, BASE_KEY = bytes(32), bytes(range(16))
MESSAGE = KeyMessage(
    wants_answer=False,
    public_key=bytes(32),
    challenge=bytes(8),
    echo=bytes(8),
    acknowledged=0,
    generation=3,
    first=9,
    description=bytes(32),
)
DATA = encode(MESSAGE, CODE_KEY, WAY, PAIR_KEY, BASE_KEY)


def test_a_message_is_for_one_receiver_from_one_sender_in_one_room() -> None:
    assert decode(DATA, CODE_KEY, WAY) == MESSAGE
    for way in (("ben", "ada"), ("ada", "cho"), ("cho", "ben"), ("adab", "en")):
        assert decode(DATA, CODE_KEY, way) is None
    assert decode(DATA, room_key(SECRET, "s", b"code"), WAY) is None


@given(st.binary(max_size=160) | st.binary(min_size=MESSAGE_BYTES, max_size=MESSAGE_BYTES))
def test_any_bytes_are_refused(data: bytes) -> None:
    assert decode(data, CODE_KEY, WAY) is None


def test_no_flipped_bit_is_believed() -> None:
    for place in range(len(DATA) * 8):
        flipped = bytearray(DATA)
        flipped[place // 8] ^= 1 << place % 8
        assert decode(bytes(flipped), CODE_KEY, WAY) is None


def test_a_wrapped_key_does_not_unwrap_in_another_message_even_of_a_member() -> None:
    assert unwrap(DATA, WAY, PAIR_KEY) == BASE_KEY
    for changed in ({"first": 0}, {"generation": 4}, {"echo": b"12345678"}):
        forged = encode(MESSAGE._replace(**changed), CODE_KEY, WAY, bytes(31) + b"x", BASE_KEY)
        wrapped = slice(93, 125)
        moved = forged[: wrapped.start] + DATA[wrapped] + forged[wrapped.stop :]
        with pytest.raises(SealError, match="wrapped for another peer"):
            unwrap(moved, WAY, PAIR_KEY)


def test_a_public_key_of_small_order_is_refused() -> None:
    with pytest.raises(SealError, match="agrees on nothing"):
        agree(X25519PrivateKey.from_private_bytes(bytes(32)), bytes(32), b"salt")
