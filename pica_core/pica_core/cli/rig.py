"""`pica capture rig`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from pica_core.capture.stage.rig import RigSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.cli.capture import RenderArguments, baked_side


@dataclass(frozen=True, kw_only=True, slots=True)
class RigOptions(RenderArguments):
    """Options of `pica capture rig`."""

    rig: Path
    """A .glb, .vrm or .gltf file with morph targets, or a folder of OBJ files of one topology."""
    map: Path | None = None
    """JSON file of source names to ARKit names (or null), which goes before the rules."""
    albedo: tuple[str, ...] = ()
    """Base colour images: FILE for the material with most triangles, or MATERIAL=FILE. What has no
    image is painted."""


def rig(options: RigOptions) -> dict[str, Any]:
    """Render a head of your own, one with blendshapes, into a capture directory."""
    stage = RenderOptions(**options.values())
    console = Console(stderr=True)
    about: dict[str, Any] = {}

    def make() -> RigSubject:
        subject = RigSubject(options.rig, options.map, options.albedo, bake_size=baked_side(stage))
        about.update(subject.describe()["rig"])
        _tell(console, about)
        return subject

    made = options.render(console, lambda show: render_subject(make, stage, options.out, show))
    return made | about


def _tell(console: Console, about: dict[str, Any]) -> None:
    """Say what was understood, for somebody who wonders why their head looks odd."""
    console.print(
        f"{len(about['mapped'])} shapes mapped, {len(about['missing'])} ARKit shapes missing, "
        f"{len(about['ignored'])} shapes ignored; unit {about['unit']}, axes {about['axes']}"
    )
    for name, text in (
        ("missing", "missing"),
        ("ignored", "ignored"),
        ("left_out_materials", "materials left out"),
        ("guessed", "assumed"),
    ):
        if about[name]:
            console.print(f"{text}: {', '.join(about[name])}", highlight=False)
