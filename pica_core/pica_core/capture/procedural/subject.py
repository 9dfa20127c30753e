"""A built-in head on the stage."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pica_core.capture.procedural.heads import ProceduralHead, make_head
from pica_core.capture.stage.subject import BAKE_SIZE, Subject
from pica_core.capture.stage.synth import Progress, RenderOptions, render_subject
from pica_core.errors import CaptureError, check_ranges

ABOUT = {
    "source": "synthetic: a built-in head of PiCA Telepresence; an invented person",
    "licence": "Apache-2.0",
}


class ProceduralSubject(Subject):
    """A built-in head on the stage, by its name if it is not made yet.

    Raises:
        CaptureError: No such head.
    """

    def __init__(
        self, head: str | ProceduralHead, *, bake_size: int = BAKE_SIZE, self_shadow: bool = True
    ) -> None:
        head = make_head(head) if isinstance(head, str) else head
        super().__init__(
            head, ABOUT, look=head.paint, growth=head.growth, bake_size=bake_size,
            self_shadow=self_shadow,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class StageOptions(RenderOptions):
    """Which built-in head to render, and how."""

    head: str = "S1"
    """Identity, such as S1."""
    bake_size: int = BAKE_SIZE
    """Side of the baked appearance, texels."""
    self_shadow: bool = True
    """False leaves out shadow of the face on itself, which takes seconds to measure."""

    def __post_init__(self) -> None:
        RenderOptions.__post_init__(self)
        check_ranges(self, CaptureError, bake_size=(64, 8192))


def render_capture(
    options: StageOptions, out: Path, progress: Progress = lambda done, total: None
) -> dict[str, Any]:
    """Render a built-in head; arguments, result and errors as `render_subject`."""
    make = partial(
        ProceduralSubject,
        options.head,
        bake_size=options.bake_size,
        self_shadow=options.self_shadow,
    )
    return render_subject(make, options, out, progress)
