"""People of the face model's coarse mesh, and captures of them that are rendered in seconds."""

from pathlib import Path
from typing import Any

from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.subject import PersonSubject, make_head
from pica_core.capture.rig.head import RigHead
from pica_core.capture.stage.synth import Progress, RenderOptions, render_subject

PERSON = draw_person(7, hair="short", beard="none", clothes="tee")
"""Whose capture it is."""
NAME = f"{PERSON.sex}, {PERSON.age}"
"""What captures call this person."""
TINY = RenderOptions(
    frames=5, cameras=2, size="64x64", texture_size=64, seed=5, tracked_vertices=900
)
"""A capture that is rendered in a second."""


def small_head() -> RigHead:
    """The head; made once a process."""
    return make_head(PERSON, coarse=True)[0]


def small_subject(*, bake_size: int = 256) -> PersonSubject:
    """The person on the stage, without shadows that take seconds to measure."""
    return PersonSubject(PERSON, bake_size=bake_size, self_shadow=False, coarse=True)


def render_capture(
    options: RenderOptions, out: Path, progress: Progress = lambda done, total: None
) -> dict[str, Any]:
    """Render the person; arguments, result and errors as `render_subject`."""
    return render_subject(small_subject, options, out, progress)
