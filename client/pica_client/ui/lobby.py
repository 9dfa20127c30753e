"""Before the call: the form that asks where to go and under which identity, and the card that is
shown while the user waits for the room.

Why joining failed is said in a person's words with what helps; the raw error stands below.
"""

import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import moderngl
import numpy as np
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui, imgui_ctx, imspinner
from PIL import Image as PillowImage

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import avatar_by_name
from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import STILL
from pica_client.system import Closing
from pica_client.transport.connect import LinkConfig
from pica_client.ui import widgets
from pica_client.ui.side import SOURCES, microphone_picker
from pica_client.ui.state import ViewState
from pica_client.ui.widgets import (
    BUTTON_PT,
    CARD,
    EDGE_PT,
    GAP_PT,
    PADDING_PT,
    SMALL_PT,
    TONES,
    px,
    screen,
)
from pica_client.ui.window import Window
from pica_client.voice.opus import available
from pica_client.voice.sound.process import SoundProcess
from pica_client.voice.sound.settings import SoundState
from pica_core.avatar.file import shipped_portraits
from pica_protocol.errors import CloseCode
from pica_protocol.invite import is_link, parse_link

PERIOD_S = 1 / 30
MAX_CHARACTERS = 2048
"""Characters that a field takes; a token may be that long."""
WIDTH_PT = 420.0
PORTRAIT_PT = 68.0
CANCEL_PT = 240.0
LABELS = {
    "url": ("Relay, or an invite link", "wss://relay.example"),
    "room": ("Room", "lobby"),
    "name": ("Your name", ""),
    "token": ("Token", "only if the relay wants one"),
    "secret_file": ("Room secret file", "for rooms that are encrypted end to end"),
    "avatar": ("Avatar file", "instead of one of the pictures"),
}
"""What stands above a field and, as an example, in it; the token is shown as stars."""
OWN = (
    "From about twelve photos of you in a folder, a film (--video) or a scan (--scan), on this "
    "computer, in about 15 minutes and 3 GB of memory, without a GPU. Once before it: "
    "pica webcam setup. Its last line names the avatar file, which goes under More."
)
"""What an avatar of the user's own needs, above the command that makes it."""
REFUSALS: dict[int, str] = {
    CloseCode.WRONG_VERSION: "The relay runs another version of PiCA. Update PiCA on this "
    "computer, or ask the relay's operator to update it.",
    CloseCode.ROOM_FULL: "The room is full. Wait until a participant leaves, or use another room.",
    CloseCode.RELAY_FULL: "The relay is full. Try again in a few minutes.",
    CloseCode.BUSY: "The relay is busy. Try again in a moment.",
    CloseCode.TOO_MANY: "Too many people from your network are on this relay. Close other PiCA "
    "windows, or ask the relay's operator for a higher limit.",
    CloseCode.UNAUTHORIZED: "You need a valid token for this room. Ask your host for a fresh "
    "invite link. Tokens expire, and hold for one room only.",
    CloseCode.FORBIDDEN: "Your token does not allow this. Choose to watch only or to wear another "
    "avatar, or ask your host for another invite link.",
    CloseCode.REPLACED: "You joined this room from somewhere else. Leave there first, or ask for "
    "an invite link of your own: each person needs one.",
    CloseCode.REMOVED: "You were removed from the room. Ask the host whether you may return.",
    CloseCode.TOO_FAST: "The relay has stopped you for sending too much. Try again later.",
}
"""What close codes mean, and what helps."""
NO_RELAY = (
    "No PiCA relay answers at this address. Check the address for typing errors and that you are "
    "online, or ask your host for an invite link."
)
FOLDED = imgui.TreeNodeFlags_.no_tree_push_on_open | imgui.TreeNodeFlags_.span_avail_width


@dataclass(kw_only=True, slots=True)
class JoinForm:
    """What is typed into a `ViewState`, and what is wrong with it."""

    state: ViewState
    """What stands in the fields."""
    link_of: Callable[[ViewState], LinkConfig]
    """Gives the connection that the state asks for."""
    portraits: Mapping[str, int] = field(default_factory=dict)
    """Pictures of the avatars to choose from, by name, as numbers of the surface."""
    names: Sequence[str] = ()
    """Avatars of which one is worn when none is chosen."""
    sound: SoundState | None = None
    """How sound stands; None: there is none."""
    trouble: tuple[str, str] | None = None
    """What is wrong, for people, and the raw error; None when nothing is known to be."""
    outcome: Literal["asking", "join", "leave"] = "asking"

    def typed(self) -> None:
        """A field has changed: an invite link in the first one fills in the others."""
        self.trouble = None
        if is_link(self.state.url):
            try:
                follow_invite(self.state, self.state.url)
            except ValueError as error:
                self.trouble = f"{error}.", ""

    def join(self) -> None:
        """Join, if the fields can be right."""
        try:
            self.link_of(self.state)
        except OptionError as error:
            self.refuse(error)
        else:
            self.trouble, self.outcome = None, "join"

    def refuse(self, error: Exception) -> None:
        """Ask again, saying why."""
        self.outcome = "asking"
        match error:
            case RelayRefusedError(code=int(code)) if code in REFUSALS:
                self.trouble = REFUSALS[code], str(error)
            case RelayUnreachableError() | RelayRefusedError(code=None):
                self.trouble = NO_RELAY, str(error)
            case _:
                self.trouble = str(error), ""


