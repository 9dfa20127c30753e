"""What can stand on the stage: anything that takes 52 values, has a mesh and can be drawn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy.typing as npt

from pica_core.camera import Camera
from pica_core.capture.dataset.files import Topology
from pica_core.capture.procedural.coordinates import MATERIALS
from pica_core.capture.procedural.gpu import BAKE_SIZE, ProceduralRenderer, View
from pica_core.capture.procedural.heads import make_head
from pica_core.capture.procedural.layout import MAP_SIZE
from pica_core.types import BoolArray, ByteArray, FloatArray


class Subject(Protocol):
    """Somebody on the stage. One thread owns a subject.

    The regions of its topology that are named ``mouth_interior`` are what a tracker cannot follow;
    `render_subject` leaves them out of the tracked mesh.
    """

    @property
    def name(self) -> str:
        """What the subject is called, in files and messages."""
        ...

    @property
    def topology(self) -> Topology:
        """The mesh that `pose` moves."""
        ...

    def describe(self) -> dict[str, Any]:
        """What `capture.json` says of the subject, at least ``source``, ``licence`` and ``mask``;
        JSON values."""
        ...

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose for the draws that follow; returns vertices, head frame, metres ``[V, 3]``."""
        ...

    def draw(self, camera: Camera) -> View:
        """What a camera in head axes sees of the pose."""
        ...

    def unwrap(self, images: list[tuple[Camera, View]], size: int) -> tuple[ByteArray, BoolArray]:
        """Average texture of the pose and where it is known, as `ProceduralRenderer.unwrap`."""
        ...

    def release(self) -> None:
        """Give back what drawing needed; the subject is useless afterwards."""
        ...


class Renderer(Protocol):
    """Draws a subject, in a GL context of its own."""

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """As `Subject.pose`."""
        ...

    def draw(self, camera: Camera) -> View:
        """As `Subject.draw`."""
        ...

    def unwrap(self, images: list[tuple[Camera, View]], size: int) -> tuple[ByteArray, BoolArray]:
        """As `Subject.unwrap`."""
        ...

    def release(self) -> None:
        """Give the context back."""
        ...


class Drawn(ABC):
    """The half of a `Subject` that a renderer does, which is made with the first pose."""

    def __init__(self) -> None:
        self._renderer: Renderer | None = None

    @abstractmethod
    def _make_renderer(self) -> Renderer:
        """Open a context and put the subject into it."""

    def _stage(self) -> Renderer:
        if self._renderer is None:
            self._renderer = self._make_renderer()
        return self._renderer

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """See `Subject.pose`."""
        return self._stage().pose(arkit)

    def draw(self, camera: Camera) -> View:
        """See `Subject.draw`."""
        return self._stage().draw(camera)

    def unwrap(self, images: list[tuple[Camera, View]], size: int) -> tuple[ByteArray, BoolArray]:
        """See `Subject.unwrap`."""
        return self._stage().unwrap(images, size)

    def release(self) -> None:
        """See `Subject.release`."""
        if self._renderer is not None:
            self._renderer.release()
            self._renderer = None


class ProceduralSubject(Drawn):
    """A built-in head on the stage. Its GL context is made with the first pose.

    Args:
        head: Identity.
        bake_size: Side of the baked appearance, texels.
        self_shadow: False leaves out shadow of the face on itself.

    Raises:
        CaptureError: No such head.
    """

    def __init__(self, head: str, *, bake_size: int = BAKE_SIZE, self_shadow: bool = True) -> None:
        super().__init__()
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
            "mask": {"0": "background"} | {str(k + 1): name for k, name in enumerate(MATERIALS)},
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
