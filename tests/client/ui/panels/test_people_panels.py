"""The panels about people: the list with its menus, the page while waiting, the settings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from helpers.hand import Hand, open_hand
from pica_client.call.participants import Participant
from pica_client.call.status import CallStatus
from pica_client.publish.face_desk import Seen
from pica_client.render.scene import head_rect_px
from pica_client.render.seats import LAYOUTS, Layout, plan_seats
from pica_client.render.views import ViewState as Orbit
from pica_client.render.views import plan_camera
from pica_client.ui.actions import Action, Request
from pica_client.ui.call_view import CallView, Notice, OwnFaceView, Panel, PersonView
from pica_client.ui.panels.bar import first_hint
from pica_client.ui.panels.overlay import (
    call_signs,
    compact_sign,
    free_shares,
    own_face,
    own_face_height,
    signs,
    statistics,
)
from pica_client.ui.panels.side import (
    participants_panel,
    settings_panel,
    signs_of,
    waiting_page,
)
from pica_client.ui.state import Identity, ViewState
from pica_client.ui.surface.style import metrics_for
from pica_client.ui.surface.surface import BACKGROUND
from pica_client.voice.sound.settings import DeviceState, SoundSettings, SoundState
from pica_protocol.messages import BarIdentity, MutePeer, RemovePeer

pytestmark = pytest.mark.unit

INVITATION = "pica://relay.example/standup"
ME = Participant(peer_id="", name="Me", is_self=True)
ADA = Participant(peer_id="p1", place=1, name="Ada")
BEN = Participant(peer_id="p2", name="Ben", is_watching=True, is_recording=True)
STATUS = CallStatus(
    participants=(ME, ADA, BEN), room="standup", invitation=INVITATION, duration_s=247.0
)
STATE = ViewState(own_face="sent", side="participants")
SETTINGS = ViewState(own_face="sent", side="settings")
VIEW = CallView(
    people=(PersonView(peer_id="p1", name="Ada", is_speaking=True),),
    status=STATUS,
)
ALONE = CallView(status=replace(STATUS, participants=(ME,)))


@pytest.fixture
def hand() -> Iterator[Hand]:
    with open_hand() as found:
        yield found


def texts(hand: Hand, panel: Panel, call: CallView, state: ViewState = STATE) -> str:
    """All that a panel writes."""
    written: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imgui, "text_unformatted", written.append)
        hand.frame(lambda metrics: panel(replace(state), call, metrics))
    return "\n".join(written)


def clicking(
    hand: Hand, panel: Panel, state: ViewState, call: CallView, label: str
) -> list[Request]:
    """Click on a widget of a panel, which may write into the state."""
    return hand.click(label, lambda metrics: panel(state, call, metrics))


def test_the_menu_of_a_person_pins_shows_statistics_and_resets_the_view(hand: Hand) -> None:
    state = replace(STATE)
    for item, asked in (
        ("Pin", []),
        ("Statistics", [Action.STATISTICS]),
        ("Reset the view", [Action.RESET_VIEW]),
    ):
        clicking(hand, participants_panel, state, VIEW, "More on Ada")
        assert clicking(hand, participants_panel, state, VIEW, item) == asked
    assert state.pinned == 1


def test_everybody_is_listed_with_what_is_said_of_them(hand: Hand) -> None:
    warned = replace(ADA, warning="looks like your name", note="face is off")
    status = replace(STATUS, participants=(ME, warned, BEN))
    said = texts(hand, participants_panel, replace(VIEW, status=status))
    for text in ("3 in standup, 4:07", "Me (you)", "Ada", "looks like your name", "face is off"):
        assert text in said
    assert "watching" in said
    assert "Not encrypted end to end" in said
    assert INVITATION in said


def test_the_code_to_read_aloud_stands_in_groups(hand: Hand) -> None:
    code = "12345 23456 34567 45678 56789 67890"
    status = replace(STATUS, is_encrypted=True, code=code)
    said = texts(hand, participants_panel, replace(VIEW, status=status)).splitlines()
    assert "12345   23456   34567" in said
    assert "45678   56789   67890" in said
    waiting = replace(VIEW, status=replace(STATUS, is_encrypted=True))
    assert "No other participant is verified yet" in texts(hand, participants_panel, waiting)


def test_signs_beside_a_name_have_a_meaning() -> None:
    assert [icon for icon, _, _ in signs_of(BEN, is_encrypted=False)] == [
        icons.ICON_FA_CIRCLE,
        icons.ICON_FA_EYE,
    ]
    odd = replace(ADA, face="muted", is_assured=True)
    assert [icon for icon, _, _ in signs_of(odd, is_encrypted=True)] == [
        icons.ICON_FA_EYE_SLASH,
        icons.ICON_FA_TRIANGLE_EXCLAMATION,
        icons.ICON_FA_CHECK,
    ]
    verified = signs_of(replace(ADA, is_verified=True), is_encrypted=True)
    assert [icon for icon, _, _ in verified] == [icons.ICON_FA_LOCK]
    assert signs_of(ME, is_encrypted=True) == []


@pytest.mark.parametrize(
    ("panel", "call"), [(participants_panel, VIEW), (waiting_page, ALONE)], ids=["list", "page"]
)
def test_the_invitation_can_be_copied(hand: Hand, panel: Panel, call: CallView) -> None:
    assert clicking(hand, panel, STATE, call, "Copy the invitation") == [Action.COPY_INVITATION]


def test_who_is_alone_reads_where_and_who_only_watches(hand: Hand) -> None:
    said = texts(hand, waiting_page, ALONE)
    assert "Waiting for others" in said
    assert "You are in the room standup." in said
    assert "watch" not in said
    watched = replace(ALONE, status=replace(STATUS, participants=(ME, BEN)))
    assert "One person watches without showing a face." in texts(hand, waiting_page, watched)


def test_each_setting_is_one_click(hand: Hand) -> None:
    state = replace(SETTINGS)
    for label in ("View", "Grid", "Statistics", "My own face", "Light", "125%", "##detail"):
        clicking(hand, settings_panel, state, VIEW, label)
    assert (state.layout, state.show_statistics, state.shows_self) == ("grid", True, False)
    assert (state.mode, state.scale) == ("light", 1.25)
    assert state.detail == pytest.approx(0.55, abs=0.1)  # the middle of 10 to 100 %


def test_source_avatar_and_name_are_chosen_during_the_call(hand: Hand) -> None:
    me = Identity("Me", "", "livelink", "none")
    state = replace(SETTINGS, entered=me, avatars=("amara", "nora"))
    state.identity = me
    call = replace(VIEW, own=OwnFaceView(source="livelink", seen=Seen(True, (), None)))
    for label in ("##source", "VTuber"):
        clicking(hand, settings_panel, state, call, label)
    assert state.source == "vmc"
    assert clicking(hand, settings_panel, state, call, "Calibrate") == [Action.CALIBRATE]
    assert not any("Join again" in label for label in hand.places)
    for label in ("##avatar", "Nora"):
        clicking(hand, settings_panel, state, call, label)
    assert state.avatar == "nora"
    assert clicking(hand, settings_panel, state, call, "Join again") == [Action.REJOIN]


def test_the_first_hint_is_dismissed_by_a_button(hand: Hand) -> None:
    state = ViewState()
    assert "join with a face source" in texts(hand, first_hint, ALONE, state)
    assert "join with a face source" not in texts(
        hand, first_hint, ALONE, ViewState(own_face="sent")
    )
    clicking(hand, first_hint, state, ALONE, "Got it")
    assert state.has_seen_hint
    assert texts(hand, first_hint, ALONE, state) == ""


def test_a_small_picture_has_one_line_for_what_matters_most() -> None:
    state, recording = ViewState(has_seen_hint=True), ViewState(has_seen_hint=True)
    recording.is_recording = True
    assert compact_sign(STATE, VIEW) is None  # a panel stands there
    told = replace(VIEW, notices=(Notice("Saved", "accent"), Notice("Ada left", "plain")))
    assert compact_sign(state, VIEW) == ("Ben records", "alert")
    assert compact_sign(state, told) == ("Ada left", "plain")
    assert compact_sign(recording, VIEW) == ("Ben records", "alert")
    assert compact_sign(recording, ALONE) == ("Recording", "alert")
    lost = replace(told, status=replace(STATUS, is_connected=False, away_s=3.0))
    assert compact_sign(state, lost) == ("Connection lost – coming back … 3 s", "alert")
    assert compact_sign(ViewState(), VIEW) is None  # the hint stands there
    with open_hand((320, 240)) as small:
        clicking(small, first_hint, hinted := ViewState(), VIEW, "Got it")
        assert hinted.has_seen_hint


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [1, 2, 5, 7])
def test_on_a_small_picture_no_head_reaches_into_that_line(layout: Layout, count: int) -> None:
    metrics = metrics_for((320, 240))
    free = free_shares(ViewState(has_seen_hint=True), VIEW, metrics)
    for pinned in (None, 0):
        plan = plan_seats(layout, count, 320 / 240, pinned=pinned, free=free)
        camera = plan_camera(plan, Orbit(), 320, 240)
        for seat in plan.seats:
            rect = head_rect_px(camera, seat)
            assert rect is not None
            assert rect[1] >= free.top * 240 - 4


def test_where_one_is_and_who_records_stands_on_the_picture() -> None:
    assert call_signs(replace(VIEW, status=CallStatus())) == []
    assert call_signs(VIEW) == [("standup   4:07", "good"), ("Ben records", "alert")]
    both = (replace(ME, is_recording=True), replace(ADA, is_recording=True), BEN)
    lost = replace(STATUS, participants=both, is_connected=False, is_encrypted=True)
    assert call_signs(replace(VIEW, status=lost)) == [
        (f"{icons.ICON_FA_LOCK}  standup   4:07", "alert"),
        ("Ada and Ben record", "alert"),
    ]


@pytest.mark.parametrize("size", [(320, 240), (640, 360), (1280, 720), (3840, 2160)])
def test_panels_about_people_keep_to_the_picture(size: tuple[int, int]) -> None:
    many = tuple(replace(ADA, peer_id=f"p{n}", name="W" * 64, note="x" * 80) for n in range(63))
    view = replace(
        VIEW,
        status=replace(STATUS, participants=(ME, *many), code="12345 " * 6, is_encrypted=True),
        notices=tuple(Notice("n" * 200, "alert") for _ in range(3)),
    )
    with open_hand(size) as hand:
        for panel in (participants_panel, signs, settings_panel, waiting_page, own_face):
            for _ in range(2):
                hand.frame(lambda metrics, panel=panel: panel(STATE, view, metrics))  # type: ignore[misc]
                assert all(right <= size[0] for _, _, right, _ in hand.places.values())


def test_ones_own_face_is_shown_where_there_is_room(hand: Hand) -> None:
    assert own_face_height(ViewState(), metrics_for((320, 240))) == 0
    assert own_face_height(ViewState(), metrics_for((1280, 720))) > 80
    for mode in ("sent", "frozen", "muted"):
        state = ViewState(own_face=mode)  # type: ignore[arg-type]
        has_face = mode != "frozen"
        own = OwnFaceView(texture=1, seen=Seen(has_face, (("Jaw", 2.0),), None))
        shown = replace(VIEW, own=own)
        assert hand.frame(lambda metrics, s=state, c=shown: own_face(s, c, metrics)) == []  # type: ignore[misc]


def test_a_long_notice_stands_below_the_signs_at_the_left() -> None:
    short, long = (
        Notice("Saved", "accent"),
        Notice("No sound: " + "something is away, " * 9, "alert"),
    )
    tops = []
    for notice in (short, long):
        with open_hand((640, 480)) as hand:
            view = replace(VIEW, notices=(notice,))
            hand.frame(lambda metrics, view=view: signs(STATE, view, metrics))  # type: ignore[misc]
            (shapes,) = imgui.get_draw_data().cmd_lists
            tops.append(min(vertex.pos.y for vertex in shapes.vtx_buffer if vertex.pos.x > 300))
            signs_end = hand.surface.metrics.px(12 + 36 * len(call_signs(view)))
    assert tops[0] < 20
    assert tops[1] >= signs_end - 1


@pytest.mark.parametrize("count", [1, 3, 16])
def test_notices_stand_below_the_statistics(count: int) -> None:
    view = replace(
        ALONE,
        people=VIEW.people * count,
        notices=(Notice("Saved recording-0001.mp4 in /home/ada/Videos", "accent"),),
        figures=tuple((f"figure {number}", "1000 kbit/s") for number in range(8)),
    )
    state = ViewState(show_statistics=True)
    with open_hand((960, 540)) as hand:
        for _ in range(3):
            hand.frame(
                lambda metrics: [*signs(state, view, metrics), *statistics(state, view, metrics)]
            )
        window = imgui.internal.find_window_by_name("statistics")
        (background,) = (
            each for each in imgui.get_draw_data().cmd_lists if each._owner_name == BACKGROUND
        )
        tops = [v.pos.y for v in background.vtx_buffer if 380 < v.pos.x < 600]
        assert min(tops) >= window.pos.y + window.size.y


def test_the_menu_of_a_person_makes_them_softer_or_silent_and_the_list_shows_it(hand: Hand) -> None:
    eve = replace(ADA, place=3, has_voice=True, is_voice_muted=True)
    call, state = replace(VIEW, status=replace(STATUS, participants=(ME, eve))), replace(STATE)
    state.volumes = {}
    assert [sign[0] for sign in signs_of(eve, is_encrypted=False)] == [
        icons.ICON_FA_MICROPHONE_SLASH
    ]
    for label, volume in (("Mute for me", 0.0), ("##volume", 1.0), ("Mute for me", 0.0)):
        clicking(hand, participants_panel, state, call, "More on Ada")
        clicking(hand, participants_panel, state, call, label)
        hand.press(imgui.Key.escape, lambda metrics: participants_panel(state, call, metrics))
        assert state.volumes == {3: pytest.approx(volume, abs=0.05)}
    assert signs_of(eve, is_encrypted=False, volume=0.0)[1][0] == icons.ICON_FA_VOLUME_XMARK
    clicking(hand, participants_panel, state, call, "More on Ada")
    clicking(hand, participants_panel, state, call, "Hear again")
    assert state.volumes == {3: 1.0}


def test_devices_are_changed_during_a_call_and_another_voice_needs_rejoining(hand: Hand) -> None:
    sound = SoundState(
        microphones=("Desk",),
        speakers=("Horn",),
        speaker=DeviceState("Horn", "no loudspeaker 'Old'; 'Horn' is used"),
        cleaning="echo cancellation is missing: pip install 'pica-telepresence[echo]'",
    )
    mine = Identity("Me", "", "performance:talk", "mic")
    state = ViewState(side="settings", own_face="sent", own_voice="sent", avatars=("nora",))
    state.identity = state.entered = mine
    call = CallView(sound=sound)
    clicking(hand, settings_panel, state, call, "Sound")
    assert "no loudspeaker 'Old'" in texts(hand, settings_panel, call, state)
    for label in ("##microphone", "Desk", "Voices come from their seats"):
        clicking(hand, settings_panel, state, call, label)
    assert state.sound == SoundSettings(microphone="Desk", is_stereo=False)
    assert clicking(hand, settings_panel, state, call, "Play a test") == [Action.TEST_SOUND]
    for label in ("##microphone", "Off: only listen"):
        clicking(hand, settings_panel, state, call, label)
    assert state.voice == "none"
    assert clicking(hand, settings_panel, state, call, "Join again as this") == [Action.REJOIN]


AS_ADMIN = replace(
    VIEW,
    status=replace(
        STATUS,
        participants=(ME, replace(ADA, has_voice=True, identity="ada-1"), BEN),
        is_admin=True,
    ),
)


@pytest.mark.parametrize(
    ("item", "asked"),
    [
        ("Mute voice", MutePeer(peer_id="p1", kind="voice", is_muted=True)),
        ("Mute face", MutePeer(peer_id="p1", kind="face", is_muted=True)),
        ("Remove", RemovePeer(peer_id="p1")),
    ],
)
def test_an_admins_menu_of_a_person_moderates(hand: Hand, item: str, asked: Request) -> None:
    clicking(hand, participants_panel, STATE, AS_ADMIN, "More on Ada")
    assert clicking(hand, participants_panel, STATE, AS_ADMIN, item) == [asked]


def test_an_admin_bars_a_person_and_lifts_the_bar_once_they_are_gone(hand: Hand) -> None:
    state = replace(STATE, barred={})
    clicking(hand, participants_panel, state, AS_ADMIN, "More on Ada")
    asked = clicking(hand, participants_panel, state, AS_ADMIN, "Bar until the room is empty")
    assert asked == [BarIdentity(identity="ada-1", is_barred=True)]
    gone = replace(AS_ADMIN, status=replace(AS_ADMIN.status, participants=(ME, BEN)))
    asked = clicking(hand, participants_panel, state, gone, "Let Ada rejoin")
    assert asked == [BarIdentity(identity="ada-1", is_barred=False)]
    assert state.barred == {}


def test_who_is_no_admin_finds_nothing_to_moderate_with(hand: Hand) -> None:
    call = replace(AS_ADMIN, status=replace(AS_ADMIN.status, is_admin=False))
    clicking(hand, participants_panel, STATE, call, "More on Ada")
    words = ("Mute voice", "Mute face", "Remove", "Bar until")
    assert not any(word in label for label in hand.places for word in words)
