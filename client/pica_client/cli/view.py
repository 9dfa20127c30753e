"""`pica view`: everybody in a room, in a window or a recording."""

from contextlib import closing
from typing import Any

from pica_client.errors import OptionError
from pica_client.system import has_display, say
from pica_client.ui.options import ViewOptions


def view(options: ViewOptions) -> dict[str, Any]:
    """Show everybody in a room, in a window or in a recording.

    With --headless there is no window. Comes back by itself when the relay goes away and returns.
    """
    if options.record is not None and options.record.is_file():
        raise OptionError(f"{options.record}: is there already; move it away or name another file")
    # Only here: help and completion do without the decoders and the window.
    from pica_client.avatars.library import AvatarLibrary
    from pica_client.ui.session import first_state, view_calls
    from pica_client.ui.state import PreferencesFile

    asks = not options.headless and bool(options.link or not options.join.url) and has_display()
    kept = PreferencesFile() if asks else None
    state = first_state(options, kept)
    with closing(AvatarLibrary()) as library:
        for name in (options.avatar or "").split(","):
            if name:
                library.load(library.find(name))
        result = view_calls(options, state, library, kept)
    say(f"drew {result['frames_rendered']} images at {result['render_fps']} a second")
    return result
