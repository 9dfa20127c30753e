"""From the options of `pica view` to the connection that is asked for."""

from dataclasses import replace
from pathlib import Path

import pytest

from pica_client.ui.options import JoinOptions, ViewOptions
from pica_client.ui.session import first_state, link_of
from pica_client.ui.state import ViewState

pytestmark = pytest.mark.unit

FILLED = ViewState(url="ws://127.0.0.1:8765", room="lobby", name="Ada")


def test_a_token_is_not_printed_but_joined_with() -> None:
    state = replace(FILLED, token="abcdef")
    link = link_of(ViewOptions(), state)
    assert link.token == "abcdef"
    assert "abcdef" not in repr(state) + repr(link)


def test_a_typed_token_takes_the_place_of_a_token_file(tmp_path: Path) -> None:
    options = ViewOptions(join=JoinOptions(token_file=tmp_path / "token"))
    assert link_of(options, FILLED).token_file == tmp_path / "token"
    assert link_of(options, replace(FILLED, token="t")).token_file is None


@pytest.mark.parametrize(
    ("relay", "link", "is_sent"),
    [
        ("wss://relay.example", "https://evil.example/fun", False),
        ("wss://relay.example", "https://relay.example/fun", True),
        ("wss://relay.example", "http://relay.example/fun", False),
        ("wss://relay.example", "https://relay.example:8443/fun", False),
        ("", "https://evil.example/fun", False),
    ],
)
def test_an_invite_link_takes_a_token_file_to_no_other_relay(
    relay: str, link: str, is_sent: bool, tmp_path: Path
) -> None:
    options = ViewOptions(link, join=JoinOptions(url=relay, token_file=tmp_path / "token"))
    assert (link_of(options, first_state(options, None)).token_file is None) != is_sent
