"""Lay the face model over a scan: where the head is, who it is, and what is its alone.

    find      the scan drawn from all sides, until the networks see a face: up, front, unit
    fit       landmarks from several views, lifted by the scan's depth: pose, size, identity
    refine    the model's skin drawn to the nearest surface of the scan, smoothly

The refinement moves vertices by d, which minimises

    sum w_i |d_i - t_i|^2  +  stiffness |L d|^2  +  little |d|^2

with t_i the step to the plane of the scan's nearest sample, L the difference to the mean of the
neighbours, and w_i 0 where the scan has a hole, a border, another slope, or is far away. So holes
are closed as the identity has them, and skin slides along the scan as freely as it is smooth.
Source: nearest points to planes, Chen and Medioni 1992; smooth deformations, Sorkine 2004.
"""

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from PIL import Image
from scipy.sparse import diags_array, eye_array
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from pica_core.camera import Camera, aimed_camera, look_at
from pica_core.capture.me.face import (
    LANDMARKS,
    Face,
    Similarity,
    fit_face,
    head_faces,
    landmark_places,
)
from pica_core.capture.me.scan import MeshViews, Scan
from pica_core.capture.person.choices import FaceModel, read_model
from pica_core.capture.triangles import (
    edges,
    mean_of_neighbours,
    samples,
    vertex_normals,
    visibility,
)
from pica_core.errors import CaptureError
from pica_core.face_networks import FaceNetworks
from pica_core.types import BoolArray, Float64Array, IntArray

UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0, "inch": 39.37}
UNIT_OFF = 0.15
"""How far a head's size may be from the mean head's for a unit to be believed."""
SIDE = 640
SURE = 0.6
FACE_M, NO_FACE_M = 0.0014, 0.0035
"""Landmarks that lie so near to a face's, in the median, are surely of one, or of none."""
FINDING = ((1.05, 0.0), (0.6, 0.25))
"""Width of what is looked at for a face, and how far above the middle, in sizes of the scan."""
VIEWS = [(a, e) for e in (-12.0, 10.0) for a in (-44.0, -22.0, 0.0, 22.0, 44.0)]
GRAZING = 0.3
"""Cosine of the surface to the camera below which a landmark's place says little."""
SPACING_M = 0.0007
"""Distance of the samples of a scan: less than its colours' texels are apart on a face."""
BORDER_M = 0.003
REFINEMENT = ((0.012, 30.0), (0.008, 10.0), (0.005, 3.0), (0.004, 1.0), (0.003, 0.4), (0.003, 0.2))
"""Rounds: how far a sample may be to count half, metres, and the stiffness."""
SCALP_REACH = 6.0
"""How many times farther samples may be above the hairline: the model is bald."""
ALIKE = 0.5
"""Cosine between slopes of model and scan, at least."""
HARDLY_SEEN = 0.02
EARS_WEIGHT = 0.15
"""Ears fold: they follow what is around them more than what is near."""
TETHER = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ScanCloud:
    """A scan in the head frame, as samples of its surface.

    Attributes:
        points: Metres. ``[N, 3]``.
        normals: ``[N, 3]``.
        colours: sRGB, 0 to 1. ``[N, 3]``.
        inside: False within `BORDER_M` of a border of the scan. ``[N]``.
        tree: Of the points.
    """

    points: Float64Array
    normals: Float64Array
    colours: Float64Array
    inside: BoolArray
    tree: KDTree


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Registered:
    """The model laid over a scan.

    Attributes:
        scan: With its image the right way up.
        face: Its fit; ``face.pose`` leads to the scan's frame.
        rest_m: Vertices of the full model at rest, with what is the scan's alone. ``[P, 3]``.
        cloud: The scan, head frame.
        seen: How well each vertex was seen, 0 to 1. ``[P]``.
        unit: ``m``, ``cm``, ``mm``, ``inch``, or empty: the size was found from the face.
        up: The axis of the file that points up.
        off_m: Distance of the skin of the face to the scan, median.
    """

    scan: Scan
    face: Face
    rest_m: Float64Array
    cloud: ScanCloud
    seen: Float64Array
    unit: str
    up: str
    off_m: float


