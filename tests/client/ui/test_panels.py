"""What stands over a call and beside it, clicked on without a window: bar, signs, names, panels."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any, get_args

import pytest
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand
from pica_client.call.roster import Member
from pica_client.call.status import CallStatus
from pica_client.ui.actions import Action, Request
from pica_client.ui.overlay import (
    banner,
    call_signs,
    control_bar,
    leave_question,
    names,
    own_signs,
    signs,
)
from pica_client.ui.side import side_panel, signs_of, waiting_page
from pica_client.ui.state import (
    NOTICE_S,
    CallView,
    NoticeBoard,
    OwnFaceView,
    Panel,
    PersonView,
    Side,
    ViewState,
)
from pica_client.ui.widgets import as_drawn
from pica_client.ui.window import ON_PICTURE
from pica_client.voice.sound.settings import DeviceState, SoundSettings, SoundState
from pica_protocol.messages import BarIdentity, MutePeer, Peer, RemovePeer, Track

pytestmark = pytest.mark.unit

INVITATION = "https://relay.example/standup"
FACE, VOICE = Track(kind="face", stream=1), Track(kind="voice", stream=2)
RECORDS = (("records", "yes"),)
ME = Member(peer=Peer(peer_id="me", name="Me", tracks=(FACE,)))
ADA = Member(peer=Peer(peer_id="p1", name="Ada", tracks=(FACE, VOICE), identity="ada-1"), place=3)
BEN = Member(peer=Peer(peer_id="p2", name="Ben", metadata=RECORDS), place=5)
STATUS = CallStatus(
    participants=(ME, ADA, BEN), room="standup", invitation=INVITATION, duration_s=247.0
)
STATE = ViewState(own_face="sent")
LISTED = replace(STATE, side="participants")
SETTINGS = replace(STATE, side="settings")
CALL = CallView(people=(PersonView(peer_id="p1", name="Ada", is_speaking=True),), status=STATUS)
AS_ADMIN = replace(CALL, status=replace(STATUS, is_admin=True))
ALONE = CallView(status=replace(STATUS, participants=(ME,)))
SIZES = [((320, 240), 1.0), ((1280, 720), 1.0), ((2560, 1440), 2.0)]
BUTTONS = {
    "Hide your face": Action.MUTE_FACE,
    "Next layout": Action.NEXT_LAYOUT,
    "Record": Action.RECORD,
    "Participants": Action.PARTICIPANTS,
    "Settings": Action.SETTINGS,
    "Help": Action.HELP,
    "Leave the call": Action.CLOSE,
}


def ada(**said: Any) -> Member:
    """Ada, with other fields of the peer."""
    return replace(ADA, peer=replace(ADA.peer, **said))


@pytest.fixture
def hand() -> Iterator[Hand]:
    with open_hand() as found:
        yield found


def test_each_button_of_the_bar_gives_its_order_once(hand: Hand) -> None:
    for label, order in BUTTONS.items():
        assert clicking(hand, control_bar, STATE, CALL, label) == [order]
    hand.frame(lambda: control_bar(ViewState(), CALL))
    assert not any("your face" in label for label in hand.places)


def test_leaving_is_asked_and_both_answers_are_buttons(hand: Hand) -> None:
    asking = ViewState(asks_to_leave=True)
    for label, asked, leaves in (("Stay", [Action.CLOSE], False), ("Leave", [], True)):
        said = clicking(hand, leave_question, asking, CALL, label)
        assert (said, asking.wants_close) == (asked, leaves)


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
    unseen = replace(CALL, own=OwnFaceView(is_seen=False))
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
    call = replace(CALL, notices=((long, "alert"), ("Ada left", "plain")))
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
        board.add((text, "plain"), now=float(number))
    assert [text for text, _ in board.shown(5.0)] == ["one", "three", "four"]
    assert [text for text, _ in board.shown(3.5 + NOTICE_S)] == ["four"]


SCRIPTS = ["Ada", "Ольга", "Ελένη", "李小龍 さくら 김", "שרה", "مريم", "กานดา", "आशा", "Ani 😀🎉"]


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_glyph_of_a_name_is_found(hand: Hand, name: str) -> None:
    def show() -> None:
        font = imgui.get_font().get_font_baked(15.0)
        nothing = font.find_glyph_no_fallback(0xE000)
        for char in as_drawn(name).replace(chr(32), ""):
            assert font.find_glyph_no_fallback(ord(char)) not in (None, nothing), hex(ord(char))

    hand.frame(show)


@pytest.mark.parametrize(
    ("name", "drawn"),
    [("Ольга", "Ольга"), ("Ada (מרים)", "Ada (םירמ)"), ("مريم", "\ufee2\ufef3\ufeae\ufee3")],
)
def test_a_name_that_runs_to_the_left_is_turned_round_and_joined(name: str, drawn: str) -> None:
    assert as_drawn(name) == drawn


def texts(hand: Hand, panel: Panel, call: CallView, state: ViewState = LISTED) -> str:
    """All that a panel writes."""
    written: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imgui, "text_unformatted", written.append)
        hand.frame(lambda: panel(replace(state), call))
    return "\n".join(written)


def clicking(
    hand: Hand, panel: Panel, state: ViewState, call: CallView, *labels: str
) -> list[Request]:
    """Click on widgets of a panel, which may write into the state; give what the last one asks."""
    for label in labels:
        state.requests.clear()
        hand.click(label, lambda: panel(state, call))
    return list(state.requests)


def test_the_menu_of_a_person_pins_and_makes_them_softer(hand: Hand) -> None:
    state = replace(LISTED, volumes={})
    clicking(hand, side_panel, state, CALL, "More on Ada", "Pin")
    assert state.pinned == 3
    state.volumes[3] = 0.0
    clicking(hand, side_panel, state, CALL, "More on Ada", "##volume")
    hand.press(imgui.Key.escape, lambda: side_panel(state, CALL))
    assert state.volumes == {3: pytest.approx(1.0, abs=0.05)}
    clicking(hand, side_panel, state, CALL, "More on Ben")
    assert not any("Pin" in label or "More on Me" in label for label in hand.places)


def test_all_participants_are_listed_with_what_is_said_of_them(hand: Hand) -> None:
    warned = replace(ADA, warning="looks like your name", note="face is off")
    said = texts(hand, side_panel, replace(CALL, status=replace(STATUS, participants=(ME, warned))))
    for text in ("2 in standup, 4:07", "Me (you)", "Ada", "looks like your name", "face is off"):
        assert text in said
    assert "Not encrypted end to end" in said
    assert INVITATION in said
    status = replace(STATUS, is_encrypted=True, code="12345 23456 34567 45678 56789 67890")
    said = texts(hand, side_panel, replace(CALL, status=status))
    assert "\n12345   23456   34567\n45678   56789   67890\n" in said


@pytest.mark.parametrize(
    ("person", "volume", "is_encrypted", "signs"),
    [
        (BEN, 1, False, ["CIRCLE", "EYE"]),
        (
            ada(metadata=(("face", "muted"),), is_name_assured=True),
            1,
            True,
            ["EYE_SLASH", "TRIANGLE_EXCLAMATION", "CHECK"],
        ),
        (replace(ADA, is_verified=True), 0.5, True, ["VOLUME_HIGH", "LOCK"]),
        (ada(metadata=(("voice", "muted"),)), 0, False, ["MICROPHONE_SLASH", "VOLUME_XMARK"]),
        (ME, 1, True, []),
    ],
)
def test_signs_beside_a_name(
    person: Member, volume: float, is_encrypted: bool, signs: list[str]
) -> None:
    found = signs_of(person, is_encrypted=is_encrypted, volume=volume)
    assert [icon for icon, _, _ in found] == [getattr(icons, f"ICON_FA_{sign}") for sign in signs]


@pytest.mark.parametrize(
    ("panel", "call"), [(side_panel, CALL), (waiting_page, ALONE)], ids=["list", "page"]
)
def test_the_invitation_can_be_copied(hand: Hand, panel: Panel, call: CallView) -> None:
    assert clicking(hand, panel, LISTED, call, "Copy the invitation") == [Action.COPY_INVITATION]


def test_the_waiting_page_says_where_and_who_only_watches(hand: Hand) -> None:
    said = texts(hand, waiting_page, ALONE)
    assert "You are in the room standup." in said
    assert texts(hand, waiting_page, CALL) == ""
    lost = replace(ALONE, status=replace(STATUS, is_connected=False))
    assert texts(hand, waiting_page, lost) == ""


def test_each_setting_is_one_click(hand: Hand) -> None:
    state = replace(SETTINGS)
    labels = ("View", "##layout", "Grid", "##scale", "125%", "My own")
    clicking(hand, side_panel, state, CALL, *labels)
    assert (state.layout, state.shows_self) == ("grid", False)
    assert state.scale == 1.25
    state.side = "help"
    assert clicking(hand, side_panel, state, CALL, "Close") == [Action.CLOSE]


def test_the_source_of_the_face_is_chosen_during_the_call(hand: Hand) -> None:
    state = replace(SETTINGS, source="livelink")
    call = replace(CALL, own=OwnFaceView(source="livelink", is_seen=True))
    clicking(hand, side_panel, state, call, "##source", "VTuber")
    assert state.source == "vmc"


def test_devices_are_changed_during_a_call(hand: Hand) -> None:
    sound = SoundState(
        microphones=("Desk",),
        speakers=("Horn",),
        speaker=DeviceState("Horn", "no loudspeaker 'Old'; 'Horn' is used"),
        cleaning="echo cancellation is missing: pip install 'pica-telepresence[echo]'",
    )
    state = ViewState(side="settings", own_voice="sent", voice="mic")
    call = CallView(sound=sound)
    clicking(hand, side_panel, state, call, "Sound")
    assert "no loudspeaker 'Old'" in texts(hand, side_panel, call, state)
    labels = ("##microphone", "Desk", "##speaker", "Horn", "Hold Space")
    clicking(hand, side_panel, state, call, *labels)
    chosen = SoundSettings(microphone="Desk", speaker="Horn", push_to_talk=True)
    assert state.sound == chosen
    assert state.voice == "mic"
    listening = replace(state, own_voice="none")
    hand.frame(lambda: side_panel(listening, call))
    assert not any("##microphone" in label for label in hand.places)


@pytest.mark.parametrize(
    ("item", "asked"),
    [
        ("Mute voice", MutePeer(peer_id="p1", kind="voice", is_muted=True)),
        ("Mute face", MutePeer(peer_id="p1", kind="face", is_muted=True)),
        ("Remove", RemovePeer(peer_id="p1")),
        ("Bar until the room is empty", BarIdentity(identity="ada-1", is_barred=True)),
    ],
)
def test_an_admins_menu_of_a_person_moderates(hand: Hand, item: str, asked: Request) -> None:
    state = replace(LISTED, barred={})
    clicking(hand, side_panel, state, CALL, "More on Ada")
    assert not any(item in label for label in hand.places)  # for admins alone
    hand.press(imgui.Key.escape, lambda: side_panel(state, CALL))
    assert clicking(hand, side_panel, state, AS_ADMIN, "More on Ada", item) == [asked]


def test_an_admin_lets_a_barred_person_rejoin_and_unmutes_another(hand: Hand) -> None:
    state = replace(LISTED, barred={"eve-1": "Eve"})
    eve = replace(ADA, muted_streams=frozenset({2}))
    call = replace(AS_ADMIN, status=replace(AS_ADMIN.status, participants=(ME, eve)))
    asked = clicking(hand, side_panel, state, call, "Let Eve rejoin")
    assert asked == [BarIdentity(identity="eve-1", is_barred=False)]
    assert state.barred == {}
    asked = clicking(hand, side_panel, state, call, "More on Ada", "Unmute voice")
    assert asked == [MutePeer(peer_id="p1", kind="voice", is_muted=False)]


@pytest.mark.parametrize("size", [(320, 240), (640, 360), (1280, 720), (3840, 2160)])
def test_panels_keep_to_the_picture(size: tuple[int, int]) -> None:
    many = tuple(replace(ada(peer_id=f"p{n}", name="W" * 64), note="x" * 80) for n in range(63))
    call = replace(
        CALL,
        status=replace(STATUS, participants=(ME, *many), code="12345 " * 6, is_encrypted=True),
        notices=(("n" * 200, "alert"),) * 3,
    )
    with open_hand(size) as hand:
        for side in get_args(Side):
            state = replace(LISTED, side=side)
            for _ in range(2):
                for panel in (side_panel, signs, waiting_page, control_bar):
                    hand.frame(partial(panel, state, call))
                    assert all(right <= size[0] for _, _, right, _ in hand.places.values())
            assert all(
                left[2] <= right[0] for left, right in pairwise(sorted(hand.places.values()))
            )
