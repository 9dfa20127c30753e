"""A rig in our units, axes and names: what the reader found, made ready to be posed and drawn.

Vertices that only a seam of the texture coordinates tells apart become one. Transparent layers over
the eyes go, since nothing here is transparent. Eyeballs are found by their shape.
"""

import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.names import NameMap
from pica_core.capture.rig.source import RigSource
from pica_core.capture.triangles import components
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, Float64Array, FloatArray, Int64Array, IntArray

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
FACE_M = (0.036, 0.36)
"""From the middle of what eye shapes move to the middle of what mouth shapes move: 60 to 85 mm in
people. One decade around that, so that exactly one of the units fits."""
MAX_SIZE_M = 4.0
"""Of a rig with its body, and of what a shape moves."""
EYES_AT_M = (0.0, 0.022, 0.074)
"""Where the middle between the eyeballs goes."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigFrame:
    """How the file's coordinates become ours, an offset apart.

    Attributes:
        unit: ``m``, ``cm`` or ``mm``.
        turned: True if the rig looks along -z, as those of VRM 0.x do.
        guessed: What could not be found and was assumed, in words.
    """

    unit: str
    turned: bool
    guessed: tuple[str, ...]

    def points(self, positions: npt.NDArray[np.floating]) -> Float64Array:
        """Positions or displacements in metres and our axes, without an offset. ``[..., 3]``."""
        side = -1.0 if self.turned else 1.0
        return positions * (np.array([side, 1.0, side]) * UNITS[self.unit])


def _centre(
    positions: Float64Array, shapes: dict[str, FloatArray], names: list[str]
) -> Float64Array | None:
    """Mean position weighted by how far the shapes move each vertex; None without motion."""
    weight = np.zeros(len(positions))
    for name in names:
        length = np.linalg.norm(shapes[name], axis=1)
        if length.max() > 0:
            weight += (length / length.max()) ** 2
    return weight @ positions / weight.sum() if weight.sum() > 0 else None


def find_frame(positions: Float64Array, shapes: dict[str, FloatArray], names: NameMap) -> RigFrame:
    """Unit and heading of a rig, from its neutral vertices and its displacements by source name;
    up is +y, as glTF has it.

    Raises:
        CaptureError: No unit makes this a head.
    """

    def moved(*prefixes: str, side: str = "") -> Float64Array | None:
        sources = [
            driver.source
            for arkit, drivers in names.drivers.items()
            if arkit.startswith(prefixes) and arkit.endswith(side)
            for driver in drivers
            if not driver.half
        ]
        return _centre(positions, shapes, sources)

    guessed = []
    sided = ("eye", "brow", "cheek", "nose", "mouthSmile", "mouthFrown", "mouthDimple")
    left, right = moved(*sided, side="Left"), moved(*sided, side="Right")
    if left is None or right is None:
        guessed.append("heading: it looks along +z, for no shapes of both sides say")
    upper, lower = moved("eye", "brow"), moved("jaw", "mouth")
    if upper is not None and lower is not None:
        length, what = abs(float(upper[1] - lower[1])), "from eyes to mouth"
    else:
        length, what = float(np.ptp(positions[:, 1])) / 4, "a quarter of its height"
        guessed.append("unit: found from the height of the whole mesh")
    for unit, scale in UNITS.items():
        if FACE_M[0] <= length * scale < FACE_M[1]:
            turned = left is not None and right is not None and bool(left[0] < right[0])
            return RigFrame(unit=unit, turned=turned, guessed=tuple(guessed))
    raise CaptureError(
        f"the rig measures {length:.4g} {what}; as m, cm or mm that is no head "
        f"({FACE_M[0]} to {FACE_M[1]} m is)"
    )


OVERLAY = re.compile(
    r"occlu|lacrimal|tear|fluid|blend|cornea|meniscus|eye_?shadow|wetness|lash|eye_?brow", re.I
)
"""Materials that are transparent anywhere (layers over the eyes, cards of hairs): left out."""
PART_WORDS: tuple[tuple[str, str], ...] = (
    ("hair", r"hair|beard|scalp_?cap|moustache"),
    ("teeth", r"teeth|tooth|denti?"),
    ("tongue", r"tongue"),
    ("mouth_bag", r"gum|gingiva|mouth|oral|saliva"),
    ("eye", r"eye(?!lid)|sclera|iris|pupil"),
    ("collar", r"cloth|shirt|collar|jacket|suit|outfit|dress"),
)
"""What a material's name says of the part it covers, in this order; everything else is skin."""
EYE_RADIUS_M = (0.008, 0.021)
BALL_FIT, CAP_FIT = (0.06, 0.8), (0.12, 0.25)
"""Mean distance from a sphere, at most, and least extent, in radii: of what may be an eyeball, and
of what its material calls an eye."""
MARKS = ("neck", "ears")
"""Regions of skin that are marked in the face model."""
HALF_BLEND_M = 0.006
"""Half the width over which one shape for both sides changes from one side to the other."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Eyeball:
    """One eyeball of a rig: a sphere in the head frame.

    Attributes:
        side: 1 for the subject's left, -1 for the right.
        centre_m, radius_m: The fitted sphere, metres. float64 ``[3]``.
        vertices: Its vertices. int64 ``[n]``.
        turned: True when the rig's own eyeLook shapes turn it.
    """

    side: float
    centre_m: Float64Array
    radius_m: float
    vertices: Int64Array
    turned: bool


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RigMesh:
    """A rig in metres and head axes, welded.

    Attributes:
        rest_m: Neutral vertices. float64 ``[P, 3]``.
        motion_m: What each ARKit shape adds at 1. float32 ``[52, P, 3]``.
        faces: Triangles, counter-clockwise from outside. int32 ``[F, 3]``.
        uv: Texture coordinates, v downwards, 0 where there are none. float64 ``[T, 2]``.
        uv_faces: Triangles in `uv`. int32 ``[F, 3]``.
        colours: Linear RGB that images are multiplied with, at the corners of each triangle; None:
            white. float32 ``[F, 3, 3]``.
        part: Index into `multiface.MATERIALS`. int32 ``[F]``.
        material: Index into the source's materials. int32 ``[F]``.
        eyes: Eyeballs found, left first.
        marks: Vertices of `MARKS` by name, where the face model marks them.
    """

    rest_m: Float64Array
    motion_m: FloatArray
    faces: IntArray
    uv: Float64Array
    uv_faces: IntArray
    part: IntArray
    material: IntArray
    eyes: tuple[Eyeball, ...]
    frame: RigFrame
    dropped: tuple[str, ...]
    marks: dict[str, Int64Array] = field(default_factory=dict)
    colours: FloatArray | None = None

    def of_part(self, *names: str) -> BoolArray:
        """Vertices that faces of these materials use. bool ``[P]``."""
        mask = np.zeros(len(self.rest_m), np.bool_)
        wanted = np.isin(self.part, [MATERIALS.index(name) for name in names])
        mask[self.faces[wanted].ravel()] = True
        return mask


def fit_sphere(points: Float64Array) -> tuple[Float64Array, float, float]:
    """Least-squares sphere: centre, radius, and mean distance from its surface."""
    middle = points.mean(0)
    q = points - middle
    matrix = np.concatenate([2 * q, np.ones((len(q), 1))], 1)
    solution = np.linalg.lstsq(matrix, (q * q).sum(1), rcond=None)[0]
    centre = solution[:3]
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 0.0)))
    error = float(np.abs(np.linalg.norm(q - centre, axis=1) - radius).mean())
    return centre + middle, radius, error


def _weld(source: RigSource) -> tuple[Int64Array, Int64Array]:
    """Index of one vertex of each welded group, and the group of each vertex."""
    size = max(float(np.ptp(source.positions, axis=0).max()), 1e-12)
    random = np.random.default_rng(0)
    # Displacements are told apart by a few random sums of them.
    sums = np.zeros((len(source.positions), 2))
    for delta in source.shapes.values():
        sums += delta.astype(np.float64) @ random.normal(size=(3, 2)) / size
    table = np.rint(np.concatenate([source.positions / size, sums], 1) * 1e6).astype(np.int64)
    return _alike(table)


def _alike(table: npt.NDArray[Any]) -> tuple[Int64Array, Int64Array]:
    """Index of the first row of each group of equal rows, in order, and the group of each row."""
    _, first, group = np.unique(table, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[group.ravel()]


def _motion(
    source: RigSource, names: NameMap, frame: RigFrame, keep: Int64Array, x: Float64Array
) -> FloatArray:
    motion = np.zeros((NUM_ARKIT, len(keep), 3), np.float32)
    t = np.clip(0.5 + 0.5 * x / HALF_BLEND_M, 0.0, 1.0)
    left = (t * t * (3 - 2 * t))[:, None]
    for arkit, drivers in names.drivers.items():
        for driver in drivers:
            delta = frame.points(source.shapes[driver.source][keep])
            if driver.half:
                delta = delta * (left if driver.half == "Left" else 1 - left)
            motion[ARKIT_INDEX[arkit]] += delta.astype(np.float32)
    return motion


def _find_eyes(
    rest: Float64Array, motion: FloatArray, label: Int64Array, middle_x: float, named: BoolArray
) -> tuple[tuple[Eyeball, ...], BoolArray]:
    """Eyeballs by sphere fit, and vertices of shells that lie hidden inside them.

    What is `named` an eye ``[P]`` may be a cap of a sphere, or dented by an iris.
    """
    balls: list[tuple[float, Float64Array, Int64Array]] = []
    for first in np.unique(label):
        index = np.flatnonzero(label == first)
        if len(index) < 12:
            continue
        extent = np.ptp(rest[index], axis=0)
        off, least = CAP_FIT if named[index].all() else BALL_FIT
        if extent.max() > 2.4 * EYE_RADIUS_M[1] or extent.max() < 1.2 * EYE_RADIUS_M[0]:
            continue
        centre, radius, error = fit_sphere(rest[index])
        round_enough = error < off * radius and extent.min() > least * radius
        if EYE_RADIUS_M[0] < radius < EYE_RADIUS_M[1] and round_enough:
            balls.append((radius, centre, index))
    eyes: list[Eyeball] = []
    hidden = np.zeros(len(rest), np.bool_)
    look = [i for name, i in ARKIT_INDEX.items() if name.startswith("eyeLook")]
    for side in (1.0, -1.0):
        here = [b for b in balls if (b[1][0] - middle_x) * side > 0.01]
        if not here:
            continue
        radius, centre, index = max(here, key=lambda ball: ball[0])
        together = [index]
        ahead = (rest[index] - centre) / radius
        covers_front = bool((ahead[:, 2] > 0.97).any())
        reach = np.median(np.linalg.norm(rest[index] - centre, axis=1))
        for _, other_centre, other in here:
            if other is index or np.linalg.norm(other_centre - centre) > 0.5 * radius:
                continue
            inside = np.quantile(np.linalg.norm(rest[other] - centre, axis=1), 0.95) < reach
            if inside and covers_front:
                hidden[other] = True
            else:
                together.append(other)
        all_of_it = np.concatenate(together)
        moved = np.linalg.norm(motion[look][:, all_of_it], axis=2).mean(1).max()
        eyes.append(
            Eyeball(
                side=side,
                centre_m=centre,
                radius_m=radius,
                vertices=all_of_it,
                turned=bool(moved > 0.0003),
            )
        )
    return tuple(eyes), hidden


def _part_of(material: str) -> str:
    """The part that a material's name says it covers."""
    return next((kind for kind, words in PART_WORDS if re.search(words, material, re.I)), "skin")


