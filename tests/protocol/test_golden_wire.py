import json
import re

import pytest

from golden.wire_samples import FRAMES, GOLDEN, MESSAGES, invalid_bytes, wire_bytes
from helpers.paths import ROOT
from pica_protocol import PROTOCOL_VERSION
from pica_protocol.codec import decode_message
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.frames import decode_media
from pica_protocol.messages import MESSAGE_TYPES
from pica_protocol.session import CLIENT_TABLE, SERVER_TABLE

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
DOCUMENT = (ROOT / "docs" / "wire.md").read_text()


@pytest.mark.parametrize("name", VECTORS["valid"])
def test_golden_bytes_decode_to_their_sample(name: str) -> None:
    data = bytes.fromhex(VECTORS["valid"][name])
    if name in MESSAGES:
        assert decode_message(data) == MESSAGES[name]
    else:
        assert decode_media(data) == FRAMES[name]


@pytest.mark.parametrize("name", VECTORS["valid"])
def test_samples_encode_to_the_golden_bytes(name: str) -> None:
    assert wire_bytes()[name].hex() == VECTORS["valid"][name]


@pytest.mark.parametrize("name", VECTORS["valid"])
def test_every_truncation_of_golden_bytes_is_refused(name: str) -> None:
    data = bytes.fromhex(VECTORS["valid"][name])
    # A media message cut between two frames is a shorter media message.
    whole = [1 + 8 + len(FRAMES[name][0].payload)] if name == "two frames" else []
    for size in set(range(len(data))) - set(whole):
        with pytest.raises(RemoteProtocolError):
            decode_message(data[:size]) if name in MESSAGES else decode_media(data[:size])


@pytest.mark.parametrize("name", VECTORS["invalid"])
def test_golden_invalid_bytes_are_refused(name: str) -> None:
    data = bytes.fromhex(VECTORS["invalid"][name])
    with pytest.raises(RemoteProtocolError):
        decode_media(data) if data[:1] == b"\x02" else decode_message(data)


def test_the_golden_file_holds_every_sample() -> None:
    assert set(VECTORS["valid"]) == set(wire_bytes())
    assert set(VECTORS["invalid"]) == set(invalid_bytes())
    assert {type(message) for message in MESSAGES.values()} == set(MESSAGE_TYPES.values())


@pytest.mark.parametrize("name", VECTORS["valid"])
def test_the_document_shows_the_bytes_of_every_sample(name: str) -> None:
    shown = re.sub(r"\s", "", "".join(re.findall(r"```hex\n(.*?)```", DOCUMENT, re.DOTALL)))
    assert VECTORS["valid"][name] in shown


def test_the_document_says_the_version() -> None:
    assert f"`version` must equal the relay's: it is {PROTOCOL_VERSION}." in DOCUMENT


@pytest.mark.parametrize("code", list(CloseCode))
def test_the_document_lists_every_close_code(code: CloseCode) -> None:
    assert f"| {code.value} | `{code.name}` |" in DOCUMENT


@pytest.mark.parametrize("table", [CLIENT_TABLE, SERVER_TABLE], ids=["client", "relay"])
def test_the_document_shows_the_state_tables(table: object) -> None:
    assert isinstance(table, dict)
    for state, row in table.items():
        for kind, reached in row.items():
            assert f"| {state.value} | {kind.__name__} | {reached.value} |" in DOCUMENT
