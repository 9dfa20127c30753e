"""The built-in heads: stored rigs, 52 ARKit values in, a posed mesh out.

    skin = rest + motion(arkit)  ->  lids slide over the eyeballs  ->  everything below turns with
    the jaw

The mesh is one topology for every head, its vertices on texel centres of the position map, so an
avatar trained on one head has the UVs of all others. Lengths are metres at this module's boundary
and millimetres inside. Of `heads.npz`, docs/heads.md says how it was made.
"""

import functools
import json
from importlib.resources import files
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, NUM_ARKIT
from pica_core.capture.dataset.files import MAP_SIZE, Topology
from pica_core.capture.rig.drawn import PackedChart
from pica_core.capture.rig.features import Features, Mouth
from pica_core.capture.rig.frame import RigFrame
from pica_core.capture.rig.gaze import gaze, turn
from pica_core.capture.rig.mesh import Eyeball, RigMesh
from pica_core.capture.rig.names import map_names
from pica_core.capture.rig.skin import Growth
from pica_core.capture.triangles import vertex_normals
from pica_core.errors import CaptureError, ShapeError
from pica_core.types import Array, Float64Array, FloatArray, Int64Array

HEADS = ("S1", "S2", "S3", "S4", "S5", "S6")
REST_MM, MOTION_MM, SHARE, UV_M = 0.002, 0.005, 1 / 4095, 1e-5
"""Steps in which places, motion, weights and coordinates along weaves are stored."""
EYE_RADIUS_M = 0.012
JAW_PIVOT = (0.0, 2.0, 8.0)
"""The condyle axis, mm: a little below and ahead of the ear axis."""
JAW_OPEN = np.radians(20.5)
"""Rotation at jawOpen = 1; about 30 mm between the incisors."""
JAW_TONGUE = np.radians(6.0)
"""Rotation that tongueOut brings along, so that the tongue finds a gap."""
JAW_SLIDE = (6.5, 5.0)
"""jawLeft/jawRight and jawForward at 1, mm."""
LIDS_MEET = 0.16
"""Where the lids meet: at this share of the opening above the lower lid."""
LID_SHIFTS_MM = -18.0, 0.5
"""Least shift in the table of a lid's depths, and its step."""


def _sum(changes: Array, step: float) -> Float64Array:
    """Undo differences along the last axis."""
    return step * np.cumsum(changes, axis=-1, dtype=np.int64).astype(np.float64)


