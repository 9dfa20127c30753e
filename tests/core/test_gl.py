"""What the shared GL functions promise beyond drawing."""

import signal
from typing import Any

import pytest

from pica_core.gl import create_context, link_program

pytestmark = pytest.mark.render

VERTEX = "#version 330\nvoid main() { gl_Position = vec4(0); }"
FRAGMENT = "#version 330\nout vec4 colour;\nvoid main() { colour = vec4(1); }"


class InterruptedWhileLinking:
    """A context whose driver is interrupted by the user in the middle of its work."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.linked: Any = None

    def program(self, **shaders: str) -> Any:
        signal.raise_signal(signal.SIGINT)
        self.linked = self.context.program(**shaders)
        return self.linked


def test_an_interrupt_waits_until_a_program_is_linked() -> None:
    context = create_context()
    # A shell that starts a job in the background lets it ignore interrupts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        interrupted: Any = InterruptedWhileLinking(context)
        with pytest.raises(KeyboardInterrupt):
            link_program(interrupted, vertex=VERTEX, fragment=FRAGMENT)
        assert interrupted.linked is not None
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
        context.release()
