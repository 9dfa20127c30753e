"""A person on the stage: a rig of the face model, dressed and painted by what was chosen.

Hair on the head raises the rig's own skin, and clothes and hanging hair are added. What comes out
is a mesh as any rig's, so that the rest of the way is that of all rigs.
"""

import functools
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import (
    CLOTH_COLOURS,
    EYE_COLOURS,
    HAIR_COLOURS,
    RIGHTS,
    SKIN_TONES,
    Person,
    read_model,
)
from pica_core.capture.person.hair import (
    LOOKS,
    STYLES,
    Surface,
    cover,
    flow,
    grow,
    join_rings,
    lumps,
    raise_cap,
    smooth,
)
from pica_core.capture.rig.features import LID_M, Features, find_features
from pica_core.capture.rig.head import EyeSurface, PoseGuard, RigHead, outwards
from pica_core.capture.rig.mesh import RigMesh
from pica_core.capture.rig.names import map_names
from pica_core.capture.stage.paint import Growth
from pica_core.capture.stage.subject import Subject
from pica_core.capture.triangles import face_normals, nearest, unfolded, vertex_normals
from pica_core.types import Array, BoolArray, Float64Array, FloatArray, Int64Array

COLUMNS, ROWS = 72, 22
AXIS_Z = -0.028
"""Depth of the neck's axis."""
HIDDEN_M = 0.014
"""How far below the neckline skin ends."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cut:
    """A neckline; lengths are millimetres."""

    front: float
    """Height of the neckline in front, in the head frame."""
    back: float
    vee: float = 0.0
    """How much deeper a point in front goes."""
    band: float = 2.0
    """How far the fabric stands up above the neckline."""
    roll: float = 1.5
    """Thickness of its edge."""
    turned: float = 0.0
    """Length of a collar that is turned down over it."""
    folds: float = 1.0


CUTS = {name: Cut(**numbers) for name, numbers in LOOKS["cuts"].items()}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Garment:
    """A garment.

    Attributes:
        rim_y: Height of the neckline by turn. ``[COLUMNS]``.
        rim: Its distance from the neck's axis. ``[COLUMNS]``.
    """

    surface: Surface
    rim_y: Float64Array
    rim: Float64Array

    def hides(self, points: Float64Array) -> BoolArray:
        """Which points of a skin lie under it. ``[P]``."""
        place = np.arctan2(points[:, 0], -(points[:, 2] - AXIS_Z)) / (2 * np.pi) * COLUMNS
        columns = np.arange(COLUMNS)
        rim_y = np.interp(place, columns, self.rim_y, period=COLUMNS)
        rim = np.interp(place, columns, self.rim, period=COLUMNS)
        reach = np.hypot(points[:, 0], points[:, 2] - AXIS_Z)
        beside = (reach > rim + 0.003) & (points[:, 1] < rim_y - 0.002)
        return (points[:, 1] < rim_y - HIDDEN_M) | beside


def dress_surface(skin: Float64Array, cut: Cut, seed: int) -> Garment:
    """A garment on a neck, for skin ``[P, 3]``."""
    turn = 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    front, side = -np.cos(turn), np.sin(turn)
    share = smooth(front + 0.25)
    rim_y = (cut.back + (cut.front - cut.back) * share) / 1000
    rim_y = rim_y - cut.vee / 1000 * np.clip(1 - np.abs(side) / 0.55, 0, 1) * (front > 0)
    rim = _reach(skin, turn, rim_y)
    rows: list[Float64Array] = []

    def ring(out: Float64Array | float, y: Float64Array | float) -> None:
        reach = rim + out
        rows.append(np.stack([side * reach, rim_y + y, AXIS_Z + front * reach], 1))

    band, roll = cut.band / 1000, cut.roll / 1000
    ring(-0.006, -0.008)
    ring(0.0008, band - roll)
    ring(0.4 * roll + 0.001, band)
    ring(roll + 0.0015, band - 0.5 * roll)
    if cut.turned:
        drop = cut.turned / 1000 * (0.75 + 0.25 * share)
        for k in (0.35, 0.7, 1.0):
            ring(roll + 0.002 + 0.35 * drop * k, band - 0.5 * roll - drop * k * 0.9)
        ring(roll + 0.0005 + 0.24 * drop, band - 0.5 * roll - drop * 0.93)
        ring(0.0035 + 0.10 * drop, np.minimum(band - drop * 0.6, -0.001))
    else:
        ring(roll + 0.001, -0.004)
    at_reach, at_y = rim + roll + 0.0035, rim_y + np.minimum(-0.008, band - cut.turned / 1000)
    edge = 1 / ((np.abs(side) / 0.178) ** 2.6 + (np.abs(front) / 0.100) ** 2.6) ** (1 / 2.6)
    chest = np.maximum(front, 0.0) ** 1.5
    rest = ROWS - len(rows)
    crease = np.random.default_rng([seed, 0xF01D]).uniform(0, 2 * np.pi, 4)
    for k in range(1, rest + 1):
        s = k / rest
        slope, drop_down = np.clip(s / 0.62, 0, 1), np.clip((s - 0.62) / 0.38, 0, 1)
        reach = at_reach + (edge - at_reach) * slope + 0.008 * np.sin(0.5 * np.pi * drop_down)
        fall = (0.034 + 0.020 * chest) * slope + (0.030 - 0.006 * chest) * slope**3
        y = at_y - fall - 0.13 * drop_down**1.3
        point = np.stack([side * reach, y, AXIS_Z + front * reach], 1)
        # Folds run down from the neck and across from arm to arm.
        wave = np.sin(5 * turn + crease[0] + 2.5 * slope) * 0.6 + np.sin(9 * turn + crease[1])
        sag = lumps(point, 0.05, seed + 3) + 0.5 * wave * smooth(drop_down * 2)
        out = np.stack([0.4 * side, 0.8 + 0 * side, 0.5 * front], 1)
        rows.append(point + 0.0016 * cut.folds * min(4 * s, 1.0) * sag[:, None] * out)
    surface = join_rings(np.stack(rows), np.linspace(0, 0.7, COLUMNS + 1))
    return Garment(surface=surface, rim_y=rim_y, rim=rim)


def _reach(skin: Float64Array, turn: Float64Array, rim_y: Float64Array) -> Float64Array:
    """How far skin lies from the neck's axis at the neckline, smoothed round the neck."""
    around = np.arctan2(skin[:, 0], -(skin[:, 2] - AXIS_Z)) % (2 * np.pi)
    reach = np.hypot(skin[:, 0], skin[:, 2] - AXIS_Z)
    found = np.full(COLUMNS, np.nan)
    for k, (angle, y) in enumerate(zip(turn, rim_y, strict=True)):
        off = np.abs((around - angle + np.pi) % (2 * np.pi) - np.pi)
        here = (off < 0.16) & (np.abs(skin[:, 1] - y) < 0.010)
        if here.any():
            found[k] = reach[here].max()
    known = np.flatnonzero(~np.isnan(found))
    full = np.full(COLUMNS, 0.06)
    if len(known):
        full = np.interp(np.arange(COLUMNS), known, found[known], period=COLUMNS)
    for _ in range(3):
        full = np.maximum(full, 0.25 * np.roll(full, 1) + 0.5 * full + 0.25 * np.roll(full, -1))
    return full