def _parts(
    source: RigSource, material: IntArray, faces: IntArray, count: int, eyes: tuple[Eyeball, ...]
) -> IntArray:
    """Part of each face of a mesh of so many vertices."""
    part = np.zeros(len(faces), np.int32)
    for index, name in enumerate(source.materials):
        part[material == index] = MATERIALS.index(_part_of(name))
    in_eye = np.zeros(count, np.bool_)
    for eye in eyes:
        in_eye[eye.vertices] = True
    if eyes:  # what is called an eye and is no eyeball (a lid, a shadow) is skin
        part[part == MATERIALS.index("eye")] = 0
    part[in_eye[faces].all(1)] = MATERIALS.index("eye")
    return part


def _is_first(faces: IntArray, among: BoolArray) -> BoolArray:
    """Whether none of these faces before it has the same vertices in the same order: what is drawn
    several times at one place is packed and posed once. bool ``[F]``."""
    index = np.flatnonzero(among)
    turn = (faces[index].argmin(1)[:, None] + np.arange(3)) % 3
    turned = np.take_along_axis(faces[index], turn, 1)
    is_first = np.zeros(len(faces), np.bool_)
    is_first[index[_alike(turned)[0]]] = True
    return is_first


@np.errstate(over="ignore", invalid="ignore")  # what is no number is beyond a limit
def build_mesh(source: RigSource, names: NameMap) -> RigMesh:
    """Bring a rig into our units, axes and names, and find its parts.

    Raises:
        CaptureError: No unit makes it a head, it is larger than people, or nothing is left to draw.
    """
    frame = find_frame(source.positions, source.shapes, names)
    size_m = float(np.ptp(frame.points(source.positions), axis=0).max())
    if not size_m <= MAX_SIZE_M:
        raise CaptureError(f"{source.path}: {size_m:.3g} m large; up to {MAX_SIZE_M:g} m are read")
    for name, delta in source.shapes.items():
        far_m = float(np.abs(frame.points(delta)).max())
        if not far_m <= MAX_SIZE_M:
            raise CaptureError(
                f"{source.path}: shape {name!r} moves a vertex by {far_m:.3g} m; "
                f"up to {MAX_SIZE_M:g} m are read"
            )
    keep, group = _weld(source)
    rest = frame.points(source.positions[keep])
    middle_x = 0.5 * float(rest[:, 0].min() + rest[:, 0].max())
    motion = _motion(source, names, frame, keep, rest[:, 0] - middle_x)
    faces = group[source.faces].astype(np.int32)
    # What normals alone tell apart, or a file without indices, is no seam.
    corner, place = _alike(np.column_stack([group, np.rint(source.uv * 1e6)]))
    uv_faces, material = place[source.faces].astype(np.int32), source.face_material
    overlay = [k for k, name in enumerate(source.materials) if OVERLAY.search(name)]
    shown = ~np.isin(material, overlay)
    shown &= (faces != np.roll(faces, 1, axis=1)).all(1)
    shown &= _is_first(faces, shown)
    if not shown.any():
        raise CaptureError(f"{source.path}: no face is left without transparent materials")
    label = components(faces[shown], len(rest))
    called = [k for k, name in enumerate(source.materials) if _part_of(name) == "eye"]
    named = np.zeros(len(rest), np.bool_)
    named[faces[shown & np.isin(material, called)]] = True
    eyes, hidden = _find_eyes(rest, motion, label, middle_x, named)
    shown &= ~hidden[faces].any(1)
    remaining = np.unique(material[shown])
    dropped = [name for k, name in enumerate(source.materials) if k not in remaining]
    faces, material, uv_faces = faces[shown], material[shown], uv_faces[shown]
    part = _parts(source, material, faces, len(rest), eyes)
    offset = np.array(EYES_AT_M) - _eye_point(rest, motion, eyes, middle_x)
    rest = rest + offset
    used, again = np.unique(faces, return_inverse=True)
    rank = np.full(len(rest), -1)
    rank[used] = np.arange(len(used))
    moved_eyes = tuple(
        replace(
            eye,
            centre_m=eye.centre_m + offset,
            vertices=rank[eye.vertices][rank[eye.vertices] >= 0],
        )
        for eye in eyes
    )
    return RigMesh(
        rest_m=rest[used],
        motion_m=np.ascontiguousarray(motion[:, used]),
        faces=again.reshape(-1, 3).astype(np.int32),
        uv=source.uv[corner],
        uv_faces=uv_faces,
        part=part,
        material=material,
        eyes=moved_eyes,
        frame=frame,
        dropped=tuple(dropped),
        colours=source.colours[source.faces[shown]],
    )


def _eye_point(
    rest: Float64Array, motion: FloatArray, eyes: tuple[Eyeball, ...], middle_x: float
) -> Float64Array:
    """The middle between the eyeballs, or where lids move, or a guess from the outline."""
    if len(eyes) == 2:
        return 0.5 * (eyes[0].centre_m + eyes[1].centre_m)
    lids = [ARKIT_INDEX[f"eyeBlink{side}"] for side in ("Left", "Right")]
    weight = (np.linalg.norm(motion[lids], axis=2) ** 2).sum(0)
    if weight.sum() > 0:
        middle = weight @ rest / weight.sum()
        return middle * [0, 1, 1] + [middle_x, 0.0, -0.012]
    high, low = rest.max(0), rest.min(0)
    return np.array([middle_x, high[1] - 0.11, max(high[2] - 0.05, low[2])])