def register(scan: Scan, networks: FaceNetworks) -> Registered:
    """Lay the model over a scan.

    Raises:
        CaptureError: There is no face, or it is not whole.
    """
    try:
        face = _look(scan, networks)
    except CaptureError:
        # Images beside a mesh may count their rows from below.
        scan = replace(scan, uv=scan.uv * [1, -1] + [0, 1])
        if not scan.has_loose_image:
            raise
        face = _look(scan, networks)
    unit = _unit(face.pose.scale)
    model = read_model()
    cloud = sample(scan, face.pose)
    start = model.mean.rest_m + np.tensordot(face.coefficients, model.modes_m, 1)
    moved, seen, off_m = refine(model, start, cloud)
    return Registered(
        scan=scan,
        face=face,
        rest_m=moved,
        cloud=cloud,
        seen=seen,
        unit=unit,
        up=_axis(face.pose.rotation @ [0, 1, 0]),
        off_m=off_m,
    )


def _look(scan: Scan, networks: FaceNetworks) -> Face:
    """The face, found and fitted, in the scan's frame."""
    with MeshViews(scan) as views:
        return _fit(scan, views, networks, _find(scan, views, networks))


def _turns() -> list[Float64Array]:
    """The 24 ways in which a scan's axes may lie."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[np.arange(3), order] = signs
            if np.linalg.det(turn) > 0:
                found.append(turn)
    return sorted(found, key=lambda turn: -np.trace(turn))  # as glTF has it comes first


def _axis(direction: Float64Array) -> str:
    k = int(np.abs(direction).argmax())
    return ("-" if direction[k] < 0 else "+") + "xyz"[k]


def _unit(scale: float) -> str:
    near = min(UNITS, key=lambda name: float(abs(np.log(scale / UNITS[name]))))
    return near if abs(scale / UNITS[near] - 1) < UNIT_OFF else ""


def _find(scan: Scan, views: MeshViews, networks: FaceNetworks) -> Similarity:
    """Where the head is, about: the view whose landmarks are most like a face's. The networks alone
    are sure of faces that are upside down, too."""
    low, high = scan.points.min(0), scan.points.max(0)
    size, middle = float((high - low).max()), (low + high) / 2
    best: tuple[float, Similarity | None] = (NO_FACE_M, None)
    for width, above in FINDING:
        for turn in _turns():
            views.move((scan.points - middle) @ turn.T / size)
            camera = look_at(
                centre_m=[0, above, 2.5], target_m=[0, above, 0],
                vertical_fov=2 * np.arctan(width / 2 / 2.5), width=SIDE, height=SIDE,
            )  # fmt: skip
            places, weights, sure = _landmarks(views, camera, networks)
            if sure <= SURE or (weights > 0).sum() < LANDMARKS // 2:
                continue
            face = fit_face(landmark_places(), places, weights)
            off_m = float(np.median(face.residual_m[weights > 0]))
            if off_m > best[0]:
                continue
            pose = Similarity(
                scale=face.pose.scale * size,
                rotation=turn.T @ face.pose.rotation,
                translation=size * face.pose.translation @ turn + middle,
            )
            best = off_m, pose
            if off_m < FACE_M and face.pose.rotation[1, 1] > 0.8:
                return pose
        if best[1] is not None:
            return best[1]
    raise CaptureError(
        f"{scan.path}: no face is found from any side; scan a head with its whole face, and with "
        "its texture"
    )


def _landmarks(
    views: MeshViews, camera: Camera, networks: FaceNetworks
) -> tuple[Float64Array, Float64Array, float]:
    """Landmarks in a view, lifted by its depth ``[478, 3]``, how much each says ``[478]``, and how
    sure it is that there is a face."""
    view = views.draw(camera)
    picture = Image.fromarray(view.image)
    nothing = np.zeros((LANDMARKS, 3)), np.zeros(LANDMARKS), 0.0
    for region in networks.detect(picture)[:1]:
        landmarks, sure = networks.landmarks(picture, region)
        column, row = landmarks[:, :2].astype(int).T
        inside = (row > 1) & (row < camera.height - 2) & (column > 1) & (column < camera.width - 2)
        row, column = np.clip(row, 2, camera.height - 3), np.clip(column, 2, camera.width - 3)
        around = np.stack(
            [view.depth_m[row + i, column + j] for i, j in product((-2, 0, 2), (-2, 0, 2))]
        )
        depth = np.median(around, axis=0)
        places = camera.lift(landmarks[:, :2], depth)
        # Across an outline depth leaps, and a landmark may lie on either side.
        pixel = depth / camera.intrinsics[0, 0]
        level = np.ptp(around, axis=0) < 4 * pixel / GRAZING
        return places, (inside & (around > 0).all(0) & level).astype(np.float64), sure
    return nothing


def _fit(scan: Scan, views: MeshViews, networks: FaceNetworks, rough: Similarity) -> Face:
    """The face in the scan's frame, from several views."""
    places, pose = landmark_places(), rough
    face: Face | None = None
    for _ in range(2):
        views.move(pose.undo(scan.points))
        rows = []
        for azimuth, elevation in VIEWS:
            camera = aimed_camera("", azimuth, elevation, "head", width=SIDE, height=SIDE)
            found, weights, sure = _landmarks(views, camera, networks)
            if sure > SURE:
                rows.append(np.where(weights[:, None] > 0, found, np.nan))
        if len(rows) < 3:
            raise CaptureError(
                f"{scan.path}: the face is seen from {len(rows)} of {len(VIEWS)} sides; scan all "
                "of it, from ear to ear"
            )
        table = np.stack(rows)
        count = (~np.isnan(table[..., 0])).sum(0)
        middle = np.nanmedian(np.where(count[:, None] > 0, table, 0.0), axis=0)
        apart = np.nanmedian(
            np.where(count > 0, np.linalg.norm(table - middle, axis=2), 1.0), axis=0
        )
        weights = (count >= 2) / (1 + (apart / 0.002) ** 2)
        measured = pose.apply(middle)
        face = fit_face(places, measured, weights)
        # Size and the modes of size cannot both be found: of an unknown unit, a head is average.
        average = face.pose.scale * _size(places.at(face.coefficients))
        average /= _size(places.mean_m)
        scale = UNITS.get(_unit(average), average)
        face = fit_face(places, measured, weights, scale=scale)
        pose = face.pose
    assert face is not None
    if np.median(face.residual_m[weights > 0]) > NO_FACE_M:
        raise CaptureError(
            f"{scan.path}: what looks like a face is none by its shape; scan a whole head, upright"
        )
    return face