OVERLAP_M = 0.0004
"""How far lids of a closed eye go past each other: their picture meets."""
ROOM_M, LINING_M = 0.0003, 0.004
"""Least distance of a lid from the eyeball at rest, which `LidGuard` keeps in every pose; and how
deep in it nothing is moved."""
LIP_REACH_M, LIP_DEEP_M, LIP_GAP_M = 0.006, 0.008, 0.006
"""How far from the line of contact skin goes along with a lip; how deep behind it lips may touch;
what opening is closed at most."""


def close_lids(mesh: RigMesh, features: Features) -> RigMesh:
    """A mesh whose lids lie on its eyeballs at rest and meet in a blink."""
    rest, motion = mesh.rest_m.copy(), mesh.motion_m.copy()
    skin = np.flatnonzero(mesh.of_part("skin"))
    for eye in mesh.eyes:
        offset = rest[skin] - eye.centre_m
        far = np.linalg.norm(offset, axis=1)
        near = skin[(far < 1.9 * eye.radius_m) & (offset[:, 2] > 0)]
        offset = rest[near] - eye.centre_m
        clear = EyeSurface(rest[eye.vertices] - eye.centre_m).clearance(offset)
        # What lies deep inside is the lid's own lining, which no camera sees.
        lack = np.where(clear > -LINING_M, np.maximum(ROOM_M - clear, 0.0), 0.0)
        rest[near] += outwards(offset, lack)
        blink = motion[ARKIT_INDEX["eyeBlinkLeft" if eye.side > 0 else "eyeBlinkRight"]]
        blink[near] *= _farther(rest, blink, near, features)[:, None]
    return replace(mesh, rest_m=rest, motion_m=motion)


