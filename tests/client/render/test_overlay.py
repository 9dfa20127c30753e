"""Texts over the picture: what is written, where, and that no name can break it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ImageFont

from pica_client.call.faces import FaceState, FaceStatus
from pica_client.call.status import CallStatus
from pica_client.render.scene import Placement, ViewState, head_matrix, overlap, view_camera
from pica_client.ui.hud import MAX_NAME_LENGTH, banner_items, help_item, name_items, own_items
from pica_client.ui.text_raster import (
    FALLBACK_FONTS,
    MAX_LINES,
    Lines,
    OverlayItem,
    Style,
    item_rect_px,
    item_size_px,
    set_item,
)

pytestmark = pytest.mark.unit

CAMERA = view_camera(ViewState(), 1, 960, 540)
SEATED = Placement(slot="p", world_from_head=np.eye(4, dtype=np.float32))


def face(name: str = "Ada", status: FaceStatus = "live") -> FaceState:
    return FaceState(peer_id="p", name=name, avatar_id="0" * 64, latent=None, status=status)


def set_text(lines: Lines, style: Style, size_px: int) -> npt.NDArray[np.uint8]:
    item = OverlayItem(key="t", lines=tuple(lines), x_px=0, y_px=0, style=style, size_px=size_px)
    image = set_item(item)
    assert item_size_px(item) == (image.shape[1], image.shape[0])
    return image


def words(item_lines: Lines) -> str:
    return " ".join(part for line in item_lines for part in line if part)


def test_a_text_is_premultiplied_rgba_with_ink_and_plate() -> None:
    image = set_text((("Ada", ""),), "label", 16)
    assert image.dtype == np.uint8
    alpha = image[..., 3]
    assert (image[..., :3] <= alpha[..., None]).all()
    assert alpha.max() == 255
    assert alpha[0, 0] < 40  # the corner is round
    assert 100 < np.median(alpha) < 200


def test_a_panel_keeps_its_size_while_its_numbers_change() -> None:
    sizes = {
        set_text((("drawing", f"{fps:.1f} fps"), ("peers", "5")), "panel", 14).shape
        for fps in (9.9, 10.1, 29.7)
    }
    assert len(sizes) == 1


@given(name=st.text(max_size=300))
def test_any_name_can_be_set(name: str) -> None:
    image = set_text(((name, name),), "label", 12)
    assert image.shape[0] < 60
    assert image.shape[1] < 6000


def test_more_lines_than_fit_are_cut() -> None:
    image = set_text([("line", "")] * 1000, "panel", 10)
    assert image.shape[0] <= MAX_LINES * 15 + 30


@pytest.mark.parametrize("style", ["label", "panel", "table", "banner", "form"])
def test_every_style_is_premultiplied_and_as_large_as_it_says(style: Style) -> None:
    image = (
        set_text([("one", "two"), ("three",), ()], style, 15)
        if style != "form"
        else (set_text([("title",), ("name", "Ada"), ("wrong",)], style, 15))
    )
    assert (image[..., :3] <= image[..., 3:]).all()
    assert image[..., :3].max() > 200


def test_a_table_has_as_much_room_as_its_columns_need() -> None:
    narrow = set_text([("who", "ms"), ("Ada", "3")], "table", 15)
    wide = set_text([("who", "ms", "kbit/s"), ("Ada", "3", "2")], "table", 15)
    assert wide.shape[1] > narrow.shape[1] + 30
    assert wide.shape[0] == narrow.shape[0]


def test_a_field_shows_the_end_of_what_does_not_fit() -> None:
    short = set_text([("title",), ("url", "ws://a")], "form", 15)
    long = set_text([("title",), ("url", "ws://" + "a" * 100)], "form", 15)
    assert short.shape == long.shape


def test_an_item_at_the_edge_is_moved_onto_the_picture() -> None:
    item = OverlayItem(key="t", lines=(("Ada",),), x_px=-50, y_px=9000)
    left, top, right, bottom = item_rect_px(item, (320, 200))
    assert (left, bottom) == (0, 200)
    assert right > left
    assert top < bottom


def test_letters_with_accents_are_not_drawn_as_boxes() -> None:
    if not _has_fallback():
        pytest.skip("no font of the list is on this machine")
    drawn = {set_text((("Zo" + letter,),), "label", 24).tobytes() for letter in "ëéñł"}
    assert len(drawn) == 4  # the box of a missing letter is the same for all


def _has_fallback() -> bool:
    for name in FALLBACK_FONTS:
        with suppress(OSError):
            ImageFont.truetype(name, 20)
            return True
    return False


def test_a_dot_is_coloured() -> None:
    item = OverlayItem(key="t", lines=(("Ada",),), x_px=0, y_px=0, dot="alert", size_px=30)
    image = set_item(item).astype(int)
    assert ((image[..., 0] > 200) & (image[..., 1] < 120)).any()


def test_a_name_stands_below_its_head() -> None:
    (item,) = name_items([face()], [SEATED], CAMERA, {})
    assert item.lines == (("Ada", ""),)
    assert item.x_px == pytest.approx(480)
    assert item.y_px > 270


@pytest.mark.parametrize(
    ("status", "note"), [("waiting", "waiting"), ("stale", "no signal"), ("away", "away")]
)
def test_a_face_that_is_not_live_says_so(status: FaceStatus, note: str) -> None:
    (item,) = name_items([face(status=status)], [SEATED], CAMERA, {})
    assert item.lines[1:] == (("", note),)


@pytest.mark.parametrize("status", ["live", "concealed"])
def test_a_short_hole_is_not_announced(status: FaceStatus) -> None:
    (item,) = name_items([face(status=status)], [SEATED], CAMERA, {})
    assert len(item.lines) == 1


def test_the_reason_for_a_placeholder_is_wrapped_under_the_name() -> None:
    reason = "ada.pica: tensor pixel.1.weight has values that are not finite or beyond 1e+06 " * 3
    (item,) = name_items([face()], [SEATED], CAMERA, {"p": reason})
    assert 2 < len(item.lines) <= 5
    assert "tensor pixel.1.weight" in words(item.lines)
    assert max(len(line) for _, line in item.lines) <= 24


def test_an_endless_name_is_cut() -> None:
    (item,) = name_items([face(name="A" * 500)], [SEATED], CAMERA, {})
    assert len(item.lines[0][0]) == MAX_NAME_LENGTH


def test_a_head_behind_the_camera_has_no_name_on_the_screen() -> None:
    behind = Placement(slot="p", world_from_head=head_matrix(np.eye(4), [0, 0, 0], [0, 0, 9]))
    assert name_items([face()], [behind], CAMERA, {}) == []


def test_the_keys_stand_on_the_right() -> None:
    item = help_item((960, 540))
    assert item.x_px > 900
    assert item.is_right_aligned
    assert "statistics" in words(item.lines)


def test_keys_for_ones_own_face_are_shown_to_those_who_send_one() -> None:
    assert "mute own face" not in words(help_item((960, 540)).lines)
    assert "mute own face" in words(help_item((960, 540), "sent").lines)


def test_only_a_poor_connection_is_worth_a_word() -> None:
    (fair,) = name_items([face()], [SEATED], CAMERA, {}, quality={"p": "fair"})
    (poor,) = name_items([face()], [SEATED], CAMERA, {}, quality={"p": "poor"})
    assert (len(fair.lines), fair.dot) == (1, None)
    assert poor.lines[1:] == (("", "poor connection"),)
    assert poor.dot == "alert"


def test_who_speaks_has_a_green_dot() -> None:
    (item,) = name_items([face()], [SEATED], CAMERA, {}, speaking={"p"})
    assert item.dot == "good"


def test_a_lost_connection_is_announced_once_it_lasts() -> None:
    size = (960, 540)
    assert banner_items(CallStatus(is_connected=False, away_s=0.4), "none", "", size) == []
    (item,) = banner_items(CallStatus(is_connected=False, away_s=7.0), "none", "saved", size)
    assert "Connection lost" in words(item.lines)
    assert "7 s" in words(item.lines)


def test_a_notice_and_a_poor_connection_of_ones_own_are_banners() -> None:
    size = (960, 540)
    (notice,) = banner_items(CallStatus(), "none", "Saved picture-0001.png", size)
    (poor,) = banner_items(CallStatus(own_quality="poor"), "none", "", size)
    assert words(notice.lines) == "Saved picture-0001.png"
    assert "poor" in words(poor.lines)
    assert banner_items(CallStatus(own_quality="good"), "none", "", size) == []


def test_a_banner_keeps_out_of_the_way_of_a_panel_at_the_upper_edge() -> None:
    size = (1280, 720)
    for panel in ((16.0, 16.0, 756.0, 180.0), (524.0, 16.0, 1264.0, 180.0)):
        (item,) = banner_items(CallStatus(own_quality="poor"), "none", "", size, taken=panel)
        assert not overlap(item_rect_px(item, size), panel)
    below = (16.0, 500.0, 756.0, 700.0)
    (item,) = banner_items(CallStatus(own_quality="poor"), "none", "", size, taken=below)
    assert item.x_px == 640


def test_without_a_connection_ones_own_face_is_not_sent() -> None:
    (item,) = own_items("sent", False, (960, 540), is_connected=False)
    assert "not sent" in words(item.lines)


def test_what_becomes_of_ones_own_face_stands_in_the_corner() -> None:
    size = (960, 540)
    assert own_items("none", False, size) == []
    texts = [words(own_items(state, False, size)[0].lines) for state in ("sent", "frozen", "muted")]
    assert len(set(texts)) == 3
    own, recording = own_items("muted", True, size)
    assert own.dot == recording.dot == "alert"
    assert item_rect_px(own, size)[2] < item_rect_px(recording, size)[0]


def test_type_grows_with_the_picture() -> None:
    small, large = help_item((1280, 720)), help_item((2560, 1440))
    assert large.size_px == pytest.approx(2 * small.size_px, abs=1)