def _size(places: Float64Array) -> float:
    """How far places are spread, metres."""
    return float(np.sqrt(((places - places.mean(0)) ** 2).sum(1).mean()))


def sample(scan: Scan, pose: Similarity) -> ScanCloud:
    """Samples of a scan's surface around the head."""
    points = pose.undo(scan.points)
    centre = points[scan.faces].mean(1)
    near = (np.abs(centre - [0, -0.03, -0.01]) < [0.18, 0.22, 0.20]).all(1)
    faces = scan.faces[near]
    which, weights = samples(points, faces, SPACING_M)
    corners = faces[which]
    at = np.einsum("nk,nkc->nc", weights, points[corners])
    normals = vertex_normals(points.astype(np.float32), faces)
    slope = np.einsum("nk,nkc->nc", weights, normals[corners])
    uv = np.einsum("nk,nkc->nc", weights, scan.uv[corners])
    tint = np.einsum("nk,nkc->nc", weights, scan.colours[corners])
    height, width = scan.image.shape[:2]
    column, row = np.floor(np.mod(uv, 1.0) * [width, height]).astype(int).T
    image = scan.image[np.minimum(row, height - 1), np.minimum(column, width - 1)] / 255
    border = np.unique(points[_border(points, faces)], axis=0)
    inside = np.ones(len(at), np.bool_)
    if len(border):
        inside = KDTree(border).query(at, distance_upper_bound=BORDER_M)[0] > BORDER_M
    return ScanCloud(
        points=at,
        normals=slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9),
        colours=image * tint,
        inside=inside,
        tree=KDTree(at),
    )


