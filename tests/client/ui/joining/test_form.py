"""The form that asks where to: what was typed, what cannot be right, no token in sight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pica_client.errors import OptionError, RelayUnreachableError
from pica_client.publish.own_face import FaceChoice
from pica_client.sources import open_source
from pica_client.transport.config import LinkConfig
from pica_client.ui.joining.form import SOURCES, Fields, JoinForm, JoinOrder
from pica_client.ui.joining.trouble import Trouble

pytestmark = pytest.mark.unit

FILLED = Fields(url="ws://127.0.0.1:8765", room="lobby", name="Ada")


def test_filled_fields_are_joined() -> None:
    form = JoinForm(FILLED)
    form.obey(JoinOrder.JOIN)
    assert form.outcome == "join"
    link = form.link()
    assert (link.url, link.room, link.name) == (FILLED.url, "lobby", "Ada")


@pytest.mark.parametrize(
    ("fields", "error"),
    [
        (replace(FILLED, url="http://x"), "no address of a relay"),
        (replace(FILLED, room="a b"), "No room can be called so"),
        (replace(FILLED, name=" "), "enter your name"),
    ],
)
def test_what_cannot_be_right_is_said(fields: Fields, error: str) -> None:
    form = JoinForm(fields)
    form.obey(JoinOrder.JOIN)
    assert form.outcome == "asking"
    assert form.trouble is not None
    assert error in form.trouble.what


def test_an_error_goes_once_one_types() -> None:
    form = JoinForm(FILLED)
    form.refuse(OptionError("the relay is full"))
    form.obey(FILLED)
    assert form.trouble == Trouble("the relay is full")
    form.obey(replace(FILLED, room="other"))
    assert form.trouble is None


def test_a_refused_join_can_be_tried_again() -> None:
    form = JoinForm(FILLED)
    form.obey(JoinOrder.JOIN)
    form.refuse(RelayUnreachableError("no relay answers"))
    assert form.outcome == "asking"
    form.obey(JoinOrder.JOIN)
    assert form.outcome == "join"


def test_a_token_is_not_printed_but_joined_with() -> None:
    form = JoinForm(replace(FILLED, token="abcdef"))
    assert "abcdef" not in repr(form.fields)
    form.obey(JoinOrder.JOIN)
    assert form.link().token == "abcdef"
    assert "abcdef" not in repr(form.link())


def test_a_typed_token_takes_the_place_of_a_token_file(tmp_path: Path) -> None:
    base = LinkConfig(token_file=tmp_path / "token")
    assert JoinForm(FILLED, base=base).link().token_file == tmp_path / "token"
    assert JoinForm(replace(FILLED, token="t"), base=base).link().token_file is None


def test_a_token_and_a_token_file_are_one_too_many(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="give one of them"):
        LinkConfig(token="t", token_file=tmp_path / "token")


def test_a_certificate_file_is_for_addresses_that_use_one(tmp_path: Path) -> None:
    given = replace(FILLED, ca_file=str(tmp_path / "ca.pem"))
    assert JoinForm(given).link().ca_file is None
    secure = replace(given, url="wss://relay")
    assert JoinForm(secure).link().ca_file == tmp_path / "ca.pem"


def test_the_face_is_the_one_that_was_chosen() -> None:
    base = FaceChoice(give="no")
    chosen = JoinForm(replace(FILLED, source="performance:talk", avatar=" nora ")).face(base)
    assert chosen == FaceChoice(source="performance:talk", avatar="nora", give="no")
    assert JoinForm(FILLED).face(base) == FaceChoice(source="", avatar=None, give="no")
    # A webcam needs a camera and networks that a test machine may lack.
    assert all(open_source(source) for source, _ in SOURCES if source not in ("", "webcam"))


def test_an_invite_link_in_the_first_field_fills_the_form() -> None:
    form = JoinForm(FILLED)
    form.obey(replace(FILLED, url="pica://relay.example/standup#token=abc"))
    assert form.fields == replace(
        FILLED, url="wss://relay.example", room="standup", token="abc", name="Ada"
    )
    form.obey(replace(FILLED, url="pica://relay.example"))
    assert form.trouble is not None
    assert "names no room" in form.trouble.what


def test_one_can_leave() -> None:
    form = JoinForm(FILLED)
    form.obey(JoinOrder.LEAVE)
    assert form.outcome == "leave"