class ProceduralHead:
    """One built-in head, that is drawn as a rig.

    Attributes:
        charts: Vertices of each chart, by name: the crossings of texel rows and columns of a
            rectangle of the UV square.
        vertex_uv: Texture coordinates on texel centres of the position map. float32 ``[V, 2]``.
        faces: Triangles, counter-clockwise from outside. int32 ``[F, 3]``.
        rest_m: Vertices at rest, metres. float32 ``[V, 3]``.
        features, regions: What `rig.features` says of it; its named vertex sets.
        paint: Colours and marks, as `appearance.frag` names them.
        landmarks: Lateral positions and heights of features, head frame, mm.

    Raises:
        CaptureError: No built-in head has this name.
    """

    def __init__(self, name: str) -> None:
        if name not in HEADS:
            raise CaptureError(f"head {name!r} is unknown; built in are {', '.join(HEADS)}")
        self.name = name
        with np.load(str(files("pica_core.capture.procedural") / "heads.npz")) as stored:
            about = json.loads(stored["about"].tobytes())
            mine = {
                key.removeprefix(f"{name}."): stored[key]
                for key in stored.files
                if key.startswith(f"{name}.") or "." not in key
            }
        own: dict[str, Any] = about[name]
        self.charts: dict[str, slice] = {}
        texels, first = [], 0
        for chart, lines in about["charts"].items():
            texels.append(np.stack(np.meshgrid(lines["columns"], lines["rows"]), -1).reshape(-1, 2))
            self.charts[chart] = slice(first, first + len(texels[-1]))
            first += len(texels[-1])
        self.vertex_uv = ((np.concatenate(texels) + 0.5) / MAP_SIZE).astype(np.float32)
        self.faces = _sum(mine["faces"], 1).T.astype(np.int32)
        self._weld = _sum(mine["weld"], 1).astype(np.int32)
        self._rest = _sum(mine["rest"], REST_MM).T
        rows_of = np.cumsum(mine["motion"], axis=-2, dtype=np.int32)
        motion = np.moveaxis(_sum(rows_of, MOTION_MM), 1, -1)
        self._motion = motion.reshape(NUM_ARKIT, -1).astype(np.float32)
        self._jaw, self._jaw_closed = _sum(mine["jaw"], SHARE).astype(np.float32)
        self._uv = _sum(mine["uv"], UV_M).T
        self._eye_turns: FloatArray = mine["turns"]
        self._lid_index = self.charts["skin"].start + mine["lid_index"].astype(np.int64)
        self._lid_is_upper, self._lid = mine["lid_upper"], mine["lid_numbers"].astype(np.float64)
        self._lid_depth = _sum(mine["lid_depth"], REST_MM)
        self._eye_mm, self._lip_z = np.array(own["eye_mm"]), own["lip_z"]
        self.paint, self.landmarks = own["look"], own["landmarks"]
        hairs, strand = (mine[key].T.astype(np.float32) for key in ("hairs", "strand"))
        self.growth = Growth(hairs=hairs, strand=strand)
        bits = np.unpackbits(mine["regions"], axis=1, count=first).astype(np.bool_)
        x, y, z = mine["mouth"]
        self.features = Features(
            mouth=Mouth(half_m=own["mouth_half_m"], x=x, y=y, z=z, centre_x=0.0),
            lips=mine["lips"].astype(np.float64),
            eye_gap_m=mine["eye_gap_m"].astype(np.float64),
            above_eye=mine["above_eye"],
            brow_y=own["brow_y"],
            nose_tip=np.array(own["nose_tip"]),
            part=mine["part"].astype(np.int32),
            regions=dict(zip(about["regions"], bits, strict=True)),
        )
        self.regions = self.features.regions
        self.names = map_names(list(ARKIT_NAMES))
        self.topology = Topology(vertex_uv=self.vertex_uv, faces=self.faces, regions=self.regions)
        self.chart = PackedChart(
            vertex_uv=self.vertex_uv,
            faces=self.faces,
            face_source=np.arange(len(self.faces)),
            source=np.arange(first),
            islands=len(self.charts),
        )
        self.rest_m = self.vertices(np.zeros(NUM_ARKIT, np.float32))

    @functools.cached_property
    def mesh(self) -> RigMesh:
        """The head as a rig's mesh; what its shapes add is what they add alone."""
        alone = self.vertices_batch(np.eye(NUM_ARKIT, dtype=np.float32))
        return RigMesh(
            rest_m=self.rest_m.astype(np.float64),
            motion_m=alone - self.rest_m,
            faces=self.faces,
            uv=self._uv,
            uv_faces=self.faces,
            part=self.features.part,
            material=np.full(len(self.faces), -1, np.int32),
            eyes=tuple(
                Eyeball(
                    side=side,
                    centre_m=0.001 * self._eye_mm * [side, 1.0, 1.0],
                    radius_m=EYE_RADIUS_M,
                    vertices=np.arange(self.charts[name].start, self.charts[name].stop),
                    turned=True,
                )
                for side, name in ((1.0, "eye_left"), (-1.0, "eye_right"))
            ),
            frame=RigFrame(unit="m", axes=np.eye(3), guessed=()),
            dropped=(),
        )

    def vertices(self, arkit: npt.ArrayLike) -> FloatArray:
        """Vertices at the 52 shapes ``[52]``, about [0, 1]; metres, head frame. float32 ``[V, 3]``.

        Raises:
            ShapeError: `arkit` does not have 52 values.
        """
        return self.vertices_batch(np.asarray(arkit, np.float32)[None])[0]

    def vertices_batch(self, arkit: npt.ArrayLike) -> FloatArray:
        """Pose the head several times: arkit ``[N, 52]`` to float32 ``[N, V, 3]``, metres.

        Raises:
            ShapeError: The last dimension is not 52.
        """
        values = np.asarray(arkit, np.float32)
        if values.ndim != 2 or values.shape[1] != NUM_ARKIT:
            raise ShapeError(f"arkit is {values.shape[1:]} a pose; [{NUM_ARKIT}] is needed")
        count = len(values)
        points = np.broadcast_to(self._rest.astype(np.float32), (count, *self._rest.shape)).copy()
        # What the skin adds to an opening jaw (a raised upper lip) is taken back as the lips close
        # over it.
        strokes = values.copy()
        strokes[:, ARKIT_INDEX["jawOpen"]] *= 1.0 - self._closing(values)
        points[:, self.charts["skin"]] += (strokes @ self._motion).reshape(count, -1, 3)
        for eye, side, name in ((0, 1.0, "Left"), (1, -1.0, "Right")):
            pitch = self._turn_eye(points, values, side, name)
            self._slide_lids(points, values, self._lid_index[eye], name, pitch)
        self._move_tongue(points, values)
        self._turn_jaw(points, values)
        points *= 0.001
        return points

    def _shape(self, values: FloatArray, name: str) -> FloatArray:
        return values[:, ARKIT_INDEX[name], None]

    def _closing(self, values: FloatArray) -> FloatArray:
        """How far the lips are closed over an open jaw, 0 to 1: mouthClose / jawOpen. ``[N]``."""
        opening = np.maximum(values[:, ARKIT_INDEX["jawOpen"]], 1e-3)
        return np.clip(values[:, ARKIT_INDEX["mouthClose"]] / opening, 0.0, 1.0)

    def _turn_eye(
        self, points: FloatArray, values: FloatArray, side: float, name: str
    ) -> FloatArray:
        """Turn an eyeball against its fixed skirt; returns its pitch ``[N, 1]``."""
        yaw, pitch = (angle[:, None] for angle in gaze(side, values))
        span = self.charts[f"eye_{name.lower()}"]
        centre = (self._eye_mm * [side, 1.0, 1.0]).astype(np.float32)
        local = self._rest[span].astype(np.float32) - centre
        points[:, span] = turn(local, yaw * self._eye_turns, pitch * self._eye_turns) + centre
        return pitch

    def _slide_lids(
        self, points: FloatArray, values: FloatArray, index: Int64Array, name: str, pitch: Array
    ) -> None:
        """Slide the lids over the eyeball, through which they can never be pushed.

        A lid's vertex keeps its place between margin and fold; what moves is the height of the
        margin. Depth follows from a table, so any sum of blink, squint, wide and gaze is safe.
        """
        weight, upper0, lower0, slide, at_edge = self._lid
        blink, wide, squint = (
            np.clip(self._shape(values, f"eye{key}{name}"), 0.0, 1.0).astype(np.float64)
            for key in ("Blink", "Wide", "Squint")
        )
        opening = np.maximum(upper0 - lower0, 0.0)
        shape = opening / 10.0  # corners do not move
        down, up = np.minimum(pitch, 0.0), np.maximum(pitch, 0.0)
        upper = upper0 + shape * (2.4 * wide - 0.5 * squint + 5.5 * down + 2.6 * up)
        lower = lower0 + shape * (2.2 * squint + 2.2 * down - 0.4 * wide)
        meet = lower0 + LIDS_MEET * opening
        upper, lower = upper + blink * (meet - upper), lower + blink * (meet - lower)
        middle, crossed = 0.5 * (upper + lower), lower > upper
        upper, lower = np.where(crossed, middle, upper), np.where(crossed, middle, lower)
        shift = np.where(self._lid_is_upper, upper - upper0, lower - lower0)
        # Closed lids overlap by a quarter of a millimetre, so that no eye shines through.
        shift = shift - 0.25 * blink**4 * at_edge
        low, step = LID_SHIFTS_MM
        place = np.clip((shift - low) / step, 0.0, self._lid_depth.shape[1] - 1.001)
        at = place.astype(np.int64)
        vertex = np.arange(len(index))
        nearer, farther = self._lid_depth[vertex, at], self._lid_depth[vertex, at + 1]
        x, y, _ = self._rest[index].T
        z = nearer + (place - at) * (farther - nearer)
        slid = np.stack(np.broadcast_arrays(x, y + shift * slide, z), -1)
        points[:, index] += weight[:, None] * (slid - points[:, index])

    def _move_tongue(self, points: FloatArray, values: FloatArray) -> None:
        span = self.charts["tongue"]
        out = self._shape(values, "tongueOut")
        rest = self._rest[span]
        t = np.clip((rest[:, 2] - rest[:, 2].min() - 8) / (np.ptp(rest[:, 2]) - 8), 0.0, 1.0)
        forward = (t * t * (3 - 2 * t)).astype(np.float32)
        # Up over the teeth and the lower lip, then down where the lip ends.
        y, z = points[:, span, 1], points[:, span, 2] + 36.0 * out * forward
        past_lip = np.maximum(z - self._lip_z, 0.0)
        thin = (rest[:, 1] - rest[:, 1].max()) * (-0.55) * forward  # the outer part is flat
        y = y + out * (8.5 * np.sqrt(forward) + thin)
        points[:, span, 1] = y - out * past_lip**2 / 26.0
        points[:, span, 2] = z
        points[:, span, 0] *= 1 - 0.18 * out * forward

    def _turn_jaw(self, points: FloatArray, values: FloatArray) -> None:
        weight = self._jaw + self._closing(values)[:, None] * (self._jaw_closed - self._jaw)
        angle = JAW_OPEN * self._shape(values, "jawOpen")
        angle = (angle + JAW_TONGUE * self._shape(values, "tongueOut")) * weight
        sine, cosine = np.sin(angle), np.cos(angle)
        y = points[..., 1] - JAW_PIVOT[1]
        z = points[..., 2] - JAW_PIVOT[2]
        points[..., 1] = cosine * y - sine * z + JAW_PIVOT[1]
        points[..., 2] = cosine * z + sine * y + JAW_PIVOT[2]
        sideways = self._shape(values, "jawLeft") - self._shape(values, "jawRight")
        points[..., 0] += JAW_SLIDE[0] * sideways * weight
        points[..., 2] += JAW_SLIDE[1] * self._shape(values, "jawForward") * weight

    def normals(self, vertices: FloatArray) -> FloatArray:
        """Unit vertex normals, area weighted and smooth across seams. float32 ``[V, 3]``."""
        unit = vertex_normals(vertices, self._weld[self.faces])
        return unit[self._weld].astype(np.float32)


@functools.lru_cache(maxsize=8)
def make_head(name: str) -> ProceduralHead:
    """Read a built-in head (``S1`` to ``S6``). Heads do not change, so calls share them.

    Raises:
        CaptureError: No built-in head has this name.
    """
    return ProceduralHead(name)
