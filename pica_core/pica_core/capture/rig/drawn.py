"""What is drawn: a rig with its one chart."""

from dataclasses import dataclass
from typing import Protocol

import numpy.typing as npt

from pica_core.capture.dataset.files import Topology
from pica_core.capture.rig.features import Features
from pica_core.capture.rig.mesh import RigMesh
from pica_core.capture.rig.names import NameMap
from pica_core.types import FloatArray, Int64Array, IntArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PackedChart:
    """A mesh with one chart.

    Attributes:
        vertex_uv: Texture coordinates in [0, 1], v downwards. float32 ``[V, 2]``.
        faces: Triangles of the split vertices. int32 ``[F, 3]``.
        face_source: The triangle of the mesh that each triangle is, or copies. int64 ``[F]``.
        source: The welded vertex of each split vertex. int64 ``[V]``.
    """

    vertex_uv: FloatArray
    faces: IntArray
    face_source: Int64Array
    source: Int64Array
    islands: int


class DrawnRig(Protocol):
    """A head that can be painted and posed.

    Attributes:
        names: Which shapes it has.
        features: Mouth, eyes and regions of the welded mesh.
        chart: What is drawn.
        topology: The same with its regions.
    """

    name: str
    names: NameMap
    features: Features
    chart: PackedChart
    topology: Topology

    @property
    def mesh(self) -> RigMesh:
        """The welded mesh at rest."""

    def vertices(self, arkit: npt.ArrayLike) -> FloatArray:
        """Vertices of a pose, head frame, metres. float32 ``[V, 3]``."""

    def normals(self, vertices: FloatArray) -> FloatArray:
        """Unit normals of posed vertices. float32 ``[V, 3]``."""
