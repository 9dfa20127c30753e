"""The bar and what is drawn on the picture, clicked on without a window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand, point
from pica_client.call.connection_quality import StreamHealth
from pica_client.call.status import AvatarFigures, CallStatus, PeerStatus
from pica_client.ui.actions import Action
from pica_client.ui.call_view import CallView, PersonView
from pica_client.ui.panels.bar import control_bar, leave_question
from pica_client.ui.panels.overlay import banner, own_signs, row_of
from pica_client.ui.state import ViewState
from pica_client.ui.surface.style import metrics_for
from pica_client.ui.surface.widgets import as_drawn, shortened, text_size

pytestmark = pytest.mark.unit

STATE = ViewState(own_face="sent")
CALL = CallView()
SIZES = [((320, 240), 1.0), ((1280, 720), 1.0), ((2560, 1440), 1.0), ((2560, 1440), 2.0)]
BUTTONS = {
    "Hide your face": Action.MUTE_FACE,
    "Freeze your face": Action.FREEZE_FACE,
    "Next layout": Action.NEXT_LAYOUT,
    "Take a picture": Action.SCREENSHOT,
    "Record": Action.RECORD,
    "Participants": Action.PARTICIPANTS,
    "Settings": Action.SETTINGS,
    "Help": Action.HELP,
    "Leave the call": Action.CLOSE,
}


@pytest.fixture
def hand() -> Iterator[Hand]:
    with open_hand() as found:
        yield found


@pytest.mark.parametrize(("label", "order"), BUTTONS.items())
def test_each_button_of_the_bar_gives_its_order_once(hand: Hand, label: str, order: Action) -> None:
    assert hand.click(label, lambda metrics: control_bar(STATE, CALL, metrics)) == [order]


@pytest.mark.parametrize(("size", "scale"), SIZES)
def test_the_bar_keeps_to_the_picture_and_its_buttons_apart(
    size: tuple[int, int], scale: float
) -> None:
    with open_hand(size, scale) as hand:
        for _ in range(3):
            hand.frame(lambda metrics: control_bar(STATE, CALL, metrics))
        rects = sorted(hand.places.values())
    assert len(rects) == len(BUTTONS)
    assert min(rect[0] for rect in rects) >= 0
    assert max(rect[2] for rect in rects) <= size[0]
    assert max(rect[3] for rect in rects) <= size[1]
    assert all(left[2] <= right[0] for left, right in pairwise(rects))


def test_leaving_is_asked_and_both_answers_are_buttons(hand: Hand) -> None:
    asking = ViewState(asks_to_leave=True)
    assert hand.click("Leave", lambda metrics: leave_question(asking, CALL, metrics)) == [
        Action.LEAVE
    ]
    assert hand.click("Stay", lambda metrics: leave_question(asking, CALL, metrics)) == [
        Action.CLOSE
    ]
    assert hand.frame(lambda metrics: leave_question(STATE, CALL, metrics)) == []


def test_the_pointer_on_a_panel_is_the_surfaces_and_beside_it_the_scenes(hand: Hand) -> None:
    for _ in range(3):
        hand.frame(lambda metrics: control_bar(STATE, CALL, metrics))
    left, top, *_ = hand.where("Settings")
    hand.frame(lambda metrics: control_bar(STATE, CALL, metrics), point(left + 5, top + 5))
    assert hand.surface.io.want_capture_mouse
    hand.frame(lambda metrics: control_bar(STATE, CALL, metrics), point(640, 100))
    assert not hand.surface.io.want_capture_mouse


@pytest.mark.parametrize(
    ("view", "said"),
    [
        (CALL, None),
        (replace(CALL, status=CallStatus(own_quality="poor")), "Your connection is poor"),
        (replace(CALL, status=CallStatus(is_connected=False, away_s=0.5)), None),
        (replace(CALL, status=CallStatus(is_connected=False, away_s=7.2)), "Connection lost"),
        (replace(CALL, status=CallStatus(muted_by_admin="voice")), "An admin has muted your voice"),
        (replace(CALL, status=CallStatus(own_trouble="vmc: no datagram yet")), "no datagram yet"),
    ],
)
def test_one_line_at_the_top_says_what_matters_most(view: CallView, said: str | None) -> None:
    found = banner(view)
    assert (found is None) if said is None else (found is not None and said in found[0])


def test_ones_own_face_is_not_sent_while_the_connection_is_gone() -> None:
    lost = replace(CALL, status=CallStatus(is_connected=False))
    assert own_signs(STATE, CALL) == [("Your face is sent", "good")]
    assert own_signs(STATE, lost) == [("Your face is not sent", "alert")]
    assert own_signs(ViewState(), CALL) == []


SCRIPTS = ["Ada", "Ольга", "Ελένη", "李小龍 さくら 김", "שרה", "مريم", "กานดา", "आशा", "Ani 😀🎉"]


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_glyph_of_a_name_is_found(hand: Hand, name: str) -> None:
    def show(metrics: object) -> list[object]:
        font = imgui.get_font().get_font_baked(15.0)
        nothing = font.find_glyph_no_fallback(0xE000)
        for char in as_drawn(name).replace(chr(32), ""):
            assert font.find_glyph_no_fallback(ord(char)) is not nothing, hex(ord(char))
            assert font.find_glyph_no_fallback(ord(char)) is not None, hex(ord(char))
        return []

    hand.frame(show)


@pytest.mark.parametrize(
    ("name", "drawn"),
    [("Ольга", "Ольга"), ("Ada (מרים)", "Ada (םירמ)"), ("مريم", "\ufee2\ufef3\ufeae\ufee3")],
)
def test_a_name_that_runs_to_the_left_is_turned_round(name: str, drawn: str) -> None:
    assert as_drawn(name) == drawn


def test_a_long_name_is_cut_to_its_room(hand: Hand) -> None:
    def show(metrics: object) -> list[object]:
        cut = shortened("W" * 64, 120.0, 15.0)
        assert cut.endswith("…")
        assert text_size(cut, 15.0)[0] <= 120
        assert shortened("Ada", 120.0, 15.0) == "Ada"
        return []

    hand.frame(show)


def test_a_participants_line_holds_its_figures_and_a_dash_for_what_is_unknown(hand: Hand) -> None:
    metrics = metrics_for((1280, 720))
    known = PersonView(
        peer_id="a",
        name="Ada",
        figures=AvatarFigures(
            level=128, decode_ms=4.25, latency_ms=1e6, num_decoded=1, is_speaking=False
        ),
        stream=PeerStatus(
            payload_bps=1730.0, health=StreamHealth(shown=200, concealed=3, age_s=0.012)
        ),
    )
    rows: list[tuple[str, ...]] = []

    def show(_: object) -> list[object]:
        rows.extend(row_of(person, metrics) for person in (known, PersonView(peer_id="b", name="")))
        return []

    hand.frame(show)
    assert rows[0] == ("Ada", "128", "4.2", "1.7", "–", "12", "1.5 %")
    assert rows[1] == ("", *["–"] * 6)
