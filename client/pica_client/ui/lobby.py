"""Before the call: the form in a window, and what stands there while one waits for the room."""

import time
from collections.abc import Callable
from typing import Any

import moderngl
import numpy as np
from PIL import Image as PillowImage

from pica_client.avatars.library import AvatarLibrary
from pica_client.avatars.upload import avatar_by_name
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.room import STILL
from pica_client.system import Closing
from pica_client.ui.join_form import JoinForm
from pica_client.ui.panels.join import JoinView, connecting_panel, join_panel
from pica_client.ui.panels.settings import MICROPHONE
from pica_client.ui.surface.style import Metrics
from pica_client.ui.window import Window
from pica_client.voice.sound.process import SoundProcess
from pica_core.avatar.shipped import shipped_portraits

PERIOD_S = 1 / 30


class Lobby(Closing):
    """An empty room in a window.

    Args:
        window: Stays open; its context is as it was afterwards.
        sound: To be tried; None: there is none.

    Raises:
        ShaderError: The driver refuses our shaders.
    """

    def __init__(
        self, window: Window, library: AvatarLibrary, sound: SoundProcess | None = None
    ) -> None:
        self._window = window
        self._sound, self._listens = sound, False
        self._library = library
        self._wants_close = False
        self._renderer = Renderer(window.context, window.size_px, RenderOptions())
        self._portraits: dict[str, int] = {}
        for name, file in shipped_portraits().items():
            with PillowImage.open(file) as image:
                picture = np.asarray(image.convert("RGB"))
            self._portraits[name] = window.surface.show(f"avatar {name}", picture)

    def close(self) -> None:
        """Give back what is on the GPU."""
        self._window.context.gc()

    def ask(self, form: JoinForm) -> bool:
        """Show the form until the user wants to join, True, or to leave."""
        while form.outcome == "asking":
            self._frame(lambda metrics: join_panel(form, self._view(form), metrics))
            if self._wants_close:
                form.outcome = "leave"
            if self._sound is not None:
                self._try_sound(self._sound, form)
        return form.outcome == "join"

    def _try_sound(self, sound: SoundProcess, form: JoinForm) -> None:
        """Let the microphone be heard by its owner alone, as long as the meters are shown."""
        sound.follow(form.state.sound)
        is_shown = form.shows_meters and form.outcome == "asking"
        listens = is_shown and form.state.voice == MICROPHONE
        if listens != self._listens:
            self._listens = listens
            sound.use_microphone(listens)
        if form.wants_test:
            sound.play_test()

    def wait(self, what: str, is_over: Callable[[], bool]) -> bool:
        """Say what is being waited for until it is over, True, or until the user does not want to
        wait any longer."""
        while not is_over():
            if not self.show_waiting(what):
                return False
        return True

    def show_waiting(self, what: str) -> bool:
        """Draw one frame that says what is being waited for; False once the user gives up."""
        is_cancelled = self._frame(lambda metrics: connecting_panel(what, metrics))
        return not (is_cancelled or self._wants_close)

    def _view(self, form: JoinForm) -> JoinView:
        names = self._library.names
        return JoinView(
            portraits={name: self._portraits[name] for name in names if name in self._portraits},
            sound=None if self._sound is None else self._sound.state,
            default_avatar=avatar_by_name(form.state.name, names) if names else "",
        )

    def _frame(self, show: Callable[[Metrics], Any]) -> Any:
        """Draw a frame of panels over the empty room; gives what they order."""
        now, window = time.monotonic(), self._window
        self._wants_close |= not window.poll()
        self._renderer.resize(window.size_px)
        window.begin(now)
        found = show(window.surface.metrics)
        window.surface.end()
        self._renderer.draw([], STILL)
        window.show(self._show)
        time.sleep(max(PERIOD_S - (time.monotonic() - now), 0.0))
        return found

    def _show(self, screen: moderngl.Framebuffer) -> None:
        self._renderer.present(screen)
        self._window.surface.paint(screen)
