"""One's own face in the corner, mirrored, and beside it what the tracker sees."""

from imgui_bundle import imgui

from pica_client.publish.face_desk import Seen
from pica_client.ui.actions import Request
from pica_client.ui.call_view import CallView
from pica_client.ui.own_face import ASPECT
from pica_client.ui.panels.control_bar import EDGE_PT
from pica_client.ui.state import ViewState
from pica_client.ui.surface.fonts import TEXT_PT
from pica_client.ui.surface.theme import SMALL_PT, Metrics
from pica_client.ui.surface.widgets import FIXED, Place, ink, text_size, type_size

HEIGHT_PT, SMALL_HEIGHT_PT = 104.0, 64.0
"""The smaller one beside a panel while somebody is pinned: their shoulder is there then."""
BARS_PT, BAR_PT = 132.0, 44.0
"""Width of what a tracker says, and of a bar in it."""
PICTURE_ONLY = imgui.WindowFlags_.no_inputs | imgui.WindowFlags_.no_background
WHITE = 0xFFFFFFFF


def self_view_px(metrics: Metrics) -> int:
    """How high the picture of one's own face is; 0 where there is no room for it."""
    return 0 if metrics.is_compact else round(metrics.px(HEIGHT_PT))


def self_view(state: ViewState, call: CallView, metrics: Metrics) -> list[Request]:
    """The pictures, at the lower left above the sign of one's own state; seen as in a mirror."""
    own, px = call.own, metrics.px
    height, edge, gap = self_view_px(metrics), px(EDGE_PT), px(8)
    if not height or (own.texture is None and own.seen is None):
        return []
    is_small = state.side != "none" and state.pinned is not None
    height = round(px(SMALL_HEIGHT_PT)) if is_small else height
    width = round(ASPECT * height)
    camera_px = 0
    if own.seen is not None and own.seen.picture is not None:
        rows, columns = own.seen.picture.shape[:2]
        camera_px = round(columns / rows * height) + gap
    bars = own.seen if not (camera_px or is_small) else None
    bars_px = px(BARS_PT) + gap if bars is not None else 0
    bottom = metrics.size[1] - edge - gap - text_size("Ag", TEXT_PT)[1] - px(12)
    low, high = (edge, bottom - height), (edge + width, bottom)
    imgui.set_next_window_pos(low)
    imgui.set_next_window_size((width + camera_px + bars_px, height))
    imgui.begin("own face", None, FIXED | PICTURE_ONLY)
    shapes, palette = imgui.get_window_draw_list(), metrics.palette
    if own.texture is not None:
        texture = imgui.ImTextureRef(own.texture)
        # Rows of a GL texture go up; columns go the other way, as in a mirror.
        shapes.add_image_rounded(texture, low, high, (1, 1), (0, 0), WHITE, px(8))
    shapes.add_rect(low, high, ink(palette.line), px(8), thickness=px(2))
    if state.own_face in ("muted", "frozen"):
        text = "off" if state.own_face == "muted" else "frozen"
        with type_size(SMALL_PT):
            size = imgui.calc_text_size(text)
            at = ((low[0] + high[0] - size.x) / 2, low[1] + (height - size.y) / 2)
            shapes.add_rect_filled(low, high, ink(palette.plate), px(8))
            shapes.add_text(at, ink(palette.ink), text)
    left = high[0] + gap
    if own.camera is not None:
        right = left + camera_px - gap
        texture = imgui.ImTextureRef(own.camera)
        corners = ((left, low[1]), (right, bottom))
        shapes.add_image_rounded(texture, *corners, (0, 0), (1, 1), WHITE, px(8))
    elif bars is not None:
        _bars(bars, (left, low[1]), (px(BARS_PT), height), metrics)
    imgui.end()
    return []


def _bars(seen: Seen, low: Place, size: Place, metrics: Metrics) -> None:
    """Some values of the tracker; without a face it says so."""
    shapes, palette, px = imgui.get_window_draw_list(), metrics.palette, metrics.px
    high = (low[0] + size[0], low[1] + size[1])
    shapes.add_rect_filled(low, high, ink(palette.plate), px(8))
    line = (size[1] - px(8)) / max(len(seen.bars), 1)
    with type_size(SMALL_PT):
        if not seen.has_face:
            text = imgui.calc_text_size("no face")
            at = ((low[0] + high[0] - text.x) / 2, (low[1] + high[1] - text.y) / 2)
            shapes.add_text(at, ink(palette.warning), "no face")
            return
        for number, (name, value) in enumerate(seen.bars):
            top = low[1] + px(4) + number * line
            shapes.add_text((low[0] + px(8), top), ink(palette.faint), name)
            begin = high[0] - px(8 + BAR_PT)
            middle, thick = top + line / 2, px(3)
            for share, colour in ((1.0, palette.field), (min(max(value, 0.0), 1.0), palette.good)):
                end = begin + share * px(BAR_PT)
                shapes.add_rect_filled((begin, middle - thick), (end, middle + thick), ink(colour))
