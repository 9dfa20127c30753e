import json
import re
from dataclasses import fields

import pytest

from golden.wire_samples import CHUNK, FRAMES, GOLDEN, MESSAGES, wire_bytes
from helpers.paths import ROOT
from pica_protocol.codec import decode_chunk, decode_message, encode_chunk
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.frames import decode_media
from pica_protocol.messages import MESSAGE_TYPES, wire_name
from pica_protocol.session import CLIENT_TABLE, SERVER_TABLE, Media, State

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


def test_golden_bytes_of_a_chunk_go_both_ways() -> None:
    data = bytes.fromhex(VECTORS["store"]["chunk"])
    assert (decode_chunk(data), encode_chunk(CHUNK)) == (CHUNK, data)


def test_the_golden_file_holds_every_sample() -> None:
    assert set(VECTORS["valid"]) == set(wire_bytes())
    assert {type(message) for message in MESSAGES.values()} == set(MESSAGE_TYPES.values())


def test_the_bytes_in_the_document_are_golden() -> None:
    shown = re.findall(r"```hex\n(.*?)```", DOCUMENT, re.DOTALL)
    assert shown
    assert {re.sub(r"\s", "", each) for each in shown} <= set(VECTORS["valid"].values())


@pytest.mark.parametrize("message", MESSAGE_TYPES.values())
def test_the_document_names_every_field_of_every_message(message: type) -> None:
    lines = [line for line in DOCUMENT.splitlines() if f"`{wire_name(message)}`" in line]
    assert any(all(f"`{each.name}`" in line for each in fields(message)) for line in lines)


@pytest.mark.parametrize("code", list(CloseCode))
def test_the_document_lists_every_close_code(code: CloseCode) -> None:
    assert f"| {code.value} | `{code.name}` |" in DOCUMENT


@pytest.mark.parametrize("table", [CLIENT_TABLE, SERVER_TABLE], ids=["client", "relay"])
def test_the_document_shows_the_state_tables(table: dict[State, dict[type, State]]) -> None:
    for state, row in table.items():
        for kind, reached in row.items():
            name = "media" if kind is Media else f"`{wire_name(kind)}`"
            line = rf"\| {state.value} \|[^|]*{name}[^|]*\| {reached.value} \|"
            assert re.search(line, DOCUMENT), (state, kind)