def _border(points: Float64Array, faces: IntArray) -> IntArray:
    """Vertices of edges that one triangle alone has; places count, not numbers."""
    _, same = np.unique(np.round(points, 6), axis=0, return_inverse=True)
    sides = np.sort(same.reshape(-1)[edges(faces)], axis=1)
    _, index, count = np.unique(sides, axis=0, return_index=True, return_counts=True)
    return edges(faces)[index[count == 1]].ravel()


def refine(
    model: FaceModel, start: Float64Array, cloud: ScanCloud
) -> tuple[Float64Array, Float64Array, float]:
    """Draw the model's skin ``[P, 3]`` to a scan.

    Returns:
        The vertices ``[P, 3]``, how well each was seen ``[P]``, and the median distance of the
        face's skin to the scan.
    """
    mean = model.mean
    skin_faces = head_faces(model, "skin")
    skin, local = np.unique(skin_faces, return_inverse=True)
    faces = local.reshape(-1, 3).astype(np.int32)
    before = start[skin]
    outer = np.zeros(len(skin), np.bool_)
    outer[faces[visibility([start], skin_faces) > HARDLY_SEEN]] = True
    trust = outer * np.where(np.isin(skin, mean.marks["ears"]), EARS_WEIGHT, 1.0)
    height = before[:, 1] + 0.6 * np.minimum(before[:, 2], 0.05)
    scalp = np.clip((height - 0.075) / 0.03, 0, 1)
    smooth = eye_array(len(skin)) - mean_of_neighbours(faces, len(skin))
    stiff = (smooth.T @ smooth).tocsc()
    step, weight = np.zeros_like(before), np.zeros(len(skin))
    for reach, stiffness in REFINEMENT:
        here = before + step
        normals = vertex_normals(here.astype(np.float32), faces)
        reaches = reach * (1 + (SCALP_REACH - 1) * scalp)
        apart, near = cloud.tree.query(here)
        slope = cloud.normals[near]
        alike = (normals * slope).sum(1)
        weight = trust * cloud.inside[near] * np.clip((alike - ALIKE) / 0.3, 0, 1)
        weight = weight / (1 + (apart / reaches) ** 2) ** 2
        toward = slope * ((cloud.points[near] - here) * slope).sum(1, keepdims=True)
        system = diags_array(weight + TETHER) + stiffness * stiff
        step = splu(system.tocsc()).solve(weight[:, None] * (step + toward))
    moved = start.copy()
    moved[skin] = before + step
    _move_inner(model, start, moved)
    seen = np.zeros(len(start))
    seen[skin] = np.clip(2 * weight / np.maximum(trust, 1e-9), 0, 1) * outer
    face = np.isin(skin, np.flatnonzero(np.abs(mean.motion_m).max((0, 2)) > 0.001)) & outer
    apart, near = cloud.tree.query(moved[skin])
    level = np.abs(((cloud.points[near] - moved[skin]) * cloud.normals[near]).sum(1))
    return moved, seen, float(np.median(level[face & (apart < 0.01)]))


def _move_inner(model: FaceModel, start: Float64Array, moved: Float64Array) -> None:
    """Take eyes along with their lids, teeth and tongue with the lips around them, in place."""
    mean = model.mean
    skin = np.unique(head_faces(model, "skin"))
    step = moved - start
    for eye in mean.eyes:
        centre, radius = start[eye.vertices].mean(0), np.ptp(start[eye.vertices], axis=0).max() / 2
        offset = start[skin] - centre
        lids = skin[(np.linalg.norm(offset, axis=1) < 1.4 * radius) & (offset[:, 2] > 0)]
        moved[eye.vertices] += np.median(step[lids], axis=0)
    inner = np.unique(head_faces(model, "teeth", "tongue"))
    front = start[inner][:, 2].max()
    middle = start[inner][:, 1].mean()
    offset = start[skin] - [0.0, middle, front]
    lips = skin[(np.abs(offset) < [0.025, 0.014, 0.02]).all(1)]
    moved[inner] += np.median(step[lips], axis=0)
