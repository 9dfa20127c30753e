"""What can stand on the stage: anything that takes 52 values, has a mesh and can be drawn."""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy.typing as npt

from pica_core.camera import Camera
from pica_core.capture.dataset.files import Topology
from pica_core.capture.stage.gpu import MeshRenderer, View
from pica_core.types import BoolArray, ByteArray, FloatArray


class Subject(ABC):
    """A head on the stage; one thread owns it. Its GL context is made with the first pose.

    Attributes:
        topology: The mesh that `pose` moves. A tracker cannot follow the regions that are named
            ``mouth_interior``; `render_subject` leaves them out of the tracked mesh.
    """

    name: str
    topology: Topology

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """What `capture.json` says of the subject, at least ``source``, ``licence`` and ``mask``;
        JSON values."""

    @abstractmethod
    def _make_renderer(self) -> MeshRenderer:
        """Open a context and put the subject into it."""

    @cached_property
    def _renderer(self) -> MeshRenderer:
        return self._make_renderer()

    def pose(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose for the draws that follow; returns vertices, head frame, metres ``[V, 3]``."""
        return self._renderer.pose(arkit)

    def draw(self, camera: Camera) -> View:
        """What a camera in head axes sees of the pose."""
        return self._renderer.draw(camera)

    def unwrap(self, images: list[tuple[Camera, View]], size: int) -> tuple[ByteArray, BoolArray]:
        """Average texture of the pose and where it is known, as `MeshRenderer.unwrap`."""
        return self._renderer.unwrap(images, size)

    def release(self) -> None:
        """Give back what drawing needed."""
        if "_renderer" in self.__dict__:
            self._renderer.release()
            del self._renderer
