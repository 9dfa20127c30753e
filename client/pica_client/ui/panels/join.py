"""The form that asks where to go and under which identity, and the card shown while connecting."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx, imspinner

from pica_client.ui.join_form import (
    MAX_CHARACTERS,
    SECRETS,
    SOURCES,
    JoinForm,
    Trouble,
)
from pica_client.ui.panels.settings import MICROPHONE, microphone_picker, sound_settings
from pica_client.ui.state import ViewState
from pica_client.ui.surface import widgets
from pica_client.ui.surface.style import BUTTON_PT, EDGE_PT, GAP_PT, PADDING_PT, SMALL_PT, Metrics
from pica_client.voice.sound.settings import SoundState

WIDTH_PT = 420.0
PORTRAIT_PT = 68.0
CANCEL_PT = 240.0
LABELS = {
    "url": ("Relay, or an invite link", "wss://relay.example"),
    "room": ("Room", "lobby"),
    "name": ("Your name", ""),
    "token": ("Token", "only if the relay wants one"),
    "ca_file": ("CA file", "of a relay with a certificate of its own"),
    "secret_file": ("Room secret file", "for rooms that are encrypted end to end"),
    "avatar": ("Avatar file", "instead of one of the pictures"),
}
FOLDED = imgui.TreeNodeFlags_.no_tree_push_on_open | imgui.TreeNodeFlags_.span_avail_width


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinView:
    """What the form shows besides what is typed."""

    portraits: Mapping[str, int] = field(default_factory=dict)
    """Pictures of the avatars to choose from, by name, as numbers of the surface."""
    default_avatar: str = ""
    """The avatar that is worn when none is chosen, by name."""
    sound: SoundState | None = None
    """How sound stands; None: there is none."""


def join_panel(form: JoinForm, view: JoinView, metrics: Metrics) -> None:
    """Draw the form, and tell it what was typed and pressed."""
    columns, rows = metrics.size
    edge = metrics.px(EDGE_PT)
    width = min(metrics.px(WIDTH_PT), columns - 2 * edge)
    form.shows_meters = form.wants_test = False
    imgui.set_next_window_size_constraints((width, 0), (width, rows - 2 * edge))
    flags = widgets.FIXED & ~imgui.WindowFlags_.no_nav
    with widgets.card("join", (columns / 2, rows / 2), metrics, pivot=(0.5, 0.5), flags=flags):
        widgets.title("Join a call")
        # What does not fit is scrolled to; the button stays in sight.
        room = rows - 2 * edge - 2 * metrics.px(PADDING_PT + GAP_PT + BUTTON_PT)
        imgui.set_next_window_size_constraints((0, 0), (columns, max(room, metrics.px(60))))
        padded = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
        # Room for the ring around the field in use.
        imgui.push_style_var(imgui.StyleVar_.window_padding, (metrics.px(3), metrics.px(3)))
        imgui.begin_child("fields", (0, 0), padded)
        imgui.pop_style_var()
        if form.trouble is not None:
            _trouble(form.trouble, metrics)
        before = replace(form.state)
        _fields(form, view, metrics)
        if form.state != before:
            form.typed()
        imgui.end_child()
        wide = imgui.get_content_region_avail().x
        if widgets.action_button("Join", metrics, tone="accent", width=wide):
            form.join()
    if not imgui.is_popup_open("", imgui.PopupFlags_.any_popup_id):
        enters = (imgui.Key.enter, imgui.Key.keypad_enter)
        if any(imgui.is_key_pressed(key, repeat=False) for key in enters):
            form.join()
        if imgui.is_key_pressed(imgui.Key.escape, repeat=False):
            form.outcome = "leave"


def connecting_panel(what: str, metrics: Metrics) -> bool:
    """Say what is being waited for; return True once the user does not want to wait."""
    (columns, rows), px = metrics.size, metrics.px
    # Of a size that is known: ImGui shows no card while it learns its size, and there may be one
    # frame alone.
    height = 2 * px(PADDING_PT) + imgui.get_frame_height() + px(38) + px(GAP_PT)
    size = (px(CANCEL_PT) + 2 * px(PADDING_PT), height)
    with widgets.card("connecting", (columns / 2, rows / 2), metrics, pivot=(0.5, 0.5), size=size):
        accent = imgui.ImColor(*metrics.palette.accent)
        clear = imgui.ImColor(0.0, 0.0, 0.0, 0.0)
        imspinner.spinner_ang("spinner", px(9), px(3), accent, clear, speed=5.0, angle=4.2)
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text_unformatted(what)
        is_cancelled = widgets.action_button("Cancel", metrics, width=px(CANCEL_PT))
    return is_cancelled or imgui.is_key_pressed(imgui.Key.escape, repeat=False)


def _trouble(trouble: Trouble, metrics: Metrics) -> None:
    """What went wrong and what helps, with the raw error folded away."""
    imgui.push_style_color(imgui.Col_.child_bg, (*metrics.palette.alert[:3], 0.14))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (metrics.px(12), metrics.px(10)))
    flags = imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.auto_resize_y
    imgui.begin_child("trouble", (0, 0), flags)
    imgui.text_wrapped(f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}  {trouble.what}")
    if trouble.remedy:
        widgets.note(trouble.remedy, metrics)
    if trouble.details and imgui.tree_node("Details"):
        widgets.note(trouble.details, metrics)
        imgui.tree_pop()
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()


def _fields(form: JoinForm, view: JoinView, metrics: Metrics) -> None:
    """All fields, which write what is typed into the state."""
    state = form.state
    empty = ""
    if imgui.is_window_appearing():
        empty = next((name for name in ("url", "room", "name") if not getattr(state, name)), "")
        imgui.set_next_window_focus()
    _field(state, "url", focus=empty == "url")
    half = (imgui.get_content_region_avail().x - metrics.px(GAP_PT)) / 2
    left, top = imgui.get_cursor_pos()
    with imgui_ctx.begin_group():
        _field(state, "room", width=half, focus=empty == "room")
    imgui.set_cursor_pos((left + half + metrics.px(GAP_PT), top))
    with imgui_ctx.begin_group():
        _field(state, "name", width=half, focus=empty == "name")
    if view.portraits:
        _avatars(state, view, metrics)
    widgets.note("Your face", metrics)
    state.source = widgets.choice_of("##source", SOURCES, state.source or "")
    if view.sound is not None:
        widgets.note("Your microphone", metrics)
        microphone_picker(state, view.sound, may_be_off=True)
        if imgui.tree_node_ex("Try the sound", FOLDED):
            form.shows_meters = True
            has_microphone = state.voice == MICROPHONE
            form.wants_test = sound_settings(
                state, view.sound, metrics, has_microphone=has_microphone
            )
    if imgui.tree_node_ex("More", FOLDED):
        for name in ("token", "secret_file", "ca_file", "avatar"):
            _field(state, name)


def _field(state: ViewState, name: str, *, width: float = -1.0, focus: bool = False) -> None:
    """A line of text with its label above it."""
    label, example = LABELS[name]
    with widgets.type_size(SMALL_PT):
        imgui.text_disabled(label)
    imgui.set_next_item_width(width)
    if focus:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.password if name in SECRETS else 0
    _, typed = imgui.input_text_with_hint(f"##{name}", example, getattr(state, name), flags)
    setattr(state, name, typed[:MAX_CHARACTERS])


def _avatars(state: ViewState, view: JoinView, metrics: Metrics) -> None:
    """A row of pictures; the one that is worn has a frame."""
    widgets.note("Your avatar", metrics)
    gap, edge, count = metrics.px(4), metrics.px(2.5), len(view.portraits)
    room = (imgui.get_content_region_avail().x - (count - 1) * gap) / count
    side = min(metrics.px(PORTRAIT_PT), room) - 2 * edge
    worn = state.avatar or view.default_avatar
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (edge, edge))
    imgui.push_style_var(imgui.StyleVar_.image_rounding, metrics.px(6))
    for number, (name, texture) in enumerate(view.portraits.items()):
        if number:
            imgui.same_line(0, gap)
        frame = metrics.palette.accent if name == worn else metrics.palette.card
        imgui.push_style_color(imgui.Col_.button, frame)
        picture = imgui.ImTextureRef(texture)
        if imgui.image_button(f"avatar {name}", picture, (side, side)):
            state.avatar = "" if state.avatar == name else name
        imgui.pop_style_color()
        by_default = "" if state.avatar else ": by default it goes by your name"
        widgets.hint(f"{name.title()}{by_default}")
    imgui.pop_style_var(2)
