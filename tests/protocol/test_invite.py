"""Invite links: there and back, and what is no link."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_protocol.invite import Invite, is_link, make_link, parse_link

pytestmark = pytest.mark.unit

ROOM_SIGNS = "abcXYZ019_.-"


@pytest.mark.parametrize(
    ("link", "invite"),
    [
        ("https://relay.example/standup", Invite(url="wss://relay.example", room="standup")),
        ("http://192.168.0.7:8765/standup", Invite(url="ws://192.168.0.7:8765", room="standup")),
        (
            "https://relay.example/calls/standup#token=abc.def",
            Invite(url="wss://relay.example/calls", room="standup", token="abc.def"),
        ),
        ("http://[::1]:8765/lobby", Invite(url="ws://[::1]:8765", room="lobby")),
    ],
)
def test_a_link_says_what_it_was_made_of(link: str, invite: Invite) -> None:
    assert parse_link(f" {link}\n") == invite
    assert make_link(invite) == link
    assert is_link(link)


@given(
    scheme=st.sampled_from(["ws", "wss"]),
    host=st.sampled_from(["relay.example", "127.0.0.1", "[2001:db8::1]"]),
    port=st.integers(1, 65535) | st.none(),
    folder=st.sampled_from(["", "/a", "/a/b"]),
    room=st.text(ROOM_SIGNS, min_size=1, max_size=64),
    token=st.text(ROOM_SIGNS, max_size=200),
)
def test_every_invitation_comes_back(
    scheme: str, host: str, port: int | None, folder: str, room: str, token: str
) -> None:
    url = f"{scheme}://{host}{'' if port is None else f':{port}'}{folder}"
    invite = Invite(url=url, room=room, token=token)
    assert parse_link(make_link(invite)) == invite


@given(st.text(max_size=80) | st.text(max_size=80).map("https://".__add__))
def test_any_text_is_a_link_or_a_value_error(text: str) -> None:
    try:
        invite = parse_link(text)
    except ValueError:
        return
    assert parse_link(make_link(invite)) == invite


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ("ftp://relay.example/standup", "no invite link"),
        ("https://", "no invite link"),
        ("https://relay.example", "names no room"),
        ("https://relay.example:99999/a", "no invite link"),
        ("https://relay.example/a b", "room must be"),
        ("https://relay.example/" + "a" * 5000, "5022 characters"),
    ],
)
def test_what_is_no_link_is_said(link: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_link(link)


def test_a_token_is_not_printed() -> None:
    invite = parse_link("https://relay.example/a#token=secret")
    assert "secret" not in repr(invite)
    with pytest.raises(ValueError, match="room") as caught:
        parse_link("https://relay.example/a%20b#token=secret")
    assert "secret" not in str(caught.value)
