"""The form that asks where to: typing, pasting, errors beside the fields, no token in sight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.errors import OptionError
from pica_client.transport.config import LinkConfig
from pica_client.ui.controls import CloseWanted, KeyPressed, MousePressed, TextTyped
from pica_client.ui.join_form import Fields, JoinForm
from pica_client.ui.text_raster import item_size_px

pytestmark = pytest.mark.unit

FILLED = Fields(url="ws://127.0.0.1:8765", room="lobby", name="Ada")
SIZE = (1280, 720)


def type_text(form: JoinForm, text: str) -> None:
    for char in text:
        form.receive(TextTyped(char))


def press(form: JoinForm, *keys: str) -> None:
    for key in keys:
        form.receive(KeyPressed(key))


def shown(form: JoinForm) -> list[tuple[str, ...]]:
    return list(form.item(SIZE, is_caret_shown=False).lines)


def test_filled_fields_are_joined_with_enter() -> None:
    form = JoinForm(FILLED)
    press(form, "Enter")
    assert form.outcome == "join"
    link = form.link()
    assert (link.url, link.room, link.name) == (FILLED.url, "lobby", "Ada")


def test_one_types_where_something_is_missing() -> None:
    form = JoinForm(replace(FILLED, name=""))
    type_text(form, "Grace")
    assert form.fields.name == "Grace"


def test_tab_goes_from_field_to_field_and_back() -> None:
    form = JoinForm(Fields())
    type_text(form, "ws://a")
    press(form, "Tab")
    type_text(form, "room")
    press(form, "Tab", "Tab")
    type_text(form, "secret")
    form.receive(KeyPressed("Tab", has_shift=True))
    type_text(form, "Ada")
    assert form.fields == Fields(url="ws://a", room="room", name="Ada", token="secret")


def test_backspace_takes_back_and_control_u_takes_all() -> None:
    form = JoinForm(Fields(url="ws://ab"))
    form.receive(KeyPressed("Up"))  # from room, which is empty, to the address
    press(form, "Backspace")
    assert form.fields.url == "ws://a"
    form.receive(KeyPressed("U", has_control=True))
    assert form.fields.url == ""
    press(form, "Backspace")
    assert form.fields.url == ""


def test_what_is_pasted_loses_its_line_ends() -> None:
    form = JoinForm(replace(FILLED, name=""))
    form.receive(KeyPressed("V", has_control=True), clipboard="Ada\nLovelace\r\n")
    assert form.fields.name == "AdaLovelace"


@pytest.mark.parametrize(
    ("fields", "error", "line"),
    [
        (replace(FILLED, url="http://x"), "url 'http://x' is no relay address", 1),
        (replace(FILLED, room="a b"), "room must be", 2),
        (replace(FILLED, name=" "), "name", 3),
    ],
)
def test_what_cannot_be_right_is_said_in_the_form_and_its_field_is_used(
    fields: Fields, error: str, line: int
) -> None:
    form = JoinForm(fields)
    press(form, "Enter")
    assert form.outcome == "asking"
    assert error in form.error
    item = form.item(SIZE)
    assert item.highlight == line
    assert any(error.split()[0] in text for (text, *_) in item.lines[-3:])


def test_an_error_goes_once_one_types() -> None:
    form = JoinForm(FILLED)
    form.refuse("the relay is full")
    assert shown(form)[-1] == ("the relay is full",)
    type_text(form, "x")
    assert form.error == ""


def test_a_refused_join_can_be_tried_again() -> None:
    form = JoinForm(FILLED)
    press(form, "Enter")
    form.refuse("no relay answers")
    assert form.outcome == "asking"
    press(form, "Enter")
    assert form.outcome == "join"


def test_a_token_is_neither_shown_nor_printed_but_joined_with() -> None:
    form = JoinForm(replace(FILLED, token="abcdef"))
    assert ("Token", "******") in shown(form)
    assert "abcdef" not in repr(form.fields)
    press(form, "Enter")
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
    form = JoinForm(FILLED, ca_file=tmp_path / "ca.pem")
    assert form.link().ca_file is None
    secure = JoinForm(replace(FILLED, url="wss://relay"), ca_file=tmp_path / "ca.pem")
    assert secure.link().ca_file == tmp_path / "ca.pem"


@pytest.mark.parametrize("event", [CloseWanted(), KeyPressed("Escape")])
def test_one_can_leave(event: CloseWanted | KeyPressed) -> None:
    form = JoinForm(FILLED)
    form.receive(event)
    assert form.outcome == "leave"


@pytest.mark.parametrize("size", [(960, 540), (1280, 720), (2560, 1440)])
def test_the_form_stands_in_the_middle_of_any_window(size: tuple[int, int]) -> None:
    item = JoinForm(FILLED).item(size)
    width, height = item_size_px(item)
    assert width < 0.9 * size[0]
    assert height < 0.9 * size[1]
    assert item.x_px == pytest.approx((size[0] - width) / 2)


def test_a_click_uses_the_field_under_it() -> None:
    form = JoinForm(FILLED)
    item = form.item(SIZE)
    _, height = item_size_px(item)
    type_at = item.y_px + height * 0.5
    form.click(MousePressed(640, type_at), item)
    highlighted = form.item(SIZE).highlight
    assert highlighted in (2, 3)
    form.click(MousePressed(640, item.y_px + 2), item)  # the title is no field
    assert form.item(SIZE).highlight == highlighted


@given(st.lists(st.text(max_size=30), max_size=20))
def test_any_text_can_be_typed_and_drawn(texts: list[str]) -> None:
    form = JoinForm(Fields())
    for text in texts:
        form.receive(TextTyped(text))
        form.receive(KeyPressed("Tab"))
    form.receive(KeyPressed("Enter"))
    assert form.outcome in ("asking", "join")
    assert item_size_px(form.item(SIZE))[0] < SIZE[0]
