"""The form that asks where to go and as whom, and what stands there while the way is made."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from imgui_bundle import imgui, imgui_ctx

from pica_client.ui.joining.form import MAX_CHARACTERS, SECRETS, SOURCES, Fields, JoinOrder
from pica_client.ui.joining.trouble import Trouble
from pica_client.ui.panels.control_bar import EDGE_PT
from pica_client.ui.panels.sound import MICROPHONE, microphone_picker, sound_part
from pica_client.ui.surface import icons, widgets
from pica_client.ui.surface.theme import BUTTON_PT, GAP_PT, PADDING_PT, SMALL_PT, Metrics
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

    fields: Fields
    trouble: Trouble | None = None
    portraits: Mapping[str, int | None] = field(default_factory=dict)
    """Pictures of the avatars to choose from by name, as numbers of textures; None while a picture
    is being drawn."""
    default_avatar: str = ""
    """The avatar that who chooses none gets, by name."""
    sound: SoundState | None = None
    """How sound stands; None: there is none."""


def join_panel(view: JoinView, metrics: Metrics) -> list[Fields | JoinOrder]:
    """Draw the form; gives what was typed and pressed."""
    columns, rows = metrics.size
    edge = metrics.px(EDGE_PT)
    width = min(metrics.px(WIDTH_PT), columns - 2 * edge)
    orders: list[Fields | JoinOrder] = []
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
        fields = _typed(view, metrics, orders)
        if fields != view.fields:
            orders.append(fields)
        imgui.end_child()
        wide = imgui.get_content_region_avail().x
        if widgets.action_button("Join", metrics, tone="accent", width_px=wide):
            orders.append(JoinOrder.JOIN)
    is_open = imgui.is_popup_open("", imgui.PopupFlags_.any_popup_id)
    enters = (imgui.Key.enter, imgui.Key.keypad_enter)
    is_entered = any(imgui.is_key_pressed(key, repeat=False) for key in enters)
    if is_entered and not is_open and JoinOrder.JOIN not in orders:
        orders.append(JoinOrder.JOIN)
    if imgui.is_key_pressed(imgui.Key.escape, repeat=False) and not is_open:
        orders.append(JoinOrder.LEAVE)
    return orders


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


def _typed(view: JoinView, metrics: Metrics, orders: list[Fields | JoinOrder]) -> Fields:
    """The fields as they stand after this frame."""
    fields = view.fields
    if imgui.is_window_appearing():
        empty = next((name for name in ("url", "room", "name") if not getattr(fields, name)), "")
        imgui.set_next_window_focus()
    else:
        empty = ""
    fields = _field(fields, "url", focus=empty == "url")
    half = (imgui.get_content_region_avail().x - metrics.px(GAP_PT)) / 2
    left, top = imgui.get_cursor_pos()
    with imgui_ctx.begin_group():
        fields = _field(fields, "room", width_px=half, focus=empty == "room")
    imgui.set_cursor_pos((left + half + metrics.px(GAP_PT), top))
    with imgui_ctx.begin_group():
        fields = _field(fields, "name", width_px=half, focus=empty == "name")
    if view.portraits:
        fields = _avatars(fields, view, metrics)
    widgets.note("Your face", metrics)
    fields = replace(fields, source=widgets.choice_of("##source", SOURCES, fields.source))
    if view.sound is not None:
        fields = _sound(fields, view.sound, metrics, orders)
    if imgui.tree_node_ex("More", FOLDED):
        for name in ("token", "secret_file", "ca_file", "avatar"):
            fields = _field(fields, name)
    return fields


def _sound(
    fields: Fields, state: SoundState, metrics: Metrics, orders: list[Fields | JoinOrder]
) -> Fields:
    """The microphone; and, once they are wanted, meters and loudspeaker to try."""
    widgets.note("Your microphone", metrics)
    voice, microphone = microphone_picker(fields.voice, fields.sound, state)
    sound = replace(fields.sound, microphone=microphone)
    if imgui.tree_node_ex("Try the sound", FOLDED):
        orders.append(JoinOrder.TRY_SOUND)
        has_microphone = voice == MICROPHONE
        sound, wants_test = sound_part(sound, state, metrics, has_microphone=has_microphone)
        if wants_test:
            orders.append(JoinOrder.TEST_SOUND)
    return replace(fields, voice=voice, sound=sound)


def _field(fields: Fields, name: str, *, width_px: float = -1.0, focus: bool = False) -> Fields:
    """A line of text with its label above it."""
    label, example = LABELS[name]
    with widgets.type_size(SMALL_PT):
        imgui.text_disabled(label)
    imgui.set_next_item_width(width_px)
    if focus:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.password if name in SECRETS else 0
    value = getattr(fields, name)
    with widgets.ringed():
        _, typed = imgui.input_text_with_hint(f"##{name}", example, value, flags)
    texts: dict[str, Any] = {name: typed[:MAX_CHARACTERS]}
    return replace(fields, **texts)


def _avatars(fields: Fields, view: JoinView, metrics: Metrics) -> Fields:
    """A row of pictures; the one that is worn has a frame."""
    widgets.note("Your avatar", metrics)
    gap = metrics.px(GAP_PT)
    count = len(view.portraits)
    room = (imgui.get_content_region_avail().x - (count - 1) * gap) / count
    side = min(metrics.px(PORTRAIT_PT), room)
    worn = fields.avatar or view.default_avatar
    for number, (name, texture) in enumerate(view.portraits.items()):
        if number:
            imgui.same_line(0, gap)
        if imgui.invisible_button(f"avatar {name}", (side, side)):
            fields = replace(fields, avatar="" if fields.avatar == name else name)
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        shapes, palette, round_px = imgui.get_window_draw_list(), metrics.palette, metrics.px(8)
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
            name.title() if fields.avatar else f"{name.title()}: by default it goes by your name"
        )
    return fields


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
