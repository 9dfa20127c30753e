"""The built-in heads: 52 ARKit values in, a posed mesh out.

    skin = rest + fields(arkit)  ->  lids slide over the eyeballs  ->  everything below turns with
    the jaw

The mesh is one topology for every identity (`layout`), so an avatar trained on one head has the
UVs of all others. Lengths are metres at this module's boundary and millimetres inside the package.
"""

import functools

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.procedural.features import chart_features, source_uv
from pica_core.capture.procedural.hair import build_hair
from pica_core.capture.procedural.identity import Identity, get_identity
from pica_core.capture.procedural.layout import MOUTH_ROW, build_charts
from pica_core.capture.procedural.lids import LidPose, Lids
from pica_core.capture.procedural.parts import (
    collar,
    ear,
    eye_fixed,
    eyeball,
    mouth_bag,
    teeth,
    tongue,
)
from pica_core.capture.procedural.shapes import build_motion
from pica_core.capture.procedural.skin import EyeSurface, Skin, build_skin, smoothstep
from pica_core.capture.procedural.surface import EYE_RADIUS, EYE_Y, HeadField
from pica_core.capture.rig.drawn import PackedChart
from pica_core.capture.rig.frame import RigFrame
from pica_core.capture.rig.mesh import Eyeball, RigMesh
from pica_core.capture.rig.names import map_names
from pica_core.capture.stage.gaze import gaze, turn
from pica_core.errors import ShapeError
from pica_core.types import Float64Array, FloatArray, IntArray

JAW_PIVOT = (0.0, 2.0, 8.0)
"""The condyle axis, mm: a little below and ahead of the ear axis."""
JAW_OPEN = np.radians(20.5)
"""Rotation at jawOpen = 1; about 30 mm between the incisors."""
JAW_TONGUE = np.radians(6.0)
"""Rotation that tongueOut brings along, so that the tongue finds a gap."""
JAW_SLIDE = (6.5, 5.0)
"""jawLeft/jawRight and jawForward at 1, mm."""


