"""What stands over a call, clicked on without a window: the bar, signs, names, statistics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, pairwise

import pytest
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand
from pica_client.call.roster import Member
from pica_client.call.status import CallStatus
from pica_client.publish import TrackerPreview
from pica_client.ui.actions import Action
from pica_client.ui.call_view import (
    NOTICE_S,
    CallView,
    Notice,
    NoticeBoard,
    OwnFaceView,
    PersonView,
)
from pica_client.ui.overlay import (
    banner,
    call_signs,
    control_bar,
    leave_question,
    names,
    own_signs,
    signs,
)
from pica_client.ui.state import ViewState
from pica_client.ui.widgets import as_drawn
from pica_client.ui.window import ON_PICTURE
from pica_protocol.messages import Peer, Track

pytestmark = pytest.mark.unit

STATE = ViewState(own_face="sent")
FACE, RECORDS = Track(kind="face", stream=1), (("records", "yes"),)
ME = Member(peer=Peer(peer_id="me", name="Me", tracks=(FACE,)))
ADA = Member(peer=Peer(peer_id="p1", name="Ada", tracks=(FACE,)), place=1)
BEN = Member(peer=Peer(peer_id="p2", name="Ben", metadata=RECORDS), place=5)
STATUS = CallStatus(participants=(ME, ADA, BEN), room="standup", duration_s=247.0)
CALL = CallView(people=(PersonView(peer_id="p1", name="Ada"),), status=STATUS)
SIZES = [((320, 240), 1.0), ((1280, 720), 1.0), ((2560, 1440), 2.0)]
BUTTONS = {
    "Hide your face": Action.MUTE_FACE,
    "Next layout": Action.NEXT_LAYOUT,
    "Record": Action.RECORD,
    "Participants": Action.PARTICIPANTS,
    "Settings": Action.SETTINGS,
    "Statistics": Action.STATISTICS,
    "Help": Action.HELP,
    "Leave the call": Action.CLOSE,
}


@pytest.fixture
def hand() -> Iterator[Hand]:
    with open_hand() as found:
        yield found


def test_each_button_of_the_bar_gives_its_order_once(hand: Hand) -> None:
    for label, order in BUTTONS.items():
        assert hand.click(label, lambda: control_bar(STATE, CALL)) == [order]
    hand.frame(lambda: control_bar(ViewState(), CALL))
    assert not any("your face" in label for label in hand.places)


@pytest.mark.parametrize(("size", "scale"), SIZES)
def test_the_bar_keeps_to_the_picture_and_its_buttons_apart(
    size: tuple[int, int], scale: float
) -> None:
    with open_hand(size, scale) as hand:
        for _ in range(3):
            hand.frame(lambda: control_bar(STATE, CALL))
        rects = sorted(hand.places.values())
    assert len(rects) == len(BUTTONS)
    assert min(rect[0] for rect in rects) >= 0
    assert max(rect[2] for rect in rects) <= size[0]
    assert max(rect[3] for rect in rects) <= size[1]
    assert all(left[2] <= right[0] for left, right in pairwise(rects))


def test_leaving_is_asked_and_both_answers_are_buttons(hand: Hand) -> None:
    asking = ViewState(asks_to_leave=True)
    for label, asked, leaves in (("Stay", [Action.CLOSE], False), ("Leave", [], True)):
        said = hand.click(label, lambda: leave_question(asking, CALL))
        assert (said, asking.wants_close) == (asked, leaves)
    assert hand.frame(lambda: leave_question(STATE, CALL)) == []


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (CallStatus(), None),
        (CallStatus(own_quality="poor"), "Your connection is poor"),
        (CallStatus(is_connected=False, away_s=0.5), None),
        (CallStatus(is_connected=False, away_s=7.2), "Connection lost – coming back … 7 s"),
        (CallStatus(muted_by_admin="voice"), "An admin has muted your voice"),
        (CallStatus(own_trouble="vmc: no datagram yet"), "vmc: no datagram yet"),
    ],
)
def test_one_line_at_the_top_says_what_matters_most(status: CallStatus, said: str | None) -> None:
    found = banner(CallView(status=status))
    assert (None if found is None else found[0]) == said


def test_signs_say_how_the_own_face_is_sent() -> None:
    lost = replace(CALL, status=replace(STATUS, is_connected=False))
    unseen = replace(CALL, own=OwnFaceView(seen=TrackerPreview(False, None)))
    assert own_signs(STATE, CALL) == [("Your face is sent", "good")]
    assert own_signs(STATE, lost) == [("Your face is not sent", "alert")]
    assert own_signs(STATE, unseen) == [("Your tracker sees no face", "warning")]
    assert own_signs(ViewState(), CALL) == []


def test_room_and_recordings_stand_on_the_picture() -> None:
    assert call_signs(CallView()) == []
    assert call_signs(CALL) == [("standup   4:07", "good"), ("Ben records", "alert")]
    both = (*(replace(m, peer=replace(m.peer, metadata=RECORDS)) for m in (ME, ADA)), BEN)
    lost = replace(STATUS, participants=both, is_connected=False, is_encrypted=True)
    assert call_signs(replace(CALL, status=lost)) == [
        (f"{icons.ICON_FA_LOCK}  standup   4:07", "alert"),
        ("Ada and Ben record", "alert"),
    ]


def test_signs_stand_beside_and_below_each_other_on_any_picture() -> None:
    long = "No sound: " + "something is away, " * 9
    call = replace(CALL, notices=(Notice(long, "alert"), Notice("Ada left", "plain")))
    for size in ((480, 360), (960, 540), (2560, 1440)):
        with open_hand(size) as hand:
            for _ in range(3):
                hand.frame(lambda: signs(STATE, call))
            lists = imgui.get_draw_data().cmd_lists
            assert all(each._owner_name.startswith(ON_PICTURE) for each in lists)
            spots = [(v.pos.x, v.pos.y) for each in lists for v in each.vtx_buffer]
            assert all(0 <= x <= size[0] and 0 <= y <= size[1] for x, y in spots)
            windows = [imgui.internal.find_window_by_name(each._owner_name) for each in lists]
            assert len(windows) == 5
        for one, two in combinations(windows, 2):
            is_apart = one.pos.x + one.size.x <= two.pos.x or two.pos.x + two.size.x <= one.pos.x
            is_below = one.pos.y + one.size.y <= two.pos.y or two.pos.y + two.size.y <= one.pos.y
            assert is_apart or is_below


def test_a_name_fills_no_more_than_its_room(hand: Hand) -> None:
    person = replace(CALL.people[0], name="W" * 64, is_speaking=True, remark="x y " * 90)
    for room in ((100.0, 50.0, 160.0, 70.0), (100.0, 50.0, 300.0, 70.0)):
        call = replace(CALL, people=(replace(person, label=room),))
        for _ in range(3):
            hand.frame(lambda call=call: names(STATE, call))  # type: ignore[misc]
        window = imgui.internal.find_window_by_name(f"{ON_PICTURE}name p1")
        assert window.size.x <= room[2] - room[0] + 1
        assert window.size.y < 120


def test_notices_stand_for_a_while_and_the_oldest_gives_way() -> None:
    board = NoticeBoard()
    for number, text in enumerate(("one", "two", "one", "three", "four")):
        board.add(Notice(text), now=float(number))
    assert [each.text for each in board.shown(5.0)] == ["one", "three", "four"]
    assert [each.text for each in board.shown(3.5 + NOTICE_S)] == ["four"]


SCRIPTS = ["Ada", "Ольга", "Ελένη", "李小龍 さくら 김", "שרה", "مريم", "กานดา", "आशा", "Ani 😀🎉"]


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_glyph_of_a_name_is_found(hand: Hand, name: str) -> None:
    def show() -> list[object]:
        font = imgui.get_font().get_font_baked(15.0)
        nothing = font.find_glyph_no_fallback(0xE000)
        for char in as_drawn(name).replace(chr(32), ""):
            assert font.find_glyph_no_fallback(ord(char)) not in (None, nothing), hex(ord(char))
        return []

    hand.frame(show)


@pytest.mark.parametrize(
    ("name", "drawn"),
    [
        ("Ольга", "Ольга"),
        ("Ada (מרים)", "Ada (םירמ)"),
        ("مريم", "\ufee2\ufef3\ufeae\ufee3"),
    ],
)
def test_a_name_that_runs_to_the_left_is_turned_round_and_joined(name: str, drawn: str) -> None:
    assert as_drawn(name) == drawn
