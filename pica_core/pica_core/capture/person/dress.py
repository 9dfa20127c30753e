"""Put hair and clothes on a rig's mesh: cap and beard raise its own skin, the rest is added.

What comes out is a mesh as any rig's, so that the rest of the way is that of all rigs.
"""

from dataclasses import dataclass, replace

import numpy as np

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import Person
from pica_core.capture.person.clothes import CUTS, dress_surface
from pica_core.capture.person.hair import STYLES, Surface, cover, flow, grow, raise_cap, smooth
from pica_core.capture.person.lids import close_lids, close_lips
from pica_core.capture.rig.features import Features, find_features
from pica_core.capture.rig.guards import PoseGuard
from pica_core.capture.rig.mesh import RigMesh
from pica_core.capture.rig.skin import Growth
from pica_core.capture.triangles import face_normals, nearest, unfolded, vertex_normals
from pica_core.errors import CaptureError
from pica_core.types import Array, BoolArray, Float64Array

BEARDS: dict[str, tuple[float, float, float]] = {
    "none": (0.0, 0.0, 0.0), "stubble": (0.0, 0.0, 0.0), "moustache": (1.0, 0.0, 3.0),
    "goatee": (1.0, 0.35, 4.0), "short": (1.0, 1.0, 3.0), "full": (1.0, 1.0, 9.0),
}  # fmt: skip
"""Moustache, share of the cheeks, and thickness in millimetres."""
CAVITY_Z = 0.055
"""Depth of the middle of the mouth's cavity, metres."""
FAST_M, FREE_M = 0.006, 0.020
"""Skin so near to hanging hair or clothes stays where it is at rest, and from where on it moves as
ever: neither of them moves, and skin would come through."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Dressed:
    """A mesh with hair and clothes, and what painting needs to know of them."""

    mesh: RigMesh
    growth: Growth
    notes: tuple[str, ...]
    """What did not fit and was left out, in words."""


def dress(mesh: RigMesh, person: Person) -> Dressed:
    """Dress a bare head.

    Raises:
        CaptureError: The mesh has no texture coordinates or no eyes to find the head by.
    """
    if mesh.uv is None or mesh.uv_faces is None or not mesh.eyes:
        raise CaptureError("a person needs a head with texture coordinates and eyeballs")
    features, notes = find_features(mesh), list[str]()
    mesh = close_lips(close_lids(mesh, features), features)
    PoseGuard(mesh, features, mend=True).apply(mesh.rest_m)
    skin = mesh.of_part("skin")
    rest, style = mesh.rest_m, STYLES[person.hair]
    skin_faces = mesh.faces[mesh.part == MATERIALS.index("skin")]
    normals = vertex_normals(rest.astype(np.float32), skin_faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    inside = replace(mesh, part=features.part).of_part("mouth_bag")
    if features.mouth is not None:  # what faces the mouth's cavity is its lining, too
        offset = rest - [0.0, float(np.mean(features.mouth.y)), CAVITY_Z]
        inside |= (normals * offset).sum(1) < 0.3 * np.linalg.norm(offset, axis=1)
    coverage = cover(rest, skin, features.regions["ears"], style)
    if not style.bare and np.count_nonzero(coverage > 0.5) < 50:
        notes.append(f"hair {person.hair} does not fit: no scalp was found; bald")
        style, coverage = STYLES["bald"], np.full(len(rest), -1.0)
    beard, thick = grow_beard(rest, skin, inside, features, person.beard)
    cloth = dress_surface(rest[skin], CUTS[person.clothes], person.seed)
    raised = raise_cap(rest, normals, coverage, style, person.seed)
    raised = raised + normals * (thick * smooth(1.35 * beard - 0.2))[:, None]
    raised = unfolded(rest, raised, skin_faces)
    seen = ~cloth.hides(rest)[mesh.faces].any(1) | (mesh.part != MATERIALS.index("skin"))
    body = np.concatenate([raised[np.unique(skin_faces)], cloth.surface.points])
    sheet = grow(raised, style, person.seed, body)
    hairs = np.concatenate([coverage[:, None], flow(rest, normals, style), beard[:, None]], axis=1)
    if style.curl:  # curls have no one direction to shine along
        hairs[:, 1:4] *= 0.05
    facial = beard > 0.02
    hairs[facial, 1:4] = [0.0, -0.9, 0.45]
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
        hairs = np.concatenate([hairs, np.pad(sheet.tangent, ((0, 0), (1, 1)))])
        strand = np.concatenate([strand, sheet.strand])
    return Dressed(
        mesh=mesh,
        growth=Growth(hairs=hairs.astype(np.float32), strand=strand.astype(np.float32)),
        notes=tuple(notes),
    )


def grow_beard(
    points: Float64Array,
    skin: BoolArray,
    inside: BoolArray,
    features: Features,
    style: str,
) -> tuple[Float64Array, Float64Array]:
    """How dense a beard is at each vertex ``[P]``, and its thickness in metres ``[P]``."""
    moustache, cheeks, thick = BEARDS[style]
    mouth = features.mouth
    if mouth is None or not moustache:
        return np.zeros(len(points)), np.zeros(len(points))
    mm = 1000 * points
    mouth_y, nose_y = 1000 * float(np.mean(mouth.y)), 1000 * float(features.nose_tip[1])
    half, across = 1000 * mouth.half_m, np.abs(mm[:, 0] - 1000 * mouth.centre_x)
    front = smooth((mm[:, 2] + 5) / 15)
    # The upper border climbs from the corners of the mouth to the sideburns before the ears.
    border = np.interp(across, [0, half - 5, half + 2, half + 9, 62, 75], [-12, -9, -1, 9, 26, 44])
    border = border + mouth_y
    low = np.interp(mm[:, 2], [10, 45, 95], [-30, -52, -62]) + mouth_y
    jaw = smooth((border - mm[:, 1]) / 9 + 0.5) * smooth((mm[:, 1] - low) / 10 + 0.3)
    if cheeks < 1:
        jaw = jaw * smooth((half + 4 - across) / 8) * smooth((mm[:, 2] - 60) / 15)
    under_nose = smooth((nose_y - 11 - mm[:, 1]) / 4)
    ends = 2 + 9 * smooth((across - half + 4) / 5)  # its ends hang down beside the mouth
    under_nose = under_nose * smooth((mm[:, 1] - mouth_y + ends) / 4)
    over = under_nose * smooth((half + 9 - across) / 8) * smooth((mm[:, 2] - 70) / 10)
    beard = np.maximum(jaw * (cheeks > 0), over) * front
    beard = beard * smooth((-0.02 - features.lips) / 0.30)
    beard[~skin | inside | features.regions["ears"]] = 0.0
    grown = np.flatnonzero(beard > 0)
    if features.regions["ears"].any() and len(grown):
        _, apart = nearest(points[grown], points[features.regions["ears"]])
        beard[grown] *= smooth((apart - 0.002) / 0.008)
    return beard, (thick * (1 - 0.6 * (over > jaw)) / 1000)


def _add(mesh: RigMesh, more: Surface, part: str, root: int | None) -> RigMesh:
    """A mesh with one more part, which moves with a vertex or not at all."""
    assert mesh.uv is not None
    assert mesh.uv_faces is not None
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
