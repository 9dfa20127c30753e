"""Whether a window is worth trying, without asking a window library."""

import os
import sys


def has_display() -> bool:
    """True off Linux; on Linux, whether the environment names a display server."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
