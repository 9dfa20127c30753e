"""What stands over a call, clicked on without a window: the bar, signs, names, statistics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand, point
from pica_client.call.connection_quality import StreamHealth
from pica_client.call.participants import Participant
from pica_client.call.status import AvatarFigures, CallStatus, PeerStatus
from pica_client.publish.face_controls import TrackerPreview
from pica_client.render.scene import head_rect_px
from pica_client.render.seats import LAYOUTS, Layout, plan_seats
from pica_client.render.views import ViewState as Orbit
from pica_client.render.views import plan_camera
from pica_client.ui.actions import Action
from pica_client.ui.call_view import (
    LOUD_NOTICE_S,
    NOTICE_S,
    CallView,
    Notice,
    NoticeBoard,
    OwnFaceView,
    PersonView,
)
from pica_client.ui.panels.bar import control_bar, leave_question
from pica_client.ui.panels.overlay import (
    NO_FACE,
    banner,
    call_signs,
    free_shares,
    own_face,
    own_face_height,
    own_signs,
    row_of,
    signs,
    statistics,
)
from pica_client.ui.state import ViewState
from pica_client.ui.surface.style import metrics_for
from pica_client.ui.surface.surface import BACKGROUND
from pica_client.ui.surface.widgets import as_drawn, shortened, text_size

pytestmark = pytest.mark.unit

STATE = ViewState(own_face="sent")
ME = Participant(peer_id="", name="Me", is_self=True)
ADA = Participant(peer_id="p1", place=1, name="Ada")
BEN = Participant(peer_id="p2", name="Ben", is_watching=True, is_recording=True)
STATUS = CallStatus(participants=(ME, ADA, BEN), room="standup", duration_s=247.0)
CALL = CallView(people=(PersonView(peer_id="p1", name="Ada"),), status=STATUS)
ALONE = CallView(status=replace(STATUS, participants=(ME,)))
SIZES = [((320, 240), 1.0), ((1280, 720), 1.0), ((2560, 1440), 2.0)]
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


def test_each_button_of_the_bar_gives_its_order_once(hand: Hand) -> None:
    for label, order in BUTTONS.items():
        assert hand.click(label, lambda metrics: control_bar(STATE, CALL, metrics)) == [order]
    hand.frame(lambda metrics: control_bar(ViewState(), CALL, metrics))
    assert not any("your face" in label for label in hand.places)


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
    for label, order in (("Leave", Action.LEAVE), ("Stay", Action.CLOSE)):
        said = hand.click(label, lambda metrics: leave_question(asking, CALL, metrics))
        assert said == [order]
    assert hand.frame(lambda metrics: leave_question(STATE, CALL, metrics)) == []


def test_the_pointer_on_a_panel_is_the_surfaces_and_beside_it_the_scenes(hand: Hand) -> None:
    def frame(*events: object) -> bool:
        hand.frame(lambda metrics: control_bar(STATE, CALL, metrics), *events)  # type: ignore[arg-type]
        return bool(hand.surface.io.want_capture_mouse)

    for _ in range(3):
        frame()
    left, top, *_ = hand.where("Settings")
    assert [frame(point(left + 5, top + 5)), frame(point(640, 100))] == [True, False]


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
    unseen = replace(CALL, own=OwnFaceView(seen=TrackerPreview(False, (), None)))
    assert own_signs(STATE, CALL) == [("Your face is sent", "good")]
    assert own_signs(STATE, lost) == [("Your face is not sent", "alert")]
    assert own_signs(STATE, unseen) == [NO_FACE]
    assert own_signs(ViewState(), CALL) == []


def test_room_and_recordings_stand_on_the_picture() -> None:
    assert call_signs(CallView()) == []
    assert call_signs(CALL) == [("standup   4:07", "good"), ("Ben records", "alert")]
    both = (replace(ME, is_recording=True), replace(ADA, is_recording=True), BEN)
    lost = replace(STATUS, participants=both, is_connected=False, is_encrypted=True)
    assert call_signs(replace(CALL, status=lost)) == [
        (f"{icons.ICON_FA_LOCK}  standup   4:07", "alert"),
        ("Ada and Ben record", "alert"),
    ]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_on_a_small_picture_no_head_reaches_into_the_signs(layout: Layout) -> None:
    free = free_shares(STATE, CALL, metrics_for((320, 240)))
    for count in (1, 2, 5, 7):
        for pinned in (None, 0):
            plan = plan_seats(layout, count, 320 / 240, pinned=pinned, free=free)
            camera = plan_camera(plan, Orbit(), 320, 240)
            for seat in plan.seats:
                rect = head_rect_px(camera, seat)
                assert rect is not None
                assert rect[1] >= free.top * 240 - 4


@pytest.mark.parametrize("count", [1, 3, 16])
def test_notices_stand_below_the_statistics_and_those_below_the_signs(count: int) -> None:
    call = replace(
        CALL,
        people=CALL.people * count,
        notices=(Notice("Saved recording-0001.mp4 in /home/ada/Videos", "accent"),),
        figures=tuple((f"figure {number}", "1000 kbit/s") for number in range(8)),
    )
    state = replace(STATE, show_statistics=True)
    with open_hand((960, 540)) as hand:
        for _ in range(3):
            hand.frame(
                lambda metrics: [*signs(state, call, metrics), *statistics(state, call, metrics)]
            )
        window = imgui.internal.find_window_by_name("statistics")
        lists = imgui.get_draw_data().cmd_lists
        (background,) = (each for each in lists if each._owner_name == BACKGROUND)
        tops = [v.pos.y for v in background.vtx_buffer if 380 < v.pos.x < 600]
        assert min(tops) >= window.pos.y + window.size.y
        assert window.pos.y > hand.surface.metrics.px(36 * 2)


def test_a_long_notice_stands_below_the_signs_at_the_left() -> None:
    tops = []
    for text in ("Saved", "No sound: " + "something is away, " * 9):
        with open_hand((640, 480)) as hand:
            call = replace(CALL, notices=(Notice(text, "alert"),))
            hand.frame(lambda metrics, call=call: signs(STATE, call, metrics))  # type: ignore[misc]
            (shapes,) = imgui.get_draw_data().cmd_lists
            tops.append(min(vertex.pos.y for vertex in shapes.vtx_buffer if vertex.pos.x > 300))
            signs_end = hand.surface.metrics.px(12 + 36 * len(call_signs(call)))
    assert tops[0] < 20
    assert tops[1] >= signs_end - 1


def test_notices_stand_for_a_while_and_loud_ones_longer() -> None:
    board = NoticeBoard()
    for text in ("one", "two", "one", "three"):
        board.add(Notice(text), now=10.0)
    board.add(Notice("Ben records", "alert"), now=10.0)
    assert [each.text for each in board.shown(11.0)] == ["one", "three", "Ben records"]
    assert [each.text for each in board.shown(10.0 + NOTICE_S)] == ["Ben records"]
    assert board.shown(10.0 + LOUD_NOTICE_S) == ()


@pytest.mark.parametrize("mode", ["sent", "frozen", "muted"])
def test_the_own_face_is_shown_where_there_is_room(hand: Hand, mode: str) -> None:
    state = replace(STATE, own_face=mode)  # type: ignore[arg-type]
    assert own_face_height(state, metrics_for((1280, 720))) > 80
    call = replace(
        CALL, own=OwnFaceView(texture=1, seen=TrackerPreview(True, (("Jaw", 2.0),), None))
    )
    assert hand.frame(lambda metrics: own_face(state, call, metrics)) == []


SCRIPTS = ["Ada", "Ольга", "Ελένη", "李小龍 さくら 김", "שרה", "مريم", "กานดา", "आशा", "Ani 😀🎉"]


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_glyph_of_a_name_is_found(hand: Hand, name: str) -> None:
    def show(metrics: object) -> list[object]:
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


def test_a_long_name_is_cut_to_its_room(hand: Hand) -> None:
    def show(metrics: object) -> list[object]:
        cut = shortened("W" * 64, 120.0, 15.0)
        assert cut.endswith("…")
        assert text_size(cut, 15.0)[0] <= 120
        assert shortened("Ada", 120.0, 15.0) == "Ada"
        return []

    hand.frame(show)


def test_a_participants_line_holds_its_figures_and_a_dash_for_what_is_unknown(hand: Hand) -> None:
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

    def show(metrics: object) -> list[object]:
        people = (known, PersonView(peer_id="b", name=""))
        rows.extend(row_of(each, metrics_for((1280, 720))) for each in people)
        return []

    hand.frame(show)
    assert rows == [("Ada", "128", "4.2", "1.7", "–", "12", "1.5 %"), ("", *["–"] * 6)]
