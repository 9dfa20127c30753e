"""The form that asks where to: what was typed, what cannot be right, errors in plain words."""

from __future__ import annotations

import socket
import ssl
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from pica_client.errors import (
    AvatarLookupError,
    OptionError,
    RelayRefusedError,
    RelayUnreachableError,
    SourceError,
)
from pica_client.sources import open_source
from pica_client.ui.join_form import REFUSALS, SOURCES, JoinForm, explain
from pica_client.ui.options import ViewOptions
from pica_client.ui.session import first_state, link_of
from pica_client.ui.state import ViewState
from pica_protocol.errors import CloseCode, is_worth_retrying

pytestmark = pytest.mark.unit

FILLED = ViewState(url="ws://127.0.0.1:8765", room="lobby", name="Ada")


def form_of(state: ViewState = FILLED) -> JoinForm:
    return JoinForm(replace(state), partial(link_of, ViewOptions()))


@pytest.mark.parametrize(
    ("state", "error"),
    [
        (replace(FILLED, url="http://x"), "no address of a relay"),
        (replace(FILLED, url="ws://[x:99999"), "no address of a relay"),
        (replace(FILLED, room="a b"), "No room can be called so"),
        (replace(FILLED, name=" "), "enter your name"),
    ],
)
def test_what_cannot_be_right_is_said(state: ViewState, error: str) -> None:
    form = form_of(state)
    form.join()
    assert form.outcome == "asking"
    assert form.trouble is not None
    assert error in form.trouble.what


def test_a_refused_join_can_be_tried_again_and_typing_takes_the_error_away() -> None:
    form = form_of()
    form.join()
    form.refuse(RelayUnreachableError("no relay answers"))
    assert (form.outcome, form.trouble is None) == ("asking", False)
    form.typed()
    assert form.trouble is None
    form.join()
    assert form.outcome == "join"


def test_a_token_is_not_printed_but_joined_with() -> None:
    state = replace(FILLED, token="abcdef")
    link = link_of(ViewOptions(), state)
    assert link.token == "abcdef"
    assert "abcdef" not in repr(state) + repr(link)


def test_a_typed_token_takes_the_place_of_a_token_file(tmp_path: Path) -> None:
    options = ViewOptions(token_file=tmp_path / "token")
    assert link_of(options, FILLED).token_file == tmp_path / "token"
    assert link_of(options, replace(FILLED, token="t")).token_file is None


@pytest.mark.parametrize(
    ("relay", "link", "is_sent"),
    [
        ("wss://relay.example", "pica://evil.example/fun", False),
        ("wss://relay.example", "pica://relay.example/fun", True),
        ("wss://relay.example", "pica://relay.example/fun?plain=1", False),
        ("wss://relay.example", "pica://relay.example:8443/fun", False),
        (None, "pica://evil.example/fun", False),
    ],
)
def test_an_invite_link_takes_a_token_file_to_no_other_relay(
    relay: str | None, link: str, is_sent: bool, tmp_path: Path
) -> None:
    options = ViewOptions(url=relay, link=link, token_file=tmp_path / "token")
    assert (link_of(options, first_state(options, None)).token_file is None) != is_sent


def test_a_certificate_file_is_for_addresses_that_use_one(tmp_path: Path) -> None:
    given = replace(FILLED, ca_file=str(tmp_path / "ca.pem"))
    assert link_of(ViewOptions(), given).ca_file is None
    secure = replace(given, url="wss://relay")
    assert link_of(ViewOptions(), secure).ca_file == tmp_path / "ca.pem"


def test_every_source_of_the_form_opens() -> None:
    # A webcam needs a camera and networks that a test machine may lack.
    assert all(open_source(source) for source, _ in SOURCES if source not in ("", "webcam"))


def test_an_invite_link_in_the_first_field_fills_the_form() -> None:
    form = form_of()
    form.state.url = "pica://relay.example/standup#token=abc"
    form.typed()
    assert form.state == replace(
        FILLED,
        url="wss://relay.example",
        room="standup",
        token="abc",
        name="Ada",
    )
    form.state.url = "pica://relay.example"
    form.typed()
    assert form.trouble is not None
    assert "names no room" in form.trouble.what


# What a client cannot cause by joining, or what is tried again without a word.
NEVER_AT_THE_FORM = {
    CloseCode.NORMAL,
    CloseCode.PROTOCOL_ERROR,
    CloseCode.INVALID_TEXT,
    CloseCode.MESSAGE_TOO_BIG,
    CloseCode.MALFORMED,
    CloseCode.UNEXPECTED_MESSAGE,
    CloseCode.FOREIGN_STREAM,
    CloseCode.UNFIT_FILE,
    CloseCode.STORE_FULL,
}


def test_every_close_code_that_ends_a_join_has_words_and_a_remedy() -> None:
    final = {code for code in CloseCode if not is_worth_retrying(code)} - NEVER_AT_THE_FORM
    assert final <= REFUSALS.keys()
    for what, remedy in REFUSALS.values():
        assert what.endswith(".")
        assert remedy.endswith(".")


def unreachable(cause: BaseException) -> Exception:
    """What joining raises where the network said something, two steps down."""
    middle, error = RelayUnreachableError("inner"), RelayUnreachableError("no relay at ws://x")
    middle.__cause__, error.__cause__ = cause, middle
    return error


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RelayRefusedError("said no (code 4011)", code=4011), "valid token"),
        (RelayRefusedError("said no (code 4999)", code=4999), "The relay said no"),
        (RelayRefusedError("answers HTTP 404, not as a relay"), "not a PiCA relay"),
        (SourceError("take.csv: no such file"), "cannot be read"),
        (AvatarLookupError("avatar 'x' is unknown"), "not on this computer"),
        (OptionError("name must not be empty"), "enter your name"),
        (OptionError("ca-file x: No such file"), "CA file cannot be used"),
        (RuntimeError("boom"), "did not work"),
        (unreachable(ConnectionRefusedError(111, "Connect call failed")), "No relay answers"),
        (unreachable(TimeoutError()), "No relay answers"),
        (unreachable(socket.gaierror(-2, "Name or service not known")), "no computer of that name"),
        (unreachable(ssl.SSLCertVerificationError("self-signed")), "certificate is not trusted"),
        (unreachable(ssl.SSLError("wrong version number")), "does not encrypt"),
        (unreachable(EOFError("stream ended")), "not a PiCA relay"),
    ],
)
def test_errors_of_joining_are_put_into_words(error: Exception, said: str) -> None:
    trouble = explain(error)
    assert said in trouble.what
    assert trouble.remedy
    assert trouble.details == str(error)
