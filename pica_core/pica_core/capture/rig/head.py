"""A rig as a head of ours: one chart, 52 values in, a posed mesh out.

read -> names -> mesh (units, axes, parts) -> features -> chart -> pose

Guards keep a posed head whole where shapes that add up do not, since shapes move vertices along
straight lines, and flesh does not:

    lids    stay before the eyeballs that they slide over
    lips    stay before the teeth that they lie on
    skin    does not fold over onto itself

Each moves what is wrong in a pose, and nothing else. All take the rig's welded mesh at rest.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from pica_core.avatar.arkit import ARKIT_INDEX, EYE_PITCH_DOWN, EYE_PITCH_UP, EYE_YAW
from pica_core.capture.dataset.files import Topology
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.chart import PackedChart, mend_islands, pack
from pica_core.capture.rig.features import Features, Limits, find_features
from pica_core.capture.rig.mesh import RigMesh, build_mesh
from pica_core.capture.rig.names import NameMap, map_names
from pica_core.capture.rig.source import RigSource
from pica_core.capture.triangles import (
    areas,
    edges,
    face_neighbours,
    face_normals,
    mean_of_neighbours,
    vertex_normals,
    visibility,
)
from pica_core.errors import CaptureError
from pica_core.types import Array, BoolArray, Float64Array, FloatArray

GUARD_M, GUARD_SOFT_M, GUARD_HARD_M = 0.001, 0.0001, 1e-6
"""Distance that lids keep from an eyeball if they had it at rest; how softly at first, and again
after skin was smoothed, since each soft step goes a little too far."""
LID_SWEEP_M = 0.008
"""Skin farther from an eyeball than that is no lid."""
NEAR, STEPS, FORWARD = 0.14, np.radians(np.arange(0, 95, 5)), np.array([0.0, 0.0, 1.0])
"""Angles within which an eyeball's surface is taken as level, at which it is looked up, and where
eyes look at rest."""
CELL_M = 0.0005
"""Side of a cell of the picture in which teeth are looked up."""
LIP_ROOM_M, LIP_CLOSER_M = 0.00015, 0.0003
"""Distance that lips keep from teeth; those that lie nearer at rest may come so much closer."""
LIP_DEEPEST_M = 0.006
"""Skin so far behind the front of a tooth is not a lip that went through it."""
LIP_BLEND, LIP_RINGS = 0.85, 3
"""Share of a lip's step that each ring of neighbours takes along, and how many do."""
ROUNDS = 16
"""Times that folded skin is smoothed at most."""
WIDER_AFTER, ON_AFTER, WIDER_BY = 4, 10, 2
"""Skin that is still folded after so many rounds lies in a hollow, against skin that stays as it
is, or is pushed back by a lid. Then so many rings around it become smoother, too: first their steps
from rest, which keeps hollows, and after ten rounds their places."""
FOLDED, NEARLY = (-0.25, 0.2), (-0.1, 0.1)
"""Triangles are folded, or nearly, that face against their neighbours by this cosine and are as
large as that, mm²: where any is folded, all that nearly are become smoother."""
MOVES_M = 0.0005
"""Skin that no shape moves farther cannot fold."""


class EyeSurface:
    """How wide an eyeball is at an angle from where it looks: as its farthest vertex there.

    Args:
        offset: Its vertices from its centre, looking along +z, ``[n, 3]``.
    """

    def __init__(self, offset: Float64Array) -> None:
        self.lean, reach = _lean(offset, FORWARD)
        """Angle of each vertex from where the eye looks, radians, ``[n]``."""
        near = np.abs(self.lean - STEPS[:, None]) < NEAR
        has = near.any(axis=1)
        widest = np.where(near, reach, 0.0).max(axis=1)
        self._widest = np.interp(STEPS, STEPS[has], widest[has])

    def clearance(self, offset: Float64Array, forward: Float64Array = FORWARD) -> Float64Array:
        """How far points from its centre are before it, where it looks along `forward`; below 0
        they are in it. ``[n]``."""
        lean, far = _lean(offset, forward)
        return far - np.interp(lean, STEPS, self._widest)


def outwards(offset: Float64Array, by_m: Float64Array) -> Float64Array:
    """Steps of such lengths away from a centre, for points at these offsets. ``[n, 3]``."""
    return offset * (by_m / np.maximum(np.linalg.norm(offset, axis=1), 1e-9))[:, None]


