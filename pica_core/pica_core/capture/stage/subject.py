"""What stands on the stage: a head that takes 52 values, has a mesh and can be drawn."""

from functools import cached_property
from typing import Any

import numpy.typing as npt

from pica_core.camera import Camera
from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.capture.dataset.multiface import describe_masks
from pica_core.capture.rig.drawn import DrawnRig
from pica_core.capture.rig.skin import Albedo, Growth
from pica_core.capture.stage.gpu import BAKE_SIZE, RigRenderer, View
from pica_core.types import BoolArray, ByteArray, FloatArray


class Subject:
    """A head on the stage; one thread owns it. Its GL context is made with the first pose.

    Args:
        about: What `capture.json` says of the head, at least ``source`` and ``licence``; JSON
            values.
        albedo, look, growth, bake_size: As for `RigRenderer`.
        self_shadow: False leaves out shadow of the face on itself, which takes seconds to measure.

    Attributes:
        topology: The mesh that `pose` moves. A tracker cannot follow the regions that are named
            ``mouth_interior``; `render_subject` leaves them out of the tracked mesh.
    """

    def __init__(
        self,
        head: DrawnRig,
        about: dict[str, Any],
        *,
        albedo: dict[int, Albedo] | None = None,
        look: dict[str, Any] | None = None,
        growth: Growth | None = None,
        bake_size: int = BAKE_SIZE,
        self_shadow: bool = True,
    ) -> None:
        self.head, self.name, self.topology = head, head.name, head.topology
        self._about = {"head": head.name, **about}
        self._about |= {"position_map_size": MAP_SIZE, "mask": describe_masks()}
        self._drawn = head, albedo or {}, look or {}, growth, bake_size, self_shadow

    def describe(self) -> dict[str, Any]:
        """What `capture.json` says of the subject; JSON values."""
        return self._about

    @cached_property
    def _renderer(self) -> RigRenderer:
        return RigRenderer(*self._drawn)

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose for the draws that follow; returns vertices, head frame, metres ``[V, 3]``."""
        return self._renderer.pose(arkit)

    def draw(self, camera: Camera) -> View:
        """What a camera in head axes sees of the pose."""
        return self._renderer.draw(camera)

    def unwrap(self, images: list[tuple[Camera, View]], size: int) -> tuple[ByteArray, BoolArray]:
        """Average texture of the pose and where it is known, as `RigRenderer.unwrap`."""
        return self._renderer.unwrap(images, size)

    def release(self) -> None:
        """Give back what drawing needed."""
        if "_renderer" in self.__dict__:
            self._renderer.release()
            del self._renderer