def follow_invite(state: ViewState, link: str) -> None:
    """Take relay, room and token from an invite link.

    Raises:
        ValueError: It is no good link.
    """
    invite = parse_link(link)
    state.url, state.room, state.token = invite.url, invite.room, invite.token


class Lobby(Closing):
    """A window with an empty room, and panels over it.

    Args:
        size: Columns and rows to open with, in the screen's units.
        sound: Has the microphones to choose from.

    Attributes:
        window: Stays open until the lobby is closed.

    Raises:
        GraphicsError: There is no display, or no context on it.
        ShaderError: The driver refuses our shaders.
    """

    def __init__(self, size: tuple[int, int], library: AvatarLibrary, sound: SoundProcess) -> None:
        self.window = window = Window(size)
        self._library, self._sound = library, sound
        self._wants_close = False
        self._renderer = Renderer(window.context, window.size_px, RenderOptions())

    def close(self) -> None:
        """Close the window."""
        self.window.close()

    def ask(self, form: JoinForm) -> bool:
        """Show the form until the user wants to join, True, or to leave."""
        form.outcome, form.names = "asking", self._library.names
        portraits = {}
        for name, file in shipped_portraits().items():
            if name in form.names:
                with PillowImage.open(file) as image:
                    picture = np.asarray(image.convert("RGB"))
                portraits[name] = self.window.surface.show(f"avatar {name}", picture)
        form.portraits = portraits
        while form.outcome == "asking" and not self._wants_close:
            form.sound = None if available() else self._sound.state
            self._frame(lambda: join_panel(form))
        if self._wants_close:
            form.outcome = "leave"
        return form.outcome != "leave"

    def wait(self, is_connected: Callable[[], bool]) -> bool:
        """Say that the call is being connected until it is, True, or the user does not want to wait
        any longer."""
        while not is_connected():
            if self._frame(connecting_panel) or self._wants_close:
                return False
        return True

    def _frame(self, show: Callable[[], Any]) -> Any:
        """Draw a frame of a panel over the empty room; return what the panel does."""
        now, window = time.monotonic(), self.window
        self._wants_close |= not window.poll()
        self._renderer.resize(window.size_px)
        window.begin(now)
        found = show()
        window.surface.end()
        self._renderer.draw([], STILL)
        window.show(self._show)
        time.sleep(max(PERIOD_S - (time.monotonic() - now), 0.0))
        return found

    def _show(self, screen: moderngl.Framebuffer) -> None:
        self._renderer.present(screen)
        self.window.surface.paint(screen)


def join_panel(form: JoinForm) -> None:
    """Draw the form, and tell it what was typed and pressed."""
    columns, rows = screen()
    edge = px(EDGE_PT)
    width = min(px(WIDTH_PT), columns - 2 * edge)
    imgui.set_next_window_size_constraints((width, 0), (width, rows - 2 * edge))
    flags = widgets.FIXED & ~imgui.WindowFlags_.no_nav
    with widgets.card("join", (columns / 2, rows / 2), pivot=(0.5, 0.5), flags=flags):
        widgets.title("Join a call")
        # What does not fit is scrolled to; the button stays in sight.
        room = rows - 2 * edge - 2 * px(PADDING_PT + GAP_PT + BUTTON_PT)
        imgui.set_next_window_size_constraints((0, 0), (columns, max(room, px(60))))
        padded = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
        # Room for the ring around the field in use.
        imgui.push_style_var(imgui.StyleVar_.window_padding, (px(3), px(3)))
        imgui.begin_child("fields", (0, 0), padded)
        imgui.pop_style_var()
        if form.trouble is not None:
            _trouble(*form.trouble)
        before = replace(form.state)
        _fields(form)
        if form.state != before:
            form.typed()
        imgui.end_child()
        wide = imgui.get_content_region_avail().x
        if widgets.action_button("Join", tone="accent", width=wide):
            form.join()
    if not imgui.is_popup_open("", imgui.PopupFlags_.any_popup_id):
        enters = (imgui.Key.enter, imgui.Key.keypad_enter)
        if any(imgui.is_key_pressed(key, repeat=False) for key in enters):
            form.join()
        if imgui.is_key_pressed(imgui.Key.escape, repeat=False):
            form.outcome = "leave"


