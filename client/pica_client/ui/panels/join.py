"""The form that asks where to go and as whom, and what stands there while the way is made."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from imgui_bundle import imgui, imgui_ctx

from pica_client.ui.join_form import MAX_CHARACTERS, SECRETS, SOURCES, JoinRequest
from pica_client.ui.panels.control_bar import EDGE_PT
from pica_client.ui.panels.sound import MICROPHONE, microphone_picker, sound_part
from pica_client.ui.state import ViewState
from pica_client.ui.surface import icons, widgets
from pica_client.ui.surface.theme import BUTTON_PT, GAP_PT, PADDING_PT, SMALL_PT, Metrics
from pica_client.ui.trouble import Trouble
from pica_client.voice.sound.settings import SoundState

WIDTH_PT = 420.0
PORTRAIT_PT = 62.0
LABELS = {
    "url": ("Relay, or an invite link", "wss://relay.example"),
    "room": ("Room", "lobby"),
    "name": ("Your name", ""),
    "token": ("Token", "only if the relay wants one"),
    "ca_file": ("CA file", "of a relay with a certificate of its own"),
    "secret_file": ("Room secret file", "to meet those who encrypt"),
    "avatar": ("Avatar file", "instead of one of the pictures"),
}
KEYS = imgui.WindowFlags_.no_nav
FOLDED = imgui.TreeNodeFlags_.no_tree_push_on_open | imgui.TreeNodeFlags_.span_avail_width


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinView:
    """What the form shows."""

    state: ViewState
    trouble: Trouble | None = None
    portraits: Mapping[str, int | None] = field(default_factory=dict)
    """Pictures of the avatars to choose from by name, as numbers of textures; None while a picture
    is being drawn."""
    default_avatar: str = ""
    """The avatar that who chooses none gets, by name."""
    sound: SoundState | None = None
    """How sound stands; None: there is none."""


def join_panel(view: JoinView, metrics: Metrics) -> list[JoinRequest]:
    """Draw the form; gives what was typed and pressed."""
    columns, rows = metrics.size
    edge = metrics.px(EDGE_PT)
    width = min(metrics.px(WIDTH_PT), columns - 2 * edge)
    requests: list[JoinRequest] = []
    imgui.set_next_window_size_constraints((width, 0), (width, rows - 2 * edge))
    place = (columns / 2, rows / 2)
    with widgets.card("join", place, metrics, pivot=(0.5, 0.5), flags=widgets.FIXED & ~KEYS):
        widgets.title("Join a call")
        # What does not fit is scrolled to; the button stays in sight.
        room = rows - 2 * edge - 2 * metrics.px(PADDING_PT + GAP_PT + BUTTON_PT)
        imgui.set_next_window_size_constraints((0, 0), (columns, max(room, metrics.px(60))))
        imgui.begin_child("fields", (0, 0), imgui.ChildFlags_.auto_resize_y)
        if view.trouble is not None:
            _trouble(view.trouble, metrics)
        before = replace(view.state)
        _fields(view, metrics, requests)
        if view.state != before:
            requests.append("typed")
        imgui.end_child()
        wide = imgui.get_content_region_avail().x
        if widgets.action_button("Join", metrics, tone="accent", width_px=wide):
            requests.append("join")
    is_open = imgui.is_popup_open("", imgui.PopupFlags_.any_popup_id)
    enters = (imgui.Key.enter, imgui.Key.keypad_enter)
    is_entered = any(imgui.is_key_pressed(key, repeat=False) for key in enters)
    if is_entered and not is_open and "join" not in requests:
        requests.append("join")
    if imgui.is_key_pressed(imgui.Key.escape, repeat=False) and not is_open:
        requests.append("leave")
    return requests


def connecting_panel(what: str, metrics: Metrics, now: float) -> bool:
    """Say what is being waited for; True once the user does not want to wait."""
    (columns, rows), px = metrics.size, metrics.px
    # Of a size that is known: ImGui shows no card while it learns its size, and there may be one
    # frame alone.
    height = 2 * px(PADDING_PT) + imgui.get_frame_height() + px(2 + 38) + 2 * px(GAP_PT)
    size = (px(240) + 2 * px(PADDING_PT), height)
    with widgets.card("connecting", (columns / 2, rows / 2), metrics, pivot=(0.5, 0.5), size=size):
        _spinner(metrics, now)
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text_unformatted(what)
        imgui.dummy((0, metrics.px(2)))
        is_cancelled = widgets.action_button("Cancel", metrics, width_px=metrics.px(240))
    return is_cancelled or imgui.is_key_pressed(imgui.Key.escape, repeat=False)


def _trouble(trouble: Trouble, metrics: Metrics) -> None:
    """What went wrong and what helps, with the raw error folded away."""
    alert = metrics.palette.alert
    imgui.push_style_color(imgui.Col_.child_bg, (*alert[:3], 0.14))
    flags = imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.auto_resize_y
    imgui.push_style_var(imgui.StyleVar_.window_padding, (metrics.px(12), metrics.px(10)))
    imgui.begin_child("trouble", (0, 0), flags)
    imgui.text_wrapped(f"{icons.WARNING}  {trouble.what}")
    if trouble.remedy:
        widgets.note(trouble.remedy, metrics)
    if trouble.details:
        with widgets.type_size(SMALL_PT):
            is_open = imgui.tree_node("Details")
        if is_open:
            widgets.note(trouble.details, metrics)
            imgui.tree_pop()
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()


def _fields(view: JoinView, metrics: Metrics, requests: list[JoinRequest]) -> None:
    """All fields, which write what is typed into the state."""
    state, empty = view.state, ""
    if imgui.is_window_appearing():
        empty = next((name for name in ("url", "room", "name") if not getattr(state, name)), "")
        imgui.set_next_window_focus()
    _field(state, "url", focus=empty == "url")
    half = (imgui.get_content_region_avail().x - metrics.px(GAP_PT)) / 2
    left, top = imgui.get_cursor_pos()
    with imgui_ctx.begin_group():
        _field(state, "room", width_px=half, focus=empty == "room")
    imgui.set_cursor_pos((left + half + metrics.px(GAP_PT), top))
    with imgui_ctx.begin_group():
        _field(state, "name", width_px=half, focus=empty == "name")
    if view.portraits:
        _avatars(view, metrics)
    widgets.note("Your face", metrics)
    state.source = widgets.choice_of("##source", SOURCES, state.source or "")
    if view.sound is not None:
        _sound(state, view.sound, metrics, requests)
    if imgui.tree_node_ex("More", FOLDED):
        for name in ("token", "secret_file", "ca_file", "avatar"):
            _field(state, name)


def _sound(
    state: ViewState, sound: SoundState, metrics: Metrics, requests: list[JoinRequest]
) -> None:
    """The microphone; and, once they are wanted, meters and loudspeaker to try."""
    widgets.note("Your microphone", metrics)
    state.voice, microphone = microphone_picker(state.voice or "none", state.sound, sound)
    state.sound = replace(state.sound, microphone=microphone)
    if imgui.tree_node_ex("Try the sound", FOLDED):
        requests.append("show meters")
        has_microphone = state.voice == MICROPHONE
        state.sound, wants_test = sound_part(
            state.sound, sound, metrics, has_microphone=has_microphone
        )
        if wants_test:
            requests.append("test sound")


def _field(state: ViewState, name: str, *, width_px: float = -1.0, focus: bool = False) -> None:
    """A line of text with its label above it."""
    label, example = LABELS[name]
    with widgets.type_size(SMALL_PT):
        imgui.text_disabled(label)
    imgui.set_next_item_width(width_px)
    if focus:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.password if name in SECRETS else 0
    with widgets.ringed():
        _, typed = imgui.input_text_with_hint(f"##{name}", example, getattr(state, name), flags)
    setattr(state, name, typed[:MAX_CHARACTERS])


def _avatars(view: JoinView, metrics: Metrics) -> None:
    """A row of pictures; the one that is worn has a frame."""
    widgets.note("Your avatar", metrics)
    state, gap = view.state, metrics.px(GAP_PT)
    count = len(view.portraits)
    room = (imgui.get_content_region_avail().x - (count - 1) * gap) / count
    side = min(metrics.px(PORTRAIT_PT), room)
    worn = state.avatar or view.default_avatar
    shapes, palette, round_px = imgui.get_window_draw_list(), metrics.palette, metrics.px(8)
    for number, (name, texture) in enumerate(view.portraits.items()):
        if number:
            imgui.same_line(0, gap)
        if imgui.invisible_button(f"avatar {name}", (side, side)):
            state.avatar = "" if state.avatar == name else name
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        if texture is None:
            shapes.add_rect_filled(low, high, widgets.ink(palette.field), round_px)
        else:
            picture = imgui.ImTextureRef(texture)
            white = 0xFFFFFFFF
            shapes.add_image_rounded(picture, low, high, (0, 0), (1, 1), white, round_px)
        if imgui.is_item_hovered() or name == worn:
            colour = palette.accent if name == worn else palette.faint
            shapes.add_rect(low, high, widgets.ink(colour), round_px, metrics.px(2.5))
        widgets.hint(
            name.title() if state.avatar else f"{name.title()}: by default it goes by your name"
        )


def _spinner(metrics: Metrics, now: float) -> None:
    """An arc that turns."""
    side = imgui.get_frame_height()
    low = imgui.get_cursor_screen_pos()
    centre = (low.x + side / 2, low.y + side / 2)
    begin = 5.0 * now
    shapes = imgui.get_window_draw_list()
    shapes.path_arc_to(centre, 0.3 * side, begin, begin + 4.2)
    shapes.path_stroke(widgets.ink(metrics.palette.accent), metrics.px(3))
    imgui.dummy((side, side))
