"""What stands on a surface, drawn into a framebuffer."""

import pytest
from imgui_bundle import imgui

from pica_client.ui.surface.painter import Painter
from pica_client.ui.surface.surface import Surface
from pica_core.gl import create_context

pytestmark = pytest.mark.render


def test_what_lies_outside_a_picture_of_one_pixel_is_no_error_of_gl() -> None:
    context = create_context()
    target = context.framebuffer([context.texture((1, 1), 4)])
    surface = Surface((1, 1))
    painter = Painter(context, surface)
    with surface.frame(0.0):
        shapes = imgui.get_background_draw_list()
        shapes.push_clip_rect((1, -23), (3, -9))
        shapes.add_rect_filled((0, -30), (5, 5), 0xFFFFFFFF)
        shapes.pop_clip_rect()
    painter.paint(target)
    assert context.error == "GL_NO_ERROR"
    surface.close()
    context.release()
