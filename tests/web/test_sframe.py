"""The page seals and opens as Python does, and says the same of a peer."""

import base64
import os

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from helpers.page import Page, PageError
from pica_client.e2ee import frames, peer_keys
from pica_protocol.frames import Frame, clear_header
from pica_protocol.messages import Track

pytestmark = pytest.mark.unit

BASE_KEY = bytes(range(16))
HERE = settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])


def _asked(frame: Frame, payload: bytes) -> dict[str, object]:
    return {
        "stream": frame.stream,
        "sequence": frame.sequence,
        "capturedUs": frame.captured_us,
        "payload": payload,
    }


@HERE
@given(
    payload=st.binary(max_size=200),
    counter=st.integers(0, 2**32),
    generation=st.integers(0, 7),
    is_face=st.booleans(),
    captured_us=st.integers(0, 2**50),
)
def test_each_opens_what_the_other_seals(
    page: Page, payload: bytes, counter: int, generation: int, is_face: bool, captured_us: int
) -> None:
    frame = Frame(stream=3, sequence=65_535, captured_us=captured_us, payload=payload)
    key = frames.derive_key(BASE_KEY, generation)
    padded = frames.pad(payload) if is_face else payload
    sealed = frames.seal(padded, clear_header(frame), key, counter)
    ours = page.call("sframe", "deriveKey", BASE_KEY, generation, "encrypt")
    theirs = page.call("sframe", "deriveKey", BASE_KEY, generation, "decrypt")
    assert page.call("sframe", "seal", _asked(frame, payload), ours, counter, is_face) == sealed
    assert page.call("sframe", "open", _asked(frame, sealed), theirs, is_face) == payload


def test_nothing_else_opens(page: Page) -> None:
    frame = Frame(stream=3, sequence=7, captured_us=1_000_000, payload=b"face")
    sealed = frames.seal(b"face", clear_header(frame), frames.derive_key(BASE_KEY, 1), 300)
    key = page.call("sframe", "deriveKey", BASE_KEY, 1, "decrypt")
    assert page.call("sframe", "open", _asked(frame, sealed), key, False) == b"face"
    wrong = [sealed[:at] + bytes([sealed[at] ^ 1]) + sealed[at + 1 :] for at in range(len(sealed))]
    wrong += [sealed[:size] for size in range(len(sealed))]
    asked = [_asked(frame, each) for each in wrong]
    asked += [{**_asked(frame, sealed), "sequence": 8}]
    for each in asked:
        with pytest.raises(PageError, match="SealError"):
            page.call("sframe", "open", each, key, False)


def test_a_peer_is_described_alike(page: Page) -> None:
    tracks = [
        Track(kind="face", avatar="0f" * 32, stream=1),
        Track(kind="voice", deadline_ms=200, stream=40_000),
    ]
    plain = [
        {
            "kind": each.kind,
            "avatar": each.avatar,
            "stream": each.stream,
            "deadline_ms": each.deadline_ms,
        }
        for each in tracks
    ]
    found = page.call("sframe", "describe", "lobby", "Ада", plain)
    assert found == peer_keys.describe("lobby", "Ада", tracks)


def test_a_secret_is_read_from_its_line_or_a_link(page: Page) -> None:
    secret = os.urandom(32)
    text = base64.urlsafe_b64encode(secret).decode()
    for line in (f"pica-secret-1:{text}\n", text, text.rstrip("=")):
        assert page.call("sframe", "readSecret", line) == secret
    with pytest.raises(PageError, match="no room secret"):
        page.call("sframe", "readSecret", "hunter2")
