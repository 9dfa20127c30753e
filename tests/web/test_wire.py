"""The page reads and writes the wire as Python does, down to what it refuses."""

import json

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from golden.wire_samples import FRAMES, GOLDEN, MESSAGES
from helpers.page import Page, PageError
from pica_protocol.messages import Bye, Joined, RoomNews

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
OF_A_RELAY = [name for name, each in MESSAGES.items() if isinstance(each, Joined | RoomNews | Bye)]
WRITTEN = [
    name for name in MESSAGES if name.startswith(("join", "update", "subscribe", "whisper", "bye"))
]


def _golden(name: str) -> bytes:
    return bytes.fromhex(VECTORS["valid"][name])


def test_what_a_relay_says_is_read(page: Page) -> None:
    for name in OF_A_RELAY:
        found = page.call("wire", "decodeMessage", _golden(name))
        assert found == msgpack.unpackb(_golden(name)[1:])


def test_what_is_written_are_the_golden_bytes(page: Page) -> None:
    for name in WRITTEN:
        record = msgpack.unpackb(_golden(name)[1:])
        assert page.call("wire", "encodeMessage", record) == _golden(name)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(OF_A_RELAY), st.integers(0, 200))
def test_a_message_that_is_cut_is_refused(page: Page, name: str, size: int) -> None:
    with pytest.raises(PageError, match="WireError"):
        page.call("wire", "decodeMessage", _golden(name)[: 1 + size % (len(_golden(name)) - 1)])


@pytest.mark.parametrize("name", FRAMES)
def test_media_is_read_and_written(page: Page, name: str) -> None:
    frames = page.call("wire", "decodeMedia", _golden(name), {"constant": 0})
    assert frames == [
        {
            "stream": each.stream,
            "sequence": each.sequence,
            "capturedUs": each.captured_us,
            "payload": each.payload,
        }
        for each in FRAMES[name]
    ]
    written = b"".join(page.call("wire", "encodeFrame", each)[1:] for each in frames)
    assert written == _golden(name)[1:]


def test_a_time_is_the_nearest_to_what_is_expected(page: Page) -> None:
    data = _golden("one frame")
    wrap_us = 2**21 * 100
    (frame,) = page.call("wire", "decodeMedia", data, {"constant": 5 * wrap_us})
    assert frame["capturedUs"] == 123_456_700 // 100 * 100 + 4 * wrap_us