def _farther(
    rest: Float64Array, blink: FloatArray, near: Int64Array, features: Features
) -> Float64Array:
    """How much farther each vertex goes in a blink for the lids to meet, as a factor. ``[n]``."""
    edge = features.eye_gap_m[near] < LID_M
    above = features.above_eye[near]
    upper, lower = near[edge & above], near[edge & ~above]
    if min(len(upper), len(lower)) < 4:
        return np.ones(len(near))
    low_closed = rest[lower] + blink[lower]
    order = np.argsort(low_closed[:, 0])
    closed = rest[upper] + blink[upper]
    line = np.interp(closed[:, 0], low_closed[order, 0], low_closed[order, 1])
    fall = np.maximum(-blink[upper, 1].astype(np.float64), 0.002)
    lack = np.clip((closed[:, 1] - line + OVERLAP_M) / fall, 0.0, 0.6)
    # A smooth function of the place across the eye; the corners stay.
    x = rest[near, 0]
    weight = np.exp(-0.5 * ((x[:, None] - rest[upper, 0]) / 0.0025) ** 2)
    weight *= np.minimum(fall / 0.004, 1.0) ** 2
    factor: Float64Array = (weight @ lack) / np.maximum(weight.sum(1), 1e-9)
    return 1.0 + np.where(above, factor, 0.0)


def close_lips(mesh: RigMesh, features: Features) -> RigMesh:
    """A mesh whose lips touch at rest: each lip goes half of the way."""
    mouth = features.mouth
    if mouth is None:
        return mesh
    rest = mesh.rest_m.copy()
    rise = rest[:, 1] - np.interp(rest[:, 0], mouth.x, mouth.y)
    behind = np.interp(rest[:, 0], mouth.x, mouth.z) - rest[:, 2]
    near = np.flatnonzero(
        (np.abs(rise) < 3 * LIP_REACH_M)
        & (np.abs(rest[:, 0] - mouth.centre_x) < mouth.half_m)
        & (np.abs(behind) < 0.025)
        & (mesh.of_part("skin") | replace(mesh, part=features.part).of_part("mouth_bag"))
    )
    edge = near[np.abs(behind[near]) < LIP_DEEP_M]
    places = np.linspace(-0.9, 0.9, 15) * mouth.half_m + mouth.centre_x
    lack = np.zeros(len(places))
    for k, x in enumerate(places):
        here = edge[np.abs(rest[edge, 0] - x) < 0.002]
        upper, lower = rise[here[rise[here] >= 0]], rise[here[rise[here] < 0]]
        if len(upper) and len(lower):
            lack[k] = max(upper.min() - lower.max() + OVERLAP_M, 0.0)
    lack = np.minimum(np.convolve(np.pad(lack, 1), [0.25, 0.5, 0.25], "valid"), LIP_GAP_M)
    gap = np.interp(rest[near, 0], places, lack)
    away = np.maximum(np.abs(rise[near]) - 0.5 * gap, 0.0) / LIP_REACH_M
    rest[near, 1] -= 0.5 * gap * np.sign(rise[near]) * np.exp(-(away**2))
    return replace(mesh, rest_m=rest)


FAST_M, FREE_M = 0.006, 0.020
"""Skin so near to hanging hair or clothes stays where it is at rest, and from where on it moves as
ever: neither of them moves, and skin would come through."""