class ProceduralHead:
    """One identity's head.

    Attributes:
        name, identity: Whose head.
        charts: Charts of the UV square, by name.
        vertex_uv: Texture coordinates on texel centres of the position map. float32 ``[V, 2]``.
        faces: Triangles, counter-clockwise from outside. int32 ``[F, 3]``.
        rest_m: Vertices at rest, metres. float32 ``[V, 3]``.
        features, regions: What `rig.features` says of it; its named vertex sets.
        landmarks: Lateral positions and heights of features, head frame, mm.
    """

    def __init__(self, identity: Identity) -> None:
        self.identity = identity
        self.name = identity.name
        self.charts = build_charts()
        face = identity.face
        field = HeadField(face)
        self._eye_surface = EyeSurface(field)
        chart = self.charts["skin"]
        skin = build_skin(field, chart)
        self._motion = build_motion(field, skin, chart)
        self._lids = [Lids(face, self._eye_surface, skin, chart, side) for side in (1.0, -1.0)]
        self.vertex_uv: FloatArray = np.concatenate([c.vertex_uv for c in self.charts.values()])
        slits = {"skin": skin.mouth_hole | skin.eye_hole}
        self.faces: IntArray = np.concatenate(
            [c.faces(slits.get(name)) for name, c in self.charts.items()]
        )
        self._rest = self._build_rest(field, skin)
        self._jaw, self._jaw_closed = self._jaw_weights(field)
        self._fields = self._motion.fields.reshape(NUM_ARKIT, -1).astype(np.float32)
        self._incident, self._weld = self._normal_tables()
        self.landmarks: dict[str, float] = {
            "eye_x": 0.5 * face.eye_distance,
            "brow_y": EYE_Y + face.brow_height,
            "nose_y": field.subnasale_y,
            "nose_half": 0.5 * face.nose_breadth,
            "mouth_y": field.mouth_y,
            "chin_y": field.chin_y,
            "upper_lip": face.upper_lip,
            "lower_lip": face.lower_lip,
            "mouth_half": skin.mouth_half,
        }
        self.rest_m = self.vertices(np.zeros(NUM_ARKIT, np.float32))
        lids = np.zeros(self.num_vertices, np.bool_)
        for eye in self._lids:
            lids[chart.first + eye.index[eye.weight > 0.5]] = True
        self.features = chart_features(identity, self.charts, skin, self.rest_m, self.faces, lids)
        self.regions = self.features.regions
        self.names = map_names(list(ARKIT_NAMES))

    @functools.cached_property
    def mesh(self) -> RigMesh:
        """The head as a rig's mesh; what its shapes add is what they add alone."""
        alone = self.vertices_batch(np.eye(NUM_ARKIT, dtype=np.float32))
        return RigMesh(
            rest_m=self.rest_m.astype(np.float64),
            motion_m=alone - self.rest_m,
            faces=self.faces,
            uv=source_uv(self.identity, self.charts, self.vertex_uv),
            uv_faces=self.faces,
            part=self.features.part,
            material=np.full(len(self.faces), -1, np.int32),
            eyes=tuple(
                Eyeball(
                    side=side,
                    centre_m=0.001 * self._eye_centre * [side, 1.0, 1.0],
                    radius_m=0.001 * EYE_RADIUS,
                    vertices=np.arange(*self.charts[name].span.indices(self.num_vertices)),
                    turned=True,
                )
                for side, name in ((1.0, "eye_left"), (-1.0, "eye_right"))
            ),
            frame=RigFrame(unit="m", axes=np.eye(3), guessed=()),
            dropped=(),
        )

    @functools.cached_property
    def chart(self) -> PackedChart:
        """The UV square as it was laid out."""
        return PackedChart(
            vertex_uv=self.vertex_uv,
            faces=self.faces,
            face_source=np.arange(len(self.faces)),
            source=np.arange(self.num_vertices),
            islands=len(self.charts),
        )

    @property
    def num_vertices(self) -> int:
        """Number of vertices, V."""
        return len(self.vertex_uv)

    def _build_rest(self, field: HeadField, skin: Skin) -> Float64Array:
        inner_z = float(skin.points[..., 2][self.charts["skin"].rows == MOUTH_ROW].max())
        front = inner_z - 1.0
        self._lip_z = np.float32(skin.points[..., 2][self.charts["skin"].rows == 134].max())
        mouth_y = field.mouth_y
        parts = {
            "skin": skin.points,
            "teeth_upper": teeth(self.charts["teeth_upper"], front, mouth_y - 1.5, upper=True),
            "teeth_lower": teeth(
                self.charts["teeth_lower"], front - 3.4, mouth_y - 2.6, upper=False
            ),
            "tongue": tongue(self.charts["tongue"], mouth_y, front),
            "mouth_bag": mouth_bag(self.charts["mouth_bag"], mouth_y, front, field),
            "collar": collar(self.charts["collar"], field),
            "hair": build_hair(self.identity, field, self.charts["hair"]),
        }
        for side, name in ((1.0, "left"), (-1.0, "right")):
            parts[f"eye_{name}"] = eyeball(self.charts[f"eye_{name}"], self._eye_surface, side)
            parts[f"ear_{name}"] = ear(self.charts[f"ear_{name}"], field, side)
        self._eye_centre = np.asarray(field.eye_centre)
        self._eye_turns = 1.0 - eye_fixed(self.charts["eye_left"]).ravel().astype(np.float32)
        return np.concatenate([parts[name].reshape(-1, 3) for name in self.charts])

    def _jaw_weights(self, field: HeadField) -> tuple[FloatArray, FloatArray]:
        free = np.zeros(self.num_vertices)
        free[self.charts["teeth_lower"].span] = 1.0
        y, z = self._rest[:, 1], self._rest[:, 2]
        tongue_span, bag = self.charts["tongue"].span, self.charts["mouth_bag"].span
        free[tongue_span] = smoothstep(20.0, 60.0, z[tongue_span])
        free[bag] = smoothstep(field.mouth_y + 6, field.mouth_y - 10, y[bag])
        closed = free.copy()
        free[self.charts["skin"].span] = self._motion.jaw
        closed[self.charts["skin"].span] = self._motion.jaw_closed
        return free.astype(np.float32), closed.astype(np.float32)

    def vertices(self, arkit: npt.ArrayLike) -> FloatArray:
        """Vertices at the 52 shapes ``[52]``, about [0, 1]; metres, head frame. float32 ``[V, 3]``.

        Raises:
            ShapeError: `arkit` does not have 52 values.
        """
        values = np.asarray(arkit, np.float32)
        if values.shape != (NUM_ARKIT,):
            raise ShapeError(f"arkit is {values.shape}; [{NUM_ARKIT}] is needed")
        return self.vertices_batch(values[None])[0]

    def vertices_batch(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose the head several times: arkit ``[N, 52]`` to float32 ``[N, V, 3]``, metres.

        Raises:
            ShapeError: The last dimension is not 52.
        """
        values = np.asarray(arkit, np.float32)
        if values.ndim != 2 or values.shape[1] != NUM_ARKIT:
            raise ShapeError(f"arkit is {values.shape}; [N, {NUM_ARKIT}] is needed")
        count = len(values)
        points = np.broadcast_to(self._rest.astype(np.float32), (count, *self._rest.shape)).copy()
        skin = self.charts["skin"]
        # What the skin adds to an opening jaw (a raised upper lip) is taken back as the lips close
        # over it.
        strokes = values.copy()
        strokes[:, ARKIT_INDEX["jawOpen"]] *= 1.0 - self._closing(values)
        points[:, skin.span] += (strokes @ self._fields).reshape(count, -1, 3)
        self._turn_eyes(points, values)
        self._move_tongue(points, values)
        self._turn_jaw(points, values)
        points *= 0.001
        return points

    def _shape(self, values: FloatArray, name: str) -> FloatArray:
        return values[:, ARKIT_INDEX[name]]

    def _closing(self, values: FloatArray) -> FloatArray:
        """How far the lips are closed over an open jaw, 0 to 1: mouthClose / jawOpen. ``[N]``."""
        opening = np.maximum(self._shape(values, "jawOpen"), 1e-3)
        return np.clip(self._shape(values, "mouthClose") / opening, 0.0, 1.0)

    def _turn_eyes(self, points: FloatArray, values: FloatArray) -> None:
        for lids, side, name in zip(self._lids, (1.0, -1.0), ("Left", "Right"), strict=True):
            out, inwards, up, down = (
                self._shape(values, f"eyeLook{key}{name}") for key in ("Out", "In", "Up", "Down")
            )
            yaw, pitch = gaze(side, out=out, inwards=inwards, up=up, down=down)
            span = self.charts[f"eye_{name.lower()}"].span
            centre = self._eye_centre * [side, 1.0, 1.0]
            local = (self._rest[span] - centre).astype(np.float32)
            turned = turn(local, yaw[:, None] * self._eye_turns, pitch[:, None] * self._eye_turns)
            points[:, span] = turned + centre.astype(np.float32)
            pose = LidPose(
                blink=self._shape(values, f"eyeBlink{name}").astype(np.float64),
                wide=self._shape(values, f"eyeWide{name}").astype(np.float64),
                squint=self._shape(values, f"eyeSquint{name}").astype(np.float64),
                pitch=pitch.astype(np.float64),
            )
            index = self.charts["skin"].first + lids.index
            weight = lids.weight[:, None]
            blended = points[:, index] * (1 - weight) + lids.points(pose) * weight
            points[:, index] = blended

    def _move_tongue(self, points: FloatArray, values: FloatArray) -> None:
        span = self.charts["tongue"].span
        out = self._shape(values, "tongueOut")[:, None]
        rest = self._rest[span]
        forward = smoothstep(rest[:, 2].min() + 8, rest[:, 2].max(), rest[:, 2]).astype(np.float32)
        # Up over the teeth and the lower lip, then down where the lip ends.
        y, z = points[:, span, 1], points[:, span, 2] + 36.0 * out * forward
        past_lip = np.maximum(z - self._lip_z, 0.0)
        thin = (rest[:, 1] - rest[:, 1].max()) * (-0.55) * forward  # the outer part is flat
        y = y + out * (8.5 * np.sqrt(forward) + thin)
        points[:, span, 1] = y - out * past_lip**2 / 26.0
        points[:, span, 2] = z
        points[:, span, 0] *= 1 - 0.18 * out * forward

    def _turn_jaw(self, points: FloatArray, values: FloatArray) -> None:
        opening = self._shape(values, "jawOpen")
        weight = self._jaw + self._closing(values)[:, None] * (self._jaw_closed - self._jaw)
        angle = JAW_OPEN * opening + JAW_TONGUE * self._shape(values, "tongueOut")
        turn = angle[:, None] * weight
        sine, cosine = np.sin(turn), np.cos(turn)
        y = points[..., 1] - JAW_PIVOT[1]
        z = points[..., 2] - JAW_PIVOT[2]
        points[..., 1] = cosine * y - sine * z + JAW_PIVOT[1]
        points[..., 2] = cosine * z + sine * y + JAW_PIVOT[2]
        sideways = self._shape(values, "jawLeft") - self._shape(values, "jawRight")
        points[..., 0] += JAW_SLIDE[0] * sideways[:, None] * weight
        points[..., 2] += JAW_SLIDE[1] * self._shape(values, "jawForward")[:, None] * weight

    def _normal_tables(self) -> tuple[IntArray, list[tuple[IntArray, IntArray]]]:
        """Faces around each vertex (padded with F), and vertices that share a normal."""
        flat = self.faces.ravel()
        order = np.argsort(flat, kind="stable")
        corner_vertex, corner_face = flat[order], (order // 3).astype(np.int32)
        count = np.bincount(flat, minlength=self.num_vertices).astype(np.int32)
        start = np.cumsum(count) - count
        table = np.full((self.num_vertices, int(count.max())), len(self.faces), np.int32)
        table[corner_vertex, np.arange(len(flat)) - start[corner_vertex]] = corner_face
        weld: list[tuple[IntArray, IntArray]] = []
        for name in ("skin", "collar", "hair", "ear_left", "ear_right"):
            chart = self.charts[name]
            index = (chart.first + np.arange(chart.count, dtype=np.int32)).reshape(chart.shape)
            around = index if name.startswith("ear") else index.T  # rows run round an ear
            weld.append((around[0], around[-1]))
        return table, weld

    def normals(self, vertices: FloatArray) -> FloatArray:
        """Unit vertex normals, area weighted and smooth across seams. float32 ``[V, 3]``."""
        a, b, c = (vertices[self.faces[:, corner]] for corner in range(3))
        face_normals = np.zeros((len(self.faces) + 1, 3), np.float32)
        face_normals[:-1] = np.cross(b - a, c - a)
        normals = face_normals[self._incident].sum(1)
        for first, last in self._weld:
            both = normals[first] + normals[last]
            normals[first] = both
            normals[last] = both
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return normals / np.maximum(length, 1e-20)


@functools.lru_cache(maxsize=8)
def make_head(name: str) -> ProceduralHead:
    """Build a built-in head by identity name (``S1`` to ``S6``). Heads do not change, so calls
    share them.

    Raises:
        CaptureError: No identity has this name.
    """
    return ProceduralHead(get_identity(name))
