"""The page reads and writes the wire as Python does, down to what it refuses."""

import json
from dataclasses import asdict

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from golden.wire_samples import FRAMES, GOLDEN, MESSAGES
from helpers.page import Page, PageError
from pica_protocol.codec import decode_message
from pica_protocol.messages import Bye, Joined, PeerJoined, RoomNews

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
OF_A_RELAY = [name for name, each in MESSAGES.items() if isinstance(each, Joined | RoomNews | Bye)]
OF_A_CLIENT = [name for name in MESSAGES if name not in OF_A_RELAY]


def _golden(name: str) -> bytes:
    return bytes.fromhex({**VECTORS["valid"], **VECTORS["invalid"]}[name])


def test_what_a_relay_says_is_read(page: Page) -> None:
    for name in OF_A_RELAY:
        found = page.call("wire", "decodeMessage", _golden(name))
        assert found == msgpack.unpackb(_golden(name)[1:])


def test_what_is_written_are_the_golden_bytes(page: Page) -> None:
    for name in MESSAGES:
        record = msgpack.unpackb(_golden(name)[1:])
        assert page.call("wire", "encodeMessage", record) == _golden(name)


@pytest.mark.parametrize("name", VECTORS["invalid"])
def test_golden_invalid_bytes_are_refused(page: Page, name: str) -> None:
    data = _golden(name)
    is_media = data[:1] == b"\x02"
    call = ("decodeMedia", data, {"constant": 0}) if is_media else ("decodeMessage", data)
    with pytest.raises(PageError, match="WireError"):
        page.call("wire", *call)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(OF_A_RELAY), st.integers(1, 200), st.integers(0, 255))
def test_what_is_accepted_python_accepts_too(page: Page, name: str, at: int, byte: int) -> None:
    data = bytearray(_golden(name))
    data[at % len(data)] = byte
    try:
        found = page.call("wire", "decodeMessage", bytes(data))
    except PageError:
        return
    message = decode_message(bytes(data))
    if isinstance(message, PeerJoined):
        assert found["peer"]["name"] == message.peer.name
    assert {*found} == {"type", *asdict(message)}


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
