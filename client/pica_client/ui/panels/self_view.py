"""One's own face in the corner, mirrored."""

from imgui_bundle import imgui

from pica_client.ui.call_view import CallView
from pica_client.ui.controls import UserOrder
from pica_client.ui.panels.control_bar import EDGE_PT
from pica_client.ui.self_view import ASPECT
from pica_client.ui.surface.fonts import TEXT_PT
from pica_client.ui.surface.theme import SMALL_PT, Metrics
from pica_client.ui.surface.widgets import FIXED, ink, text_size, type_size

HEIGHT_PT = 104.0
PICTURE_ONLY = imgui.WindowFlags_.no_inputs | imgui.WindowFlags_.no_background


def self_view_px(metrics: Metrics) -> int:
    """How high the picture of one's own face is; 0 where there is no room for it."""
    return 0 if metrics.is_compact else round(metrics.px(HEIGHT_PT))


def self_view(view: CallView, metrics: Metrics) -> list[UserOrder]:
    """The picture, at the lower left above the sign of one's own state; seen as in a mirror."""
    if view.self_texture is None:
        return []
    height = self_view_px(metrics)
    width, edge, gap = round(ASPECT * height), metrics.px(EDGE_PT), metrics.px(8)
    bottom = metrics.size[1] - edge - gap - text_size("Ag", TEXT_PT)[1] - metrics.px(12)
    low, high = (edge, bottom - height), (edge + width, bottom)
    imgui.set_next_window_pos(low)
    imgui.set_next_window_size((width, height))
    imgui.begin("own face", None, FIXED | PICTURE_ONLY)
    shapes, palette = imgui.get_window_draw_list(), metrics.palette
    texture = imgui.ImTextureRef(view.self_texture)
    white = ink((1, 1, 1, 1))
    # Rows of a GL texture go up; columns go the other way, as in a mirror.
    shapes.add_image_rounded(texture, low, high, (1, 1), (0, 0), white, metrics.px(8))
    shapes.add_rect(low, high, ink(palette.line), metrics.px(8), thickness=metrics.px(2))
    if view.state.own_face in ("muted", "frozen"):
        text = "off" if view.state.own_face == "muted" else "frozen"
        with type_size(SMALL_PT):
            size = imgui.calc_text_size(text)
            at = ((low[0] + high[0] - size.x) / 2, low[1] + (height - size.y) / 2)
            shapes.add_rect_filled(low, high, ink(palette.plate), metrics.px(8))
            shapes.add_text(at, ink(palette.ink), text)
    imgui.end()
    return []
