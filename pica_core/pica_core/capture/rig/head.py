"""A rig as a head of ours: one chart, 52 values in, a posed mesh out.

read -> names -> mesh (units, axes, parts) -> features -> chart -> pose
"""

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, EYE_PITCH_DOWN, EYE_PITCH_UP, EYE_YAW
from pica_core.capture.dataset.files import Topology
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.chart import PackedChart, mend_islands, pack
from pica_core.capture.rig.features import Features, Limits, find_features
from pica_core.capture.rig.guards import PoseGuard
from pica_core.capture.rig.mesh import RigMesh, build_mesh
from pica_core.capture.rig.names import NameMap, map_names
from pica_core.capture.rig.source import RigSource
from pica_core.capture.triangles import areas, vertex_normals, visibility
from pica_core.types import Array, Float64Array, FloatArray


def gaze(side: float, values: Array) -> tuple[Array, Array]:
    """Yaw and pitch of one eye at ARKit values ``[..., 52]``, radians ``[...]``; `side` is 1 for
    the left eye, -1 for the right."""
    name = "Left" if side > 0 else "Right"
    out, inwards, up, down = (
        values[..., ARKIT_INDEX[f"eyeLook{way}{name}"]] for way in ("Out", "In", "Up", "Down")
    )
    return side * EYE_YAW * (out - inwards), EYE_PITCH_UP * up - EYE_PITCH_DOWN * down


def turn(offsets: FloatArray, yaw: Array | float, pitch: Array | float) -> Array:
    """Offsets from an eyeball's centre, turned up by the pitch and then sideways. ``[..., 3]``."""
    sp, cp, sy, cy = np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
    x, y, z = offsets.T
    y, z = cp * y + sp * z, cp * z - sp * y
    return np.stack([cy * x + sy * z, y, cy * z - sy * x], -1)


SEEN_FULLY = 0.27
"""Visibility of skin that faces the dome (measured on one head)."""
SEEN_ENOUGH = 0.03
"""Visibility from which on a triangle counts as seen: teeth are seen rarely and matter."""
HIDDEN_SHARE = 0.40
"""Texels of a triangle that no camera sees, against one that is seen."""
SHARE_BY_COUNT = 0.75
"""Part of the texels that goes to triangles alike (geometry); the rest goes by area."""
IMPORTANCE = {"lids": 1.8, "lips": 1.8, "teeth": 1.4, "tongue": 1.2, "eyeballs": 1.3}
"""How many more texels the regions get that people look at; where several hold, the largest."""


def texel_need(mesh: RigMesh, features: Features, seen: Float64Array) -> Float64Array:
    """Share of the chart that each triangle should get, sum 1, given its visibility. ``[F]``."""
    area = areas(mesh.rest_m, mesh.faces)
    importance = np.ones(len(mesh.faces))
    for name, value in IMPORTANCE.items():
        here = features.regions[name][mesh.faces].any(1)
        importance[here] = np.maximum(importance[here], value)
    visible = np.clip(seen / SEEN_ENOUGH, 0.0, 1.0)
    by_count = (HIDDEN_SHARE + (1 - HIDDEN_SHARE) * visible) * importance
    by_area = area * (0.02 + np.clip(seen / SEEN_FULLY, 0.0, 1.0)) * importance
    share = SHARE_BY_COUNT * by_count / by_count.sum()
    return share + (1 - SHARE_BY_COUNT) * by_area / by_area.sum()


def _revealing_poses(mesh: RigMesh) -> list[Float64Array]:
    """Poses that show what there is: at rest, mouth open, teeth bared, eyes closed."""
    poses = [mesh.rest_m]
    for names in (("jawOpen",), ("mouthSmile", "mouthUpperUp", "mouthLowerDown"), ("eyeBlink",)):
        chosen = [k for name, k in ARKIT_INDEX.items() if name.startswith(names)]
        poses.append(mesh.rest_m + mesh.motion_m[chosen].sum(0))
    return poses


class RigHead:
    """A rig that can be posed.

    Attributes:
        chart: Its one chart; ``chart.source`` leads from split to welded vertices.
        mended: Triangles whose texture coordinates were made here.
    """

    def __init__(self, mesh: RigMesh, names: NameMap, name: str) -> None:
        self.name, self.mesh, self.names = name, mesh, names
        self.features = find_features(mesh)
        uv, uv_faces, self.mended = mend_islands(mesh.rest_m, mesh.faces, mesh.uv, mesh.uv_faces)
        seen = visibility(_revealing_poses(mesh), mesh.faces)
        need = texel_need(mesh, self.features, seen)
        skin = self.features.part == MATERIALS.index("skin")
        self.chart: PackedChart = pack(
            uv, uv_faces, mesh.faces, need, rest=mesh.rest_m, seen=skin & (seen > SEEN_ENOUGH)
        )
        source = self.chart.source
        regions = {key: mask[source] for key, mask in self.features.regions.items()}
        self.topology = Topology(
            vertex_uv=self.chart.vertex_uv, faces=self.chart.faces, regions=regions
        )
        one_of = np.zeros(len(mesh.rest_m), np.int32)
        one_of[source] = np.arange(len(source))
        self._welded, self._welded_faces = one_of[source], one_of[mesh.faces]
        self._rest = mesh.rest_m.astype(np.float32)
        moving = np.abs(mesh.motion_m).max((1, 2)) > 0
        self._shapes = np.flatnonzero(moving)
        self._motion = mesh.motion_m[self._shapes].reshape(len(self._shapes), -1)
        self._limits = Limits(mesh, self.features)
        self._guard = PoseGuard(mesh, self.features)
        self._turns = [
            (eye, self._rest[eye.vertices] - eye.centre_m.astype(np.float32))
            for eye in mesh.eyes
            if not eye.turned
        ]

    def vertices(self, arkit: npt.ArrayLike) -> FloatArray:
        """Split vertices at the 52 shapes ``[52]``, metres, head frame. float32 ``[V, 3]``.

        Raises:
            ShapeError: `arkit` does not have 52 values.
        """
        values = self._limits.apply(arkit)
        points: FloatArray = self._rest + (values[self._shapes] @ self._motion).reshape(-1, 3)
        for eye, offsets in self._turns:
            yaw, pitch = gaze(eye.side, values.astype(np.float64))
            points[eye.vertices] = turn(offsets, yaw, pitch) + eye.centre_m.astype(np.float32)
        self._guard.apply(points)
        return points[self.chart.source]

    def normals(self, vertices: FloatArray) -> FloatArray:
        """Unit vertex normals, area weighted, smooth across seams of the chart. ``[V, 3]``."""
        return vertex_normals(vertices, self._welded_faces)[self._welded].astype(np.float32)


def make_rig(source: RigSource, table: dict[str, str | None] | None = None) -> RigHead:
    """Make a head of a rig, with the user's table of names (`names.read_names`) if there is one."""
    moved = {name: np.any(delta != 0, axis=1) for name, delta in source.shapes.items()}
    names = map_names(list(source.shapes), table, moved)
    mesh = build_mesh(source, names)
    return RigHead(mesh, names, source.path.stem or source.path.name)
