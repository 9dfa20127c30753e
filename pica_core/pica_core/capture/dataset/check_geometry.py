"""Whether a mesh, an image's mask and its depth speak of the same head in the same place."""

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import maximum_filter

from pica_core.camera import Camera
from pica_core.capture.triangles import vertex_normals
from pica_core.types import BoolArray, ByteArray, Float64Array, FloatArray, Int64Array, IntArray

DRAWN_PX = 192
"""Shorter side of the silhouette that is compared."""
LEAST_OVERLAP = 0.85
"""Intersection of silhouette and mask over their union. Captures of the stage have 0.95 (64 pixels)
to 0.98 (512 pixels) at least; two centimetres aside is 0.84 on average (measured on S1)."""
MOST_OUTSIDE = 0.02
"""Share of the vertices that face the camera, in the picture, that may lie beside the mask."""
LEAST_INSIDE = 0.03
"""Share of the vertices that a camera of the capture sees at least."""
DEPTH_TOLERANCE_M = 0.01
"""How far depth may be from the mesh (found depth has outliers, tracked meshes no teeth)."""
MOST_IN_FRONT = 0.05
"""Share of the vertices that may lie before what is seen there."""
LEAST_ON_SURFACE = 0.2
"""Share of the vertices that face the camera and have to lie on what is seen there; seen from
below, long hair hides so much that 0.29 is left."""


def silhouette_problem(
    camera: Camera, vertices_m: FloatArray, faces: IntArray, mask: ByteArray | None
) -> str | None:
    """What is wrong with where a camera in head axes sees a mesh, None if nothing.

    The mask is 0 where the background is; None where that is not known.
    """
    pixels, distance = camera.project(vertices_m)
    if (distance <= 0).mean() > 0.5:
        return "the tracked mesh lies behind the camera"
    row, _, _ = _inside(camera, pixels, distance)
    if len(row) < LEAST_INSIDE * len(vertices_m):
        return f"{len(row) / len(vertices_m):.1%} of the tracked mesh lies in the picture"
    if mask is None:
        return None
    # An open mesh covers nothing from within, such as a collar from below.
    facing = _facing(camera, vertices_m, faces) > 0
    row, column, _ = _inside(camera, pixels[facing], distance[facing])
    wide = maximum_filter(mask > 0, 2 * max(2, round(0.01 * min(mask.shape))) + 1)
    outside = float((~wide[row, column]).mean()) if len(row) else 0.0
    if outside > MOST_OUTSIDE:
        return f"{outside:.1%} of the tracked mesh in the picture lies beside the mask"
    overlap = _overlap(camera, pixels, distance, faces, mask > 0)
    if overlap < LEAST_OVERLAP:
        return f"silhouette of the tracked mesh and mask overlap by {overlap:.1%} only"
    return None


def depth_problem(
    camera: Camera, vertices_m: FloatArray, faces: IntArray, depth_m: FloatArray
) -> str | None:
    """What is wrong with depth ``[H, W]``, 0 where unknown, against a mesh, None if nothing."""
    if not (depth_m > 0).any():
        return "depth is unknown everywhere"
    pixels, distance = camera.project(vertices_m)
    facing = _facing(camera, vertices_m, faces) > 0.5
    row, column, at = _inside(camera, pixels[facing], distance[facing])
    seen = depth_m[row, column]
    known = seen > 0
    if known.sum() < 20:
        return None  # too little to say
    pixel_m = at[known] / camera.intrinsics[0, 0]
    behind = at[known] - seen[known]
    tolerance = DEPTH_TOLERANCE_M + 2 * pixel_m
    in_front = float((behind < -tolerance).mean())
    if in_front > MOST_IN_FRONT:
        return f"{in_front:.1%} of the mesh lies before the depth that is seen there"
    on_surface = float((np.abs(behind) <= tolerance).mean())
    if on_surface < LEAST_ON_SURFACE:
        return f"{on_surface:.1%} of the mesh lies on the depth that is seen there"
    return None


def _inside(
    camera: Camera, pixels: Float64Array, distance: Float64Array
) -> tuple[Int64Array, Int64Array, Float64Array]:
    """Row, column and distance of the points that are in the picture."""
    inside = (distance > 0) & (pixels >= 0).all(axis=1)
    inside &= (pixels < [camera.width, camera.height]).all(axis=1)
    column, row = np.floor(pixels[inside]).astype(np.int64).T
    return row, column, distance[inside]


def _facing(camera: Camera, vertices_m: FloatArray, faces: IntArray) -> Float64Array:
    """Cosine between each vertex's normal and its way to the camera."""
    normal = vertex_normals(vertices_m, faces)
    way = camera.centre_m - vertices_m
    return (normal * way).sum(axis=1) / np.linalg.norm(way, axis=1)


def _overlap(
    camera: Camera, pixels: Float64Array, distance: Float64Array, faces: IntArray, mask: BoolArray
) -> float:
    """Intersection over union of the mesh's silhouette and a mask, drawn small."""
    shrink = min(1.0, DRAWN_PX / min(camera.width, camera.height))
    size = (max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
    picture = Image.new("1", size)
    draw = ImageDraw.Draw(picture)
    ahead = (distance > 0)[faces].all(axis=1)
    scaled = pixels * [size[0] / camera.width, size[1] / camera.height] - 0.5
    corners = scaled[faces[ahead]]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    corners = corners[one[:, 0] * other[:, 1] < one[:, 1] * other[:, 0]]  # rows go down
    seen = (corners.max(axis=1) >= -1).all(axis=1) & (corners.min(axis=1) <= size).all(axis=1)
    for triangle in corners[seen].reshape(-1, 6).tolist():
        draw.polygon(triangle, fill=1)
    small = Image.fromarray(mask).convert("L").resize(size, Image.Resampling.BOX)
    drawn, wanted = np.asarray(picture), np.asarray(small) > 127
    either = int((drawn | wanted).sum())
    return float((drawn & wanted).sum()) / either if either else 1.0
