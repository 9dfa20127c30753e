"""The join form in a window: a loop around `join_form`."""

import time

from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.seats import ViewState, plan_camera, plan_seats
from pica_client.transport.config import LinkConfig
from pica_client.ui.controls import KeyPressed, MousePressed
from pica_client.ui.join_form import JoinForm
from pica_client.ui.window import Window
from pica_core.camera import Camera

PERIOD_S = 1 / 30
CARET_S = 0.5
"""The caret is shown, and then not, for so long."""


def ask_where(window: Window, form: JoinForm) -> LinkConfig | None:
    """Show the form until the user wants to join or to leave.

    Args:
        window: Stays open; its context is as it was.
        form: What is asked, and what stands in it already.

    Returns:
        Where to go; None to leave.

    Raises:
        ShaderError: The driver refuses our shaders.
    """
    renderer = Renderer(window.context, window.size_px, RenderOptions())
    begin_s = time.monotonic()
    while form.outcome == "asking":
        now = time.monotonic()
        renderer.resize(window.size_px)
        is_caret_shown = (now - begin_s) % (2 * CARET_S) < CARET_S
        item = form.item(renderer.size, is_caret_shown=is_caret_shown)
        renderer.draw([], empty_room(), [item])
        window.show(renderer)
        for event in window.poll():
            if isinstance(event, KeyPressed) and event.key == "V" and event.has_control:
                form.receive(event, clipboard=window.clipboard())
            elif isinstance(event, MousePressed):
                form.click(event, item)
            else:
                form.receive(event)
        time.sleep(max(PERIOD_S - (time.monotonic() - now), 0.0))
    del renderer
    window.context.gc()
    return form.link() if form.outcome == "join" else None


def empty_room() -> Camera:
    """A camera for a picture without people."""
    return plan_camera(plan_seats("line", 0, 1.0), ViewState(), 16, 16)