def connecting_panel() -> bool:
    """Say that the call is being connected; return True once the user does not want to wait."""
    columns, rows = screen()
    with widgets.card("connecting", (columns / 2, rows / 2), pivot=(0.5, 0.5)):
        accent = imgui.ImColor(*TONES["accent"])
        clear = imgui.ImColor(0.0, 0.0, 0.0, 0.0)
        imspinner.spinner_ang("spinner", px(9), px(3), accent, clear, speed=5.0, angle=4.2)
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text_unformatted("Connecting …")
        is_cancelled = widgets.action_button("Cancel", width=px(CANCEL_PT))
    return is_cancelled or imgui.is_key_pressed(imgui.Key.escape, repeat=False)


def _trouble(text: str, details: str) -> None:
    """What went wrong and what helps, and the raw error below it."""
    imgui.push_style_color(imgui.Col_.child_bg, (*TONES["alert"][:3], 0.14))
    imgui.push_style_var(imgui.StyleVar_.window_padding, (px(12), px(10)))
    flags = imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.auto_resize_y
    imgui.begin_child("trouble", (0, 0), flags)
    imgui.text_wrapped(f"{icons.ICON_FA_TRIANGLE_EXCLAMATION}  {text}")
    if details:
        widgets.note(details)
    imgui.end_child()
    imgui.pop_style_var()
    imgui.pop_style_color()


def _fields(form: JoinForm) -> None:
    """All fields, which write what is typed into the state."""
    state = form.state
    empty = ""
    if imgui.is_window_appearing():
        empty = next((name for name in ("url", "room", "name") if not getattr(state, name)), "")
        imgui.set_next_window_focus()
    _field(state, "url", focus=empty == "url")
    half = (imgui.get_content_region_avail().x - px(GAP_PT)) / 2
    left, top = imgui.get_cursor_pos()
    with imgui_ctx.begin_group():
        _field(state, "room", width=half, focus=empty == "room")
    imgui.set_cursor_pos((left + half + px(GAP_PT), top))
    with imgui_ctx.begin_group():
        _field(state, "name", width=half, focus=empty == "name")
    if form.portraits:
        _avatars(form)
    if imgui.tree_node_ex("Make my own", FOLDED):
        widgets.note(OWN)
        imgui.set_next_item_width(-1.0)
        imgui.input_text("##own", own_command(state.name), imgui.InputTextFlags_.read_only)
    widgets.note("Your face")
    state.source = widgets.choice_of("##source", SOURCES, state.source)
    if form.sound is not None:
        widgets.note("Your microphone")
        microphone_picker(state, form.sound, may_be_off=True)
    if imgui.tree_node_ex("More", FOLDED):
        for name in ("token", "secret_file", "avatar"):
            _field(state, name)


def own_command(name: str) -> str:
    """The command that makes an avatar of a person of this name."""
    return f"pica avatar make --photos FOLDER --name {shlex.quote(name or 'Me')}"


def _field(state: ViewState, name: str, *, width: float = -1.0, focus: bool = False) -> None:
    """A line of text with its label above it."""
    label, example = LABELS[name]
    with widgets.type_size(SMALL_PT):
        imgui.text_disabled(label)
    imgui.set_next_item_width(width)
    if focus:
        imgui.set_keyboard_focus_here()
    flags = imgui.InputTextFlags_.password if name == "token" else 0
    _, typed = imgui.input_text_with_hint(f"##{name}", example, getattr(state, name), flags)
    setattr(state, name, typed[:MAX_CHARACTERS])


def _avatars(form: JoinForm) -> None:
    """A row of pictures; the one that is worn has a frame."""
    state = form.state
    widgets.note("Your avatar")
    gap, edge, count = px(4), px(2.5), len(form.portraits)
    room = (imgui.get_content_region_avail().x - (count - 1) * gap) / count
    side = min(px(PORTRAIT_PT), room) - 2 * edge
    worn = state.avatar or avatar_by_name(state.name, form.names)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (edge, edge))
    imgui.push_style_var(imgui.StyleVar_.image_rounding, px(6))
    for number, (name, texture) in enumerate(form.portraits.items()):
        if number:
            imgui.same_line(0, gap)
        frame = TONES["accent"] if name == worn else CARD
        imgui.push_style_color(imgui.Col_.button, frame)
        picture = imgui.ImTextureRef(texture)
        if imgui.image_button(f"avatar {name}", picture, (side, side)):
            state.avatar = "" if state.avatar == name else name
        imgui.pop_style_color()
        by_default = "" if state.avatar else ": by default it goes by your name"
        widgets.hint(f"{name.title()}{by_default}")
    imgui.pop_style_var(2)
