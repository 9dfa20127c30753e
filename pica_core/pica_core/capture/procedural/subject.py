"""A built-in head on the stage: what a render asks of it, and what `capture.json` says of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pica_core.capture.dataset.files import MAP_SIZE, Topology
from pica_core.capture.dataset.multiface import describe_masks
from pica_core.capture.procedural.gpu import ProceduralRenderer
from pica_core.capture.procedural.heads import make_head
from pica_core.capture.stage.gpu import BAKE_SIZE
from pica_core.capture.stage.subject import Subject
from pica_core.capture.stage.synth import Progress, RenderOptions, check_range, render_subject


class ProceduralSubject(Subject):
    """A built-in head on the stage.

    Raises:
        CaptureError: No such head.
    """

    def __init__(self, head: str, *, bake_size: int = BAKE_SIZE, self_shadow: bool = True) -> None:
        self.head = make_head(head)
        self._bake_size, self._self_shadow = bake_size, self_shadow
        self.name = head
        self.topology = Topology(
            vertex_uv=self.head.vertex_uv, faces=self.head.faces, regions=self.head.regions
        )

    def describe(self) -> dict[str, Any]:
        """Source, licence, materials and charts."""
        return {
            "head": self.name,
            "source": "synthetic: a built-in head of PiCA Telepresence; an invented person",
            "licence": "Apache-2.0",
            "position_map_size": MAP_SIZE,
            "mask": describe_masks(),
            "charts": {
                name: {
                    "rows": [int(chart.rows[0]), int(chart.rows[-1])],
                    "columns": [int(chart.columns[0]), int(chart.columns[-1])],
                }
                for name, chart in self.head.charts.items()
            },
        }

    def _make_renderer(self) -> ProceduralRenderer:
        return ProceduralRenderer(self.head, bake_size=self._bake_size, occlusion=self._self_shadow)


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
        check_range(self, "bake_size", 64, 8192)


def render_capture(
    options: StageOptions, out: Path, progress: Progress = lambda done, total: None
) -> dict[str, Any]:
    """Render a built-in head; arguments, result and errors as `render_subject`."""

    def make() -> Subject:
        return ProceduralSubject(
            options.head, bake_size=options.bake_size, self_shadow=options.self_shadow
        )

    return render_subject(make, options, out, progress)