def dress(mesh: RigMesh, person: Person) -> tuple[RigMesh, Growth]:
    """A bare head of the face model with hair and clothes, and what painting needs to know."""
    features = find_features(mesh)
    mesh = close_lips(close_lids(mesh, features), features)
    PoseGuard(mesh, features, mend=True).apply(mesh.rest_m)
    skin = mesh.of_part("skin")
    rest, style = mesh.rest_m, STYLES[person.hair]
    skin_faces = mesh.faces[mesh.part == MATERIALS.index("skin")]
    normals = vertex_normals(rest.astype(np.float32), skin_faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    coverage = cover(rest, skin, features.regions["ears"], style)
    cloth = dress_surface(rest[skin], CUTS[person.clothes], person.seed)
    raised = unfolded(rest, raise_cap(rest, normals, coverage, style, person.seed), skin_faces)
    seen = ~cloth.hides(rest)[mesh.faces].any(1) | (mesh.part != MATERIALS.index("skin"))
    body = np.concatenate([raised[np.unique(skin_faces)], cloth.surface.points])
    sheet = grow(raised, style, person.seed, body)
    hairs = np.concatenate([coverage[:, None], flow(rest, normals, style)], axis=1)
    if style.curl:  # curls have no one direction to shine along
        hairs[:, 1:4] *= 0.05
    added = [cloth.surface] if sheet is None else [cloth.surface, sheet.surface]
    _, apart = nearest(raised, np.concatenate([each.points for each in added]))
    free = np.where(skin, smooth((apart - FAST_M) / (FREE_M - FAST_M)), 1.0)
    motion = mesh.motion_m * free.astype(np.float32)[:, None]
    kept = {name: getattr(mesh, name)[seen] for name in ("faces", "uv_faces", "part", "material")}
    mesh = replace(mesh, rest_m=raised, motion_m=motion, **kept)
    mesh = _add(mesh, cloth.surface, "collar", None)
    hairs = np.pad(hairs, ((0, len(cloth.surface.points)), (0, 0)))
    strand = np.zeros((len(hairs), 4))
    if sheet is not None:
        mesh = _add(mesh, sheet.surface, "hair", sheet.root)
        hairs = np.concatenate([hairs, np.pad(sheet.tangent, ((0, 0), (1, 0)))])
        strand = np.concatenate([strand, sheet.strand])
    growth = Growth(hairs=hairs.astype(np.float32), strand=strand.astype(np.float32))
    return mesh, growth


def _add(mesh: RigMesh, more: Surface, part: str, root: int | None) -> RigMesh:
    """A mesh with one more part, which moves with a vertex or not at all."""
    points, faces, uv, uv_faces = more.points, more.faces, more.uv, more.uv_faces
    # Rings of a sheet enclose a volume; those of a garment are open, and face away from the neck.
    if (face_normals(points, faces) * (points[faces[:, 0]] - points.mean(0))).sum() < 0:
        faces, uv_faces = faces[:, ::-1], uv_faces[:, ::-1]
    motion = np.zeros((len(mesh.motion_m), len(points), 3), np.float32)
    if root is not None:
        motion += mesh.motion_m[:, [root]]

    def joined(one: Array, other: Array) -> Array:
        return np.concatenate([one, other.astype(one.dtype)])

    return replace(
        mesh,
        rest_m=joined(mesh.rest_m, points),
        motion_m=np.concatenate([mesh.motion_m, motion], axis=1),
        faces=joined(mesh.faces, faces + len(mesh.rest_m)),
        uv=joined(mesh.uv, uv),
        uv_faces=joined(mesh.uv_faces, uv_faces + len(mesh.uv)),
        part=joined(mesh.part, np.full(len(faces), MATERIALS.index(part))),
        material=joined(mesh.material, np.full(len(faces), -1)),
    )


GREY = np.array((0.28, 0.27, 0.26))


def paint(person: Person) -> dict[str, Any]:
    """A person's colours and marks, as `appearance.frag` names them."""
    tone = np.stack(
        [np.interp(person.skin, np.arange(1, 7), np.array(SKIN_TONES)[:, k]) for k in range(3)]
    )
    light = float(np.interp(person.skin, [1, 6], [1.0, 0.25]))
    lips = tone * (0.80, 0.52, 0.55) + np.array((0.045, 0.0, 0.006)) * light
    hair = np.array(HAIR_COLOURS[person.hair_colour])
    faded = hair + (GREY - hair) * 0.75 * person.grey
    return {
        "seed": float(person.seed % 997) + 0.5,
        "skin_rgb": tuple(tone), "lip_rgb": tuple(lips), "hair_rgb": tuple(hair),
        "brow_rgb": tuple(np.minimum(0.8 * faded, 0.12)), "brows": person.brows,
        "iris_rgb": EYE_COLOURS[person.eyes], "redness": person.redness,
        "age": float(np.clip((person.age - 20) / 55, 0, 1.1)), "freckles": person.freckles,
        "moles": person.moles, "makeup": person.makeup, "grey": person.grey,
        "stubble": 0.85 if person.beard == "stubble" else 0.1 * (person.sex == "male"),
        "cloth_rgb": CLOTH_COLOURS[person.clothes_colour],
        "cloth_knit": {"turtleneck": 1.0, "hoodie": 0.6}.get(person.clothes, 0.25),
        "tooth_white": person.teeth,
    }  # fmt: skip


class PersonSubject(Subject):
    """A person on the stage, whose further options are those of `Subject`."""

    def __init__(self, person: Person, *, coarse: bool = False, **options: Any) -> None:
        head, growth = make_head(person, coarse=coarse)
        super().__init__(
            head,
            {
                "source": "synthetic: a person of ICT-FaceKit Light's modes, not a real one",
                "licence": RIGHTS,
                "person": asdict(person),
            },
            look=paint(person),
            growth=growth,
            **options,
        )


@functools.lru_cache(maxsize=8)
def make_head(person: Person, *, coarse: bool = False) -> tuple[RigHead, Growth]:
    """The posable head of a person, seconds of work, and its hair; calls share them."""
    mesh = read_model(coarse=coarse).mesh(person.coefficients)
    dressed, growth = dress(mesh, person)
    moved = np.abs(mesh.motion_m).max((1, 2)) > 0
    names = map_names([name for name, moves in zip(ARKIT_NAMES, moved, strict=True) if moves])
    return RigHead(dressed, names, f"{person.sex}, {person.age}"), growth
