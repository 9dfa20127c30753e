"""The bytes shown in ``docs/privacy.md`` are those that the code makes: once published, for ever.

These known answers are our own: RFC 9605 has none for our metadata, and none for notes. Those of
the RFC stand in ``test_seal_frames.py``.
"""

from __future__ import annotations

import pytest

from helpers.paths import ROOT

pytest.importorskip("cryptography", reason="needs the extra seal")

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from pica_client.e2ee.description import describe
from pica_client.e2ee.frames import derive_key, metadata_of, open_, seal
from pica_client.e2ee.notes import (
    Note,
    RoomKeys,
    agree,
    decode_note,
    encode_note,
    fingerprint,
)
from pica_client.e2ee.secret import RoomSecret
from pica_client.e2ee.status import SealStatus
from pica_client.e2ee.suites import (
    AES_128_CTR_HMAC_SHA256_64,
    AES_128_GCM_SHA256_128,
    Suite,
)
from pica_protocol.frames import Frame
from pica_protocol.messages import Track

pytestmark = pytest.mark.unit

PAGE = ROOT / "docs" / "privacy.md"
BASE_KEY = bytes(range(16))
GENERATION = 9
FRAME = Frame(
    stream=1,
    sequence=65535,
    captured_us=1_700_000_000_000_000,
    payload=b"opaque",
    is_keyframe=True,
)
METADATA = "0001ffff000100060a24181e4000"
SEALED = {
    AES_128_GCM_SHA256_128: "19012c1beedb2459b08c5cd89641a731bd42580d65cec435f0",
    AES_128_CTR_HMAC_SHA256_64: "19012c334c05363f31c7e123519e493a1b",
}
DESCRIPTION = describe(
    "lobby", "Ada", (Track(kind="face", stream=1, avatar="0f" * 32), Track(kind="wave", stream=2))
)
SECRET = RoomSecret(bytes(range(32)))
NOTE = (
    "02030004a4e09292b651c278b9772c569f5fa9bb13d906b46ab68c9df9dc2b4409f8a209cfa570c6"
    "53bd212b00000002000000090000012c92cb2f0b4a1c4359c6063ee22cd889267f038339d932bed2"
    "c1185c25ae49ffb480dd866156072aac7708c2db9052f95b0c8adea5ee182e21d3a08de21d9f5ae2"
    "76256ec3ca4eba173bf41daf9bd1d602"
)
CODE = "97513 30510 50857 93817 52284 62141"


def spaced(data: str) -> str:
    """As the page shows bytes: in pairs, 24 to a line."""
    pairs = [data[i : i + 2] for i in range(0, len(data), 2)]
    return "\n".join(" ".join(pairs[i : i + 24]) for i in range(0, len(pairs), 24))


@pytest.mark.parametrize("suite", SEALED, ids=lambda suite: suite.name)
def test_a_frame_is_sealed_as_the_page_shows(suite: Suite) -> None:
    key = derive_key(BASE_KEY, GENERATION % 8, suite)
    metadata = metadata_of(FRAME)
    assert metadata.hex() == METADATA
    assert seal(FRAME.payload, metadata, key, 300).hex() == SEALED[suite]
    assert open_(bytes.fromhex(SEALED[suite]), metadata, key) == FRAME.payload
    assert spaced(SEALED[suite]) in PAGE.read_text()
    assert spaced(METADATA) in PAGE.read_text()


def test_a_note_is_written_as_the_page_shows() -> None:
    ada, ben = (X25519PrivateKey.from_private_bytes(bytes([i] * 32)) for i in (1, 2))
    ada_key, ben_key = (each.public_key().public_bytes_raw() for each in (ada, ben))
    keys = RoomKeys.of(SECRET, "lobby")
    wrap, _ = agree(ada, ada_key, ben_key, keys.pair_salt)
    note = Note(
        public_key=ada_key,
        description=DESCRIPTION,
        echo=fingerprint(ben_key),
        acknowledged=2,
        wants_answer=True,
        generation=GENERATION,
        first=300,
        suite=AES_128_GCM_SHA256_128.number,
        wrapped_key=wrap.wrap(BASE_KEY, GENERATION, AES_128_GCM_SHA256_128.number),
    )
    assert encode_note(note, keys.note_key, "p1", "p2").hex() == NOTE
    assert decode_note(bytes.fromhex(NOTE), keys.note_key, "p1", "p2") == note
    _, unwrap = agree(ben, ben_key, ada_key, keys.pair_salt)
    assert unwrap.unwrap(note.wrapped_key, GENERATION, note.suite) == BASE_KEY
    assert spaced(NOTE) in PAGE.read_text()


def test_the_code_is_made_as_the_page_shows() -> None:
    ada, ben = (
        X25519PrivateKey.from_private_bytes(bytes([i] * 32)).public_key().public_bytes_raw()
        for i in (1, 2)
    )
    members = ((ada, DESCRIPTION), (ben, describe("lobby", "Ben", ())))
    assert SealStatus(room="lobby", members=members).code == CODE
    assert SealStatus(room="lobby", members=members[::-1]).code == CODE
    assert SealStatus(room="lobby", members=members[:1]).code == ""
    assert CODE in PAGE.read_text()
    assert spaced(DESCRIPTION.hex()) in PAGE.read_text()
