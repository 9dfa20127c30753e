"""Bytes shown in ``docs/privacy.md`` are those that the code makes, and of messages about keys
nothing is believed but what a member wrote, to us, in this room.

The known answers of RFC 9605 stand in ``test_frames.py``.
"""

import pytest

from helpers.paths import ROOT

pytest.importorskip("cryptography", reason="needs the extra seal")

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from pica_client.e2ee.frames import derive_key, open_, pad, seal
from pica_client.e2ee.peer_keys import KeyMessage, agree, decode, describe, encode, room_key, unwrap
from pica_client.e2ee.secret import RoomSecret, SealStatus
from pica_client.errors import SealError
from pica_protocol.frames import Frame, clear_header
from pica_protocol.messages import Track

pytestmark = pytest.mark.unit

PAGE = (ROOT / "docs" / "privacy.md").read_text()
BASE_KEY = bytes(range(16))
SECRET = RoomSecret(bytes(range(32)))
WAY = ("p1", "p2")
GENERATION = 9
FRAME = Frame(stream=1, sequence=65535, captured_us=123_456_700, payload=b"opaque")
METADATA = "0001ffff96b43800"
SEALED = (
    "19012c1beedb2459b0a64d5b7e054a51a8b267de540dfb41b944552d5d5c042a7e9de2f11981dcbb"
    "f8c29877ff57baec0b10c335b1581797b387cd64739f57074066ad"
)
DESCRIPTION = describe(
    "lobby", "Ada", (Track(kind="face", stream=1, avatar="0f" * 32), Track(kind="wave", stream=2))
)
DATA = bytes.fromhex(
    "01a4e09292b651c278b9772c569f5fa9bb13d906b46ab68c9df9dc2b4409f8a20900010203040506"
    "0708090a0b0c0d0e0f00000002000000090000012c675496ebb5d7f60d4f81a410d0355cc084c006"
    "945791b386078411ca80c5722201709fe56e1c6813d7a1e899b1e494f126e7a6824ff4e9f8f70da8"
    "4d95907733a94276495370fd306926ed6005151176"
)
CODE = "39938 03847 02446 04440 16041 35193"
ADA, BEN = (X25519PrivateKey.from_private_bytes(bytes([i] * 32)) for i in (1, 2))
ADA_KEY, BEN_KEY = (each.public_key().public_bytes_raw() for each in (ADA, BEN))
CODE_KEY, SALT = (room_key(SECRET, "lobby", purpose) for purpose in (b"code", b"pair"))
PAIR_KEY = agree(ADA, BEN_KEY, SALT)
MESSAGE = KeyMessage(
    wants_answer=True,
    public_key=ADA_KEY,
    challenge=bytes(range(8)),
    echo=bytes(range(8, 16)),
    acknowledged=2,
    generation=GENERATION,
    first=300,
    description=DESCRIPTION,
)


def grouped(data: str) -> str:
    """Return hex digits as the page shows them: four bytes to a group, eight groups to a line."""
    return "\n".join(
        " ".join(data[start + i : start + i + 8] for i in range(0, 64, 8)).rstrip()
        for start in range(0, len(data), 64)
    )


def test_a_face_is_sealed_as_the_page_shows() -> None:
    key, metadata = derive_key(BASE_KEY, GENERATION % 8), clear_header(FRAME)
    assert metadata.hex() == METADATA
    assert seal(pad(FRAME.payload), metadata, key, 300).hex() == SEALED
    assert open_(bytes.fromhex(SEALED), metadata, key) == pad(FRAME.payload)
    assert grouped(SEALED) in PAGE
    assert grouped(METADATA) in PAGE


def test_a_key_message_is_written_as_the_page_shows() -> None:
    assert encode(MESSAGE, CODE_KEY, WAY, PAIR_KEY, BASE_KEY) == DATA
    assert decode(DATA, CODE_KEY, WAY) == MESSAGE
    assert unwrap(DATA, WAY, agree(BEN, ADA_KEY, SALT)) == BASE_KEY
    assert grouped(DATA.hex()) in PAGE


def test_the_code_is_made_as_the_page_shows() -> None:
    members = ((ADA_KEY, DESCRIPTION), (BEN_KEY, describe("lobby", "Ben", ())))
    assert SealStatus(room="lobby", members=members).code == CODE
    assert SealStatus(room="lobby", members=members[::-1]).code == CODE
    assert SealStatus(room="lobby", members=members[:1]).code == ""
    assert CODE in PAGE
    assert grouped(DESCRIPTION.hex()) in PAGE


def test_a_message_is_for_one_receiver_from_one_sender_in_one_room() -> None:
    for way in (("p2", "p1"), ("p1", "p3"), ("p3", "p2"), ("p1p", "2")):
        assert decode(DATA, CODE_KEY, way) is None
    assert decode(DATA, room_key(SECRET, "hall", b"code"), WAY) is None


def test_no_flipped_bit_is_believed() -> None:
    for place in range(len(DATA) * 8):
        flipped = bytearray(DATA)
        flipped[place // 8] ^= 1 << place % 8
        assert decode(bytes(flipped), CODE_KEY, WAY) is None


def test_a_wrapped_key_does_not_unwrap_in_another_message_even_of_a_member() -> None:
    for changed in ({"first": 0}, {"generation": 4}, {"echo": b"12345678"}):
        forged = encode(MESSAGE._replace(**changed), CODE_KEY, WAY, bytes(31) + b"x", BASE_KEY)
        wrapped = slice(93, 125)
        moved = forged[: wrapped.start] + DATA[wrapped] + forged[wrapped.stop :]
        with pytest.raises(SealError, match="wrapped for another peer"):
            unwrap(moved, WAY, PAIR_KEY)


def test_a_public_key_of_small_order_is_refused() -> None:
    with pytest.raises(SealError, match="agrees on nothing"):
        agree(X25519PrivateKey.from_private_bytes(bytes(32)), bytes(32), b"salt")