def _lean(offset: Float64Array, forward: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Angle of each offset from a direction, radians, and its length. ``[n]`` each."""
    far = np.linalg.norm(offset, axis=1)
    along = np.matmul(offset, forward) / np.maximum(far * np.linalg.norm(forward), 1e-12)
    return np.arccos(np.clip(along, -1.0, 1.0)), far


class LidGuard:
    """Moves lids out of eyeballs.

    The line from an open lid to a closed one leads through the eyeball. What was before an eyeball
    at rest stays before it, as far as it was, or `GUARD_M`; the eyeball is as wide at an angle from
    where it looks as its farthest vertex there, so that a cornea lifts the lid that it is under.
    """

    def __init__(self, mesh: RigMesh) -> None:
        skin, rest = mesh.of_part("skin"), mesh.rest_m
        self._eyes = []
        for eye in mesh.eyes:
            ball, offset = eye.vertices, rest - eye.centre_m
            near = skin & (np.linalg.norm(offset, axis=1) < 1.9 * eye.radius_m) & (offset[:, 2] > 0)
            surface = EyeSurface(rest[ball] - eye.centre_m)
            clear = surface.clearance(offset)
            lid = np.flatnonzero(near & (clear > 0.0) & (clear < LID_SWEEP_M))
            room = np.minimum(clear[lid], GUARD_M)
            front = ball[surface.lean < 2 * NEAR]
            if len(front) and len(lid):
                from_middle = eye.centre_m - rest[ball].mean(0)
                self._eyes.append((lid, room, ball, front, from_middle, surface))

    def apply(self, points: npt.NDArray[np.floating[Any]], soft_m: float = GUARD_SOFT_M) -> None:
        """Move lids of posed vertices ``[V, 3]``, metres, in place."""
        for lid, room, ball, front, from_middle, surface in self._eyes:
            centre = points[ball].mean(0) + from_middle
            offset = points[lid] - centre
            lack = room - surface.clearance(offset, points[front].mean(0) - centre)
            points[lid] += outwards(offset, soft_m * np.logaddexp(0.0, lack / soft_m))


class LipGuard:
    """Moves lips, vertices and sides of triangles, before the teeth that they lay on at rest, and
    skin around them along.
    """

    def __init__(self, mesh: RigMesh, features: Features) -> None:
        part = features.part
        self._teeth = mesh.faces[part == MATERIALS.index("teeth")]
        self._lips = np.zeros((0, 2), np.int64)
        mouth, rest = features.mouth, mesh.rest_m
        if mouth is None or not len(self._teeth):
            return
        skin_faces = mesh.faces[part == MATERIALS.index("skin")]
        middle = np.array([mouth.centre_x, float(np.mean(mouth.y))])
        box = np.abs(rest[:, :2] - middle) < [mouth.half_m + 0.016, 0.03]
        near = box.all(1) & (rest[:, 2] > float(mouth.z.min()) - 0.03)
        lips = np.intersect1d(np.flatnonzero(near), skin_faces)
        lips = lips[rest[lips, 2] > self._front(rest, rest[lips])]
        sides = np.sort(edges(skin_faces[np.isin(skin_faces, lips).all(1)]), axis=1)
        lips = np.unique(np.concatenate([np.stack([lips, lips], 1), sides]), axis=0)
        middle_m = rest[lips].mean(1)
        clear = middle_m[:, 2] - self._front(rest, middle_m)
        self._lips = lips[clear > 0]
        self._room = np.minimum(clear[clear > 0] - LIP_CLOSER_M, LIP_ROOM_M)
        self._around = mean_of_neighbours(skin_faces, len(rest))

    def _front(self, points: npt.NDArray[np.floating[Any]], at: Float64Array) -> Float64Array:
        """Depth of the foremost tooth at each place in a front view; -1 where there is none."""
        corners = points[self._teeth].astype(np.float64)
        edges = 0.5 * (corners + np.roll(corners, 1, axis=1))
        places = np.concatenate([corners.reshape(-1, 3), edges.reshape(-1, 3), corners.mean(1)])
        origin = places[:, :2].min(0) - 2 * CELL_M
        cells = ((places[:, :2] - origin) / CELL_M).astype(np.int64)
        size = cells.max(0) + 3
        grid = np.full(size, -1.0)
        np.maximum.at(grid, (cells[:, 0], cells[:, 1]), places[:, 2])
        wide = np.pad(grid, 1, constant_values=-1.0)
        for i, j in np.ndindex(3, 3):  # samples of a face leave cells between them empty
            np.maximum(grid, wide[i : i + size[0], j : j + size[1]], out=grid)
        cell = np.floor((at[:, :2] - origin) / CELL_M).astype(np.int64)
        inside = ((cell >= 0) & (cell < size)).all(1)
        front = np.full(len(at), -1.0)
        front[inside] = grid[cell[inside, 0], cell[inside, 1]]
        return front

    def apply(self, points: npt.NDArray[np.floating[Any]]) -> None:
        """Move lips of posed vertices ``[V, 3]``, metres, in place."""
        if not len(self._lips):
            return
        lips = points[self._lips].mean(1, dtype=np.float64)
        lack = self._front(points, lips) + self._room - lips[:, 2]
        lack[(lack < 0) | (lack > LIP_DEEPEST_M)] = 0.0
        if not lack.any():
            return
        step = np.zeros(len(points))
        np.maximum.at(step, self._lips, lack[:, None])
        for _ in range(LIP_RINGS):
            step = np.maximum(step, LIP_BLEND * (self._around @ step))
        points[:, 2] += step


class FoldGuard:
    """Smooths skin where it folds over.

    Args:
        outer: Faces of skin, hair and clothes. bool ``[F]``.
        mend: True to smooth what folds at rest, too, which is left alone otherwise.
    """

    def __init__(self, mesh: RigMesh, outer: BoolArray, *, mend: bool = False) -> None:
        moves = np.linalg.norm(mesh.motion_m, axis=2).max(0) > MOVES_M
        faces = mesh.faces[outer & moves[mesh.faces].any(1)]
        self._vertices, local = np.unique(faces, return_inverse=True)
        self._faces = local.reshape(-1, 3).astype(np.int32)
        self._around: csr_array = mean_of_neighbours(self._faces, len(self._vertices))
        self._order, self._start, self._pairs = face_neighbours(self._faces)
        self._as_ever = np.zeros(len(self._order), np.bool_)
        self._rest_m = np.zeros((len(self._vertices), 3))  # where rest folds, no way leads back
        if not mend and len(self._order):
            self._rest_m = mesh.rest_m[self._vertices]
            self._as_ever = self._folded(self._rest_m)[0]

    def _folded(self, points: Float64Array) -> tuple[BoolArray, BoolArray]:
        normal = face_normals(points, self._faces)
        around = np.add.reduceat(normal[self._pairs], self._start, axis=0)
        normal = normal[self._order]
        size = np.linalg.norm(normal, axis=1)
        along = (normal * around).sum(1) / np.maximum(size * np.linalg.norm(around, axis=1), 1e-30)
        folded, nearly = (
            (along < cosine) & (0.5e6 * size > least) for cosine, least in (FOLDED, NEARLY)
        )
        return folded, nearly

    def apply(
        self, points: npt.NDArray[np.floating[Any]], rings: int = 0, *, to_rest: bool = False
    ) -> bool:
        """Smooth folds of posed vertices ``[V, 3]``, metres, and so many rings of skin around them,
        in place; False if there are none. What is smoothed are places, or steps from rest."""
        if not len(self._order):
            return False
        here = points[self._vertices].astype(np.float64)
        folded, nearly = self._folded(here)
        new = folded & ~self._as_ever
        if not new.any():
            return False
        smooth = np.zeros(len(here), np.bool_)
        smooth[self._faces[self._order[new]]] = True
        for _ in range(rings):
            smooth |= self._around @ smooth > 0
        smooth[self._faces[self._order[nearly & ~self._as_ever]]] = True
        of = np.flatnonzero(smooth)
        start = self._rest_m if to_rest else np.zeros_like(here)
        step = here - start
        points[self._vertices[of]] = start[of] + 0.5 * (step[of] + self._around[of] @ step)
        return True


class PoseGuard:
    """All guards, one after the other, until nothing folds; `mend` is `FoldGuard`'s."""

    def __init__(self, mesh: RigMesh, features: Features, *, mend: bool = False) -> None:
        outer = np.isin(features.part, [MATERIALS.index(k) for k in ("skin", "hair", "collar")])
        self._lids, self._lips = LidGuard(mesh), LipGuard(mesh, features)
        self._folds = FoldGuard(mesh, outer, mend=mend)

    def apply(self, points: npt.NDArray[np.floating[Any]]) -> None:
        """Keep posed vertices ``[V, 3]``, metres, whole, in place."""
        self._lids.apply(points)
        self._lips.apply(points)
        for number in range(ROUNDS):
            rings = WIDER_BY if number >= WIDER_AFTER else 0
            to_rest = WIDER_AFTER <= number < ON_AFTER
            if not self._folds.apply(points, rings, to_rest=to_rest):
                return
            self._lids.apply(points, soft_m=GUARD_HARD_M)
            self._lips.apply(points)


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
        self.welded, self.welded_faces = one_of[source], one_of[mesh.faces]
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
        return vertex_normals(vertices, self.welded_faces)[self.welded].astype(np.float32)


def make_rig(source: RigSource, table: dict[str, str | None] | None = None) -> RigHead:
    """Make a head of a rig, with the user's table of names (`names.read_names`) if there is one."""
    moved = {name: np.any(delta != 0, axis=1) for name, delta in source.shapes.items()}
    names = map_names(list(source.shapes), table, moved)
    mesh = build_mesh(source, names)
    if not mesh.motion_m.any():
        raise CaptureError(f"{source.path}: no shape with a known name moves what is drawn")
    return RigHead(mesh, names, source.path.stem or source.path.name)
