"""The panels about people: the list with its menus, the page while waiting, the settings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import pytest

from helpers.hand import Hand, open_hand
from pica_client.call.participants import Participant
from pica_client.call.status import CallStatus
from pica_client.publish.face_desk import Seen
from pica_client.render.scene import head_rect_px
from pica_client.render.seats import (
    LAYOUTS,
    FreeShares,
    Layout,
    plan_seats,
)
from pica_client.render.views import (
    ViewState,
    plan_camera,
)
from pica_client.ui.call_view import CallView, OwnFaceView, Panel, PersonView
from pica_client.ui.controls import (
    ChooseLayout,
    ControlState,
    CopyText,
    Order,
    Pin,
    SetVolume,
    UserOrder,
)
from pica_client.ui.notice_board import Notice
from pica_client.ui.panels.control_bar import bar_share
from pica_client.ui.panels.names import names
from pica_client.ui.panels.participants import participants_panel, signs_of
from pica_client.ui.panels.self_view import self_view, self_view_px
from pica_client.ui.panels.settings import settings_panel
from pica_client.ui.panels.signs import (
    NO_FACE,
    compact_sign,
    own_sign,
    signs,
)
from pica_client.ui.panels.statistics import statistics
from pica_client.ui.panels.upper_edge import call_signs, signs_share
from pica_client.ui.panels.waiting import first_hint, waiting_page
from pica_client.ui.settings import OwnChoice, Settings
from pica_client.ui.surface import icons
from pica_client.ui.surface.surface import BACKGROUND
from pica_client.ui.surface.theme import Metrics, metrics_for
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
VIEW = CallView(
    now=1.0,
    state=ControlState(own_face="sent", side="participants"),
    people=(PersonView(peer_id="p1", name="Ada", is_speaking=True),),
    status=STATUS,
)
SETTINGS = replace(VIEW, state=ControlState(own_face="sent", side="settings"))
ALONE = CallView(now=1.0, state=ControlState(), status=replace(STATUS, participants=(ME,)))


@pytest.fixture
def hand() -> Iterator[Hand]:
    with open_hand() as found:
        yield found


def texts(hand: Hand, panel: Panel, view: CallView) -> str:
    """All that a panel writes."""
    written: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        for module in ("widgets", "participants"):
            place = "surface" if module == "widgets" else "panels"
            name = f"pica_client.ui.{place}.{module}.imgui.text_unformatted"
            patch.setattr(name, written.append)
        hand.frame(lambda metrics: panel(view, metrics))
    return "\n".join(written)


@pytest.mark.parametrize(
    ("item", "order"),
    [
        ("Pin", Pin(1)),
        ("Statistics", Order.STATISTICS),
        ("Reset the view", Order.RESET_VIEW),
    ],
)
def test_the_menu_of_a_person_pins_shows_statistics_and_resets_the_view(
    hand: Hand, item: str, order: object
) -> None:
    assert hand.click("More on Ada", lambda metrics: participants_panel(VIEW, metrics)) == []
    assert hand.click(item, lambda metrics: participants_panel(VIEW, metrics)) == [order]


def test_who_watches_cannot_be_pinned_and_oneself_has_no_menu(hand: Hand) -> None:
    hand.click("More on Ben", lambda metrics: participants_panel(VIEW, metrics))
    assert not any("Pin" in label for label in hand.places)
    assert any("Statistics" in label for label in hand.places)
    assert not any("More on Me" in label for label in hand.places)


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
    assert "Nobody else here is verified yet" in texts(hand, participants_panel, waiting)


def test_signs_beside_a_name_have_a_meaning() -> None:
    assert [icon for icon, _, _ in signs_of(BEN, is_encrypted=False)] == [
        icons.RECORD,
        icons.WATCHING,
    ]
    odd = replace(ADA, face="muted", is_assured=True)
    assert [icon for icon, _, _ in signs_of(odd, is_encrypted=True)] == [
        icons.FACE_OFF,
        icons.WARNING,
        icons.CHECK,
    ]
    verified = signs_of(replace(ADA, is_verified=True), is_encrypted=True)
    assert [icon for icon, _, _ in verified] == [icons.LOCK]
    assert signs_of(ME, is_encrypted=True) == []


@pytest.mark.parametrize(
    ("panel", "view"), [(participants_panel, VIEW), (waiting_page, ALONE)], ids=["list", "page"]
)
def test_the_invitation_can_be_copied(hand: Hand, panel: Panel, view: CallView) -> None:
    for _ in range(3):
        hand.frame(lambda metrics: panel(view, metrics))
    (order,) = hand.click("Copy the invitation", lambda metrics: panel(view, metrics))
    assert order == CopyText(INVITATION, "Invitation copied")


def test_who_is_alone_reads_where_and_who_only_watches(hand: Hand) -> None:
    said = texts(hand, waiting_page, ALONE)
    assert "Waiting for others" in said
    assert "You are in the room standup." in said
    assert "watch" not in said
    watched = replace(ALONE, status=replace(STATUS, participants=(ME, BEN)))
    assert "One person watches. Nobody else shows a face." in texts(hand, waiting_page, watched)


@pytest.mark.parametrize(
    "view",
    [
        replace(ALONE, people=VIEW.people),
        replace(ALONE, status=CallStatus()),
        replace(ALONE, status=replace(STATUS, is_connected=False)),
        replace(ALONE, state=ControlState(asks_to_leave=True)),
    ],
    ids=["not alone", "no call", "connection lost", "leaving"],
)
def test_the_page_of_who_waits_is_away_when_it_has_nothing_to_say(
    hand: Hand, view: CallView
) -> None:
    assert texts(hand, waiting_page, view) == ""


def test_each_setting_is_one_click(hand: Hand) -> None:
    def show(metrics: object) -> list[object]:
        return settings_panel(SETTINGS, metrics)  # type: ignore[arg-type, return-value]

    given = Settings()
    hand.click("View", show)
    assert hand.click("Grid", show) == [ChooseLayout("grid")]
    assert hand.click("Statistics", show) == [Order.STATISTICS]
    assert hand.click("My own face", show) == [replace(given, shows_self=False)]
    assert hand.click("Light", show) == [replace(given, mode="light")]
    assert hand.click("125%", show) == [replace(given, scale=1.25)]
    (order, *_) = hand.click("##detail", show)
    assert isinstance(order, Settings)
    assert order.detail == pytest.approx(0.55, abs=0.1)  # the middle of 10 to 100 %


def test_source_avatar_and_name_are_chosen_during_the_call(hand: Hand) -> None:
    me = OwnChoice(name="Me", source="livelink")
    state = replace(SETTINGS.state, choice=me, entered_as=me, avatars=("amara", "nora"))
    own = OwnFaceView(source="livelink", seen=Seen(True, (), None))
    view = replace(SETTINGS, state=state, own=own)

    def show(metrics: object) -> list[object]:
        return settings_panel(view, metrics)  # type: ignore[arg-type, return-value]

    hand.click("##source", show)
    assert hand.click("VTuber", show) == [replace(me, source="vmc")]
    assert hand.click("Calibrate", show) == [Order.CALIBRATE]
    hand.click("##avatar", show)
    assert hand.click("Nora", show) == [replace(me, avatar="nora")]
    assert not any("Come again" in label for label in hand.places)
    view = replace(view, state=replace(state, choice=replace(me, avatar="nora")))
    assert hand.click("Come again", show) == [Order.REJOIN]


def test_a_tracker_without_a_face_is_a_sign() -> None:
    assert own_sign(replace(VIEW, own=OwnFaceView(seen=Seen(False, (), None)))) == NO_FACE


def test_who_sends_no_face_is_not_asked_whether_to_show_it(hand: Hand) -> None:
    watching = replace(SETTINGS, state=ControlState(side="settings"))
    hand.frame(lambda metrics: settings_panel(watching, metrics))
    assert "My own face" not in hand.places


def test_the_first_hint_is_dismissed_by_a_button(hand: Hand) -> None:
    view = replace(ALONE, state=ControlState(shows_hint=True))
    assert hand.click("Got it", lambda metrics: first_hint(view, metrics)) == [Order.DISMISS_HINT]
    assert "join with a face source" in texts(hand, first_hint, view)
    sending = replace(view, state=ControlState(shows_hint=True, own_face="sent"))
    assert "join with a face source" not in texts(hand, first_hint, sending)
    assert texts(hand, first_hint, ALONE) == ""


def test_a_small_picture_has_one_line_for_what_matters_most() -> None:
    call = replace(VIEW, state=ControlState())
    assert compact_sign(VIEW) is None  # a panel stands there
    told = replace(call, notices=(Notice("Saved", "accent"), Notice("Ada left", "plain")))
    assert compact_sign(call) == ("Ben records", "alert")
    assert compact_sign(told) == ("Ada left", "plain")
    assert compact_sign(replace(call, is_recording=True)) == ("Ben records", "alert")
    alone = replace(ALONE, is_recording=True)
    assert compact_sign(alone) == ("Recording", "alert")
    assert compact_sign(replace(alone, status=CallStatus())) == ("Recording", "alert")
    lost = replace(told, status=replace(STATUS, is_connected=False, away_s=3.0))
    assert compact_sign(lost) == ("Connection lost – coming back … 3 s", "alert")
    assert compact_sign(replace(call, status=CallStatus())) is None
    hinted = replace(VIEW, state=ControlState(shows_hint=True))
    assert compact_sign(hinted) is None
    with open_hand((320, 240)) as small:
        show = partial(first_hint, hinted)
        assert small.click("Got it", show) == [Order.DISMISS_HINT]
        assert small.where("Got it")[3] <= signs_share(VIEW, metrics_for((320, 240))) * 240


def test_on_a_small_picture_that_is_recorded_no_sign_stands_on_names() -> None:
    view = replace(ALONE, is_recording=True, shows_bar=False)
    with open_hand((320, 240)) as small:
        small.frame(lambda metrics: signs(view, metrics))
        (shapes,) = small.surface.draw_data().cmd_lists
        lowest = max(vertex.pos.y for vertex in shapes.vtx_buffer)
        assert lowest <= signs_share(view, small.surface.metrics) * 240


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [1, 2, 5, 7])
def test_on_a_small_picture_no_head_reaches_into_that_line(layout: Layout, count: int) -> None:
    metrics = metrics_for((320, 240))
    share = signs_share(VIEW, metrics)
    free = FreeShares(top=share, bottom=bar_share(metrics))
    for pinned in (None, 0):
        plan = plan_seats(layout, count, 320 / 240, pinned=pinned, free=free)
        camera = plan_camera(plan, ViewState(), 320, 240)
        for seat in plan.seats:
            rect = head_rect_px(camera, seat)
            assert rect is not None
            assert rect[1] >= share * 240 - 4


def test_where_one_is_and_who_records_stands_on_the_picture() -> None:
    assert call_signs(replace(VIEW, status=CallStatus())) == []
    assert call_signs(VIEW) == [("standup   4:07", "good"), ("Ben records", "alert")]
    both = (replace(ME, is_recording=True), replace(ADA, is_recording=True), BEN)
    lost = replace(STATUS, participants=both, is_connected=False, is_encrypted=True)
    assert call_signs(replace(VIEW, status=lost)) == [
        (f"{icons.LOCK}  standup   4:07", "alert"),
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
        for panel in (participants_panel, signs, settings_panel, waiting_page, self_view):
            for _ in range(2):
                hand.frame(lambda metrics, panel=panel: panel(view, metrics))  # type: ignore[misc]
                assert all(right <= size[0] for _, _, right, _ in hand.places.values())


def test_ones_own_face_is_shown_where_there_is_room(hand: Hand) -> None:
    assert self_view_px(metrics_for((320, 240))) == 0
    assert self_view_px(metrics_for((1280, 720))) > 80
    for own_face in ("sent", "frozen", "muted"):
        state = ControlState(own_face=own_face)  # type: ignore[arg-type]
        has_face = own_face != "frozen"
        own = OwnFaceView(texture=1, seen=Seen(has_face, (("Jaw", 2.0),), None))
        shown = replace(VIEW, state=state, own=own)
        assert hand.frame(lambda metrics, shown=shown: self_view(shown, metrics)) == []  # type: ignore[misc]


def test_the_statistics_begin_below_the_signs_of_the_call(hand: Hand) -> None:
    from imgui_bundle import imgui

    state = ControlState(show_statistics=True)
    tops = []
    for participants in ((ME, ADA), (ME, ADA, BEN)):
        view = replace(VIEW, state=state, status=replace(STATUS, participants=participants))
        hand.frame(lambda metrics, view=view: statistics(view, metrics))  # type: ignore[misc]
        window = imgui.internal.find_window_by_name("statistics")
        tops.append(window.pos.y)
    assert tops[1] > tops[0] > 36


def test_the_dot_of_who_speaks_is_a_glyph_and_so_round_at_every_size(hand: Hand) -> None:
    corners = []
    for is_speaking in (False, True):
        person = PersonView(
            peer_id="p1", name="Ada", is_speaking=is_speaking, label_px=(9, 9, 200, 60)
        )
        view = replace(VIEW, people=(person,))
        hand.frame(lambda metrics, view=view: names(view, metrics))  # type: ignore[misc]
        corners.append(sum(each.vtx_buffer.size() for each in hand.surface.draw_data().cmd_lists))
    assert corners[1] - corners[0] == 4


def test_a_long_notice_stands_below_the_signs_at_the_left() -> None:
    short, long = (
        Notice("Saved", "accent"),
        Notice("No sound: " + "something is away, " * 9, "alert"),
    )
    tops = []
    for notice in (short, long):
        with open_hand((640, 480)) as hand:
            view = replace(VIEW, notices=(notice,))
            hand.frame(lambda metrics, view=view: signs(view, metrics))  # type: ignore[misc]
            (shapes,) = hand.surface.draw_data().cmd_lists
            tops.append(min(vertex.pos.y for vertex in shapes.vtx_buffer if vertex.pos.x > 300))
            signs_end = hand.surface.metrics.px(12 + 36 * len(call_signs(view)))
    assert tops[0] < 20
    assert tops[1] >= signs_end - 1


@pytest.mark.parametrize("count", [1, 3, 16])
def test_notices_stand_below_the_statistics(count: int) -> None:
    from imgui_bundle import imgui

    view = replace(
        ALONE,
        state=ControlState(show_statistics=True),
        people=VIEW.people * count,
        notices=(Notice("Saved recording-0001.mp4 in /home/ada/Videos", "accent"),),
        figures=tuple((f"figure {number}", "1000 kbit/s") for number in range(8)),
    )
    with open_hand((960, 540)) as hand:
        for _ in range(3):
            hand.frame(lambda metrics: [*signs(view, metrics), *statistics(view, metrics)])
        window = imgui.internal.find_window_by_name("statistics")
        (background,) = (
            each for each in hand.surface.draw_data().cmd_lists if each._owner_name == BACKGROUND
        )
        tops = [v.pos.y for v in background.vtx_buffer if 380 < v.pos.x < 600]
        assert min(tops) >= window.pos.y + window.size.y


def test_the_menu_of_a_person_makes_them_softer_or_silent_and_the_list_shows_it(hand: Hand) -> None:
    eve = replace(ADA, place=3, has_voice=True, is_voice_muted=True)
    view = replace(VIEW, status=replace(STATUS, participants=(ME, eve)))

    def show(metrics: Metrics) -> list[UserOrder]:
        return participants_panel(view, metrics)

    assert [sign[0] for sign in signs_of(eve, is_encrypted=False)] == [icons.VOICE_OFF]
    hand.click("More on Ada", show)
    assert hand.click("Mute for me", show) == [SetVolume(3, 0.0)]
    view = replace(view, state=replace(view.state, volumes={3: 0.0}))
    assert signs_of(eve, is_encrypted=False, volume=0.0)[1][0] == icons.SPEAKER_OFF
    hand.click("More on Ada", show)
    (changed,) = {order for order in hand.click("##volume", show) if order != SetVolume(3, 0.0)}
    assert changed == SetVolume(3, pytest.approx(1.0, abs=0.05))
    hand.click("More on Ada", show)
    assert hand.click("Hear again", show) == [SetVolume(3, 1.0)]


def test_devices_are_changed_during_a_call_and_another_voice_needs_coming_again(
    hand: Hand,
) -> None:
    state = SoundState(
        microphones=("Desk",),
        speakers=("Horn",),
        speaker=DeviceState("Horn", "no loudspeaker 'Old'; 'Horn' is used"),
        cleaning="echo cancellation is missing: pip install 'pica-telepresence[echo]'",
    )
    mine = OwnChoice(name="Me", source="performance:talk", voice="mic")
    control = ControlState(side="settings", own_face="sent", own_voice="sent", choice=mine)
    control = replace(control, entered_as=mine, avatars=("nora",))
    view = CallView(now=1.0, state=control, sound=state)

    def show(metrics: Metrics) -> list[UserOrder]:
        return settings_panel(view, metrics)

    hand.click("Sound", show)
    assert "no loudspeaker 'Old'" in texts(hand, settings_panel, view)
    hand.click("##microphone", show)
    assert hand.click("Desk", show) == [SoundSettings(microphone="Desk")]
    assert hand.click("Voices come from their seats", show) == [SoundSettings(is_stereo=False)]
    assert Order.TEST_SOUND in hand.click("Play a test sound", show)
    hand.click("##microphone", show)
    assert hand.click("Off: only listen", show) == [replace(mine, voice="none")]
    view = replace(view, state=replace(control, choice=replace(mine, voice="none")))
    assert hand.click("Come again as this", show) == [Order.REJOIN]


ADA_OF_TOKENS = replace(ADA, has_voice=True, identity="ada-1")
AS_ADMIN = replace(
    VIEW, status=replace(STATUS, participants=(ME, ADA_OF_TOKENS, BEN), is_admin=True)
)


@pytest.mark.parametrize(
    ("item", "asked"),
    [
        ("Mute voice", MutePeer(peer_id="p1", kind="voice", is_muted=True)),
        ("Mute face", MutePeer(peer_id="p1", kind="face", is_muted=True)),
        ("Remove", RemovePeer(peer_id="p1")),
        ("Bar until the room is empty", BarIdentity(identity="ada-1", is_barred=True)),
    ],
)
def test_an_admins_menu_of_a_person_moderates(hand: Hand, item: str, asked: object) -> None:
    hand.click("More on Ada", lambda metrics: participants_panel(AS_ADMIN, metrics))
    assert hand.click(item, lambda metrics: participants_panel(AS_ADMIN, metrics)) == [asked]


def test_an_admin_lets_go_on_what_is_muted_and_bars_nobody_without_an_identity(hand: Hand) -> None:
    eve = replace(ADA, has_voice=True, muted_kinds=frozenset({"voice"}))
    view = replace(VIEW, status=replace(STATUS, participants=(ME, eve), is_admin=True))
    hand.click("More on Ada", lambda metrics: participants_panel(view, metrics))
    assert not any("Bar until" in label for label in hand.places)
    assert hand.click("Unmute voice", lambda metrics: participants_panel(view, metrics)) == [
        MutePeer(peer_id="p1", kind="voice", is_muted=False)
    ]


def test_who_is_no_admin_finds_nothing_to_moderate_with(hand: Hand) -> None:
    view = replace(AS_ADMIN, status=replace(AS_ADMIN.status, is_admin=False))
    hand.click("More on Ada", lambda metrics: participants_panel(view, metrics))
    words = ("Mute voice", "Mute face", "Remove", "Bar until")
    assert not any(word in label for label in hand.places for word in words)
