"""From fitted photos to a head: their colours on the model's chart, made even and blended.

Photos differ in exposure and colour of light; each gets one gain a channel, so that where several
see the same skin they agree. Coarse colours are the mean of all that see a spot; details are of the
photo that sees it best, so that a small error of the fit blurs nothing.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, minimum_filter

from pica_core.camera import Camera
from pica_core.capture.me.face import OwnHead, head_faces, landmark_places
from pica_core.capture.me.photos import Photo, Tell, fit_landmarks
from pica_core.capture.me.scan import MeshViews, Scan
from pica_core.capture.me.scanned import (
    Unwrapped,
    iris_colour,
    linear,
    unlit,
    unwrap,
    wear,
)
from pica_core.capture.me.solve import Solution
from pica_core.capture.person.choices import FaceModel, read_model
from pica_core.capture.rig.features import hair_coverage
from pica_core.capture.triangles import vertex_normals
from pica_core.types import ByteArray, Float64Array

DETAIL_TEXELS = 6.0
"""Blur between coarse colours and details."""
HIDDEN_M = 0.003
"""What lies so far behind the nearest surface is not seen."""
GRAZING = (0.3, 0.6)
"""Cosine to the camera at which skin says nothing, and at which it says all."""
OUTLINE_TEXELS = 14
"""So near to an outline nothing is taken: what is behind it shows if the fit is a little off."""
BEST = 6
"""Power of the weights with which details are mixed: almost those of one photo."""
HAIR_AT = (-0.95, -0.2)
"""Where, on `hair_coverage`'s scale, a photo's skin ends: under hair it shows hair."""
CLOTHES_Y_M = (-0.105, -0.122)
"""Heights between which a photo's skin ends: below it shows clothes."""
BROWS, ABOVE_M, NECK_Y_M, FRINGE_EDGES = [105, 334], 0.006, -0.085, 12
"""Landmarks on the upper edges of the brows, so far above which the forehead begins; where the neck
does, and how many edges of the mesh hair or clothes on them reach."""
BROW_ENDS, CORNERS = [70, 300], [33, 263]
"""Landmarks at the outer ends of brows and eyes: beside and above them are the temples."""
LIKE_FRINGE, LIKE_SCALP = 0.25, 0.12
"""What `unlike_skin` says above which a forehead has a fringe, and below which a scalp is bald
(measured: bald ones have 0.01 to 0.03, hair of all colours on light skin at least 0.28)."""
HAIR_SHINE = 1.25
"""How much brighter hair is than its colour (measured on drawn people)."""
SHADE_KEPT, SHADE_NOISE, SHADE_MOST = 0.01, 0.15, 0.8
"""Prior of the light's terms beside what is seen; logarithm by which skin differs from a light that
counts a quarter; and the largest that is taken off."""
CAST_TWICE = 0.1
"""Logarithm by which the stage darkens skin on which shadows are that it casts again (measured on
drawn people: 0.07 to 0.12)."""
IRIS_RING = (0.45, 0.85)
"""Part of the iris between pupil and edge, of its radius."""
COMPARED, FACE, UNLIKE = 256, 170, 0.8
"""Side of the chart on which photos are compared, of the face on it, and the share of the median
correlation below which a photo is left out (measured on drawn people: another one has 0.72 to 0.79
of it, the person's own at least 0.82)."""
VAGUE = 0.35
"""Spread of the first coefficients above which little was seen."""
EYES = ((468, (469, 470, 471, 472)), (473, (474, 475, 476, 477)))
"""Landmarks: middle of each iris and its edge."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Laid:
    """A photo on the chart of the face.

    Attributes:
        weight: How well it is seen, 0 to 1. ``[S, S]``.
        colours: 0 to 255. ``[S, S, 3]``.
    """

    weight: Float64Array
    colours: Float64Array


def lay(
    views: MeshViews, flat: Unwrapped, vertices: Float64Array, normals: Float64Array,
    camera: Camera, image: ByteArray,
) -> Laid:  # fmt: skip
    """Lay a photo on the chart, for a face posed as in it."""
    views.move(vertices)
    depth_m = views.draw(camera).depth_m
    points, slope = flat.at(vertices), flat.at(normals)
    at, away = camera.project(points)
    column, row = np.clip(at, 0, [camera.width - 1, camera.height - 1]).astype(int).T
    to_camera = camera.centre_m - points
    cosine = (slope * to_camera).sum(1) / np.linalg.norm(to_camera, axis=1)
    cosine /= np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
    weight = np.clip((cosine - GRAZING[0]) / (GRAZING[1] - GRAZING[0]), 0, 1)
    weight *= (away < depth_m[row, column] + HIDDEN_M) & (depth_m[row, column] > 0)
    weight *= ((at > 2) & (at < [camera.width - 3, camera.height - 3])).all(1)
    size = flat.seen.shape
    full, colours = np.ones(size), np.zeros((*size, 3))  # where the chart ends is no outline
    full[flat.seen] = weight
    full = np.minimum(full, gaussian_filter(minimum_filter(full, OUTLINE_TEXELS), 1.0)) * flat.seen
    colours[flat.seen] = np.stack(
        [map_coordinates(image[..., k], at.T[::-1] - 0.5, np.float32, order=1) for k in range(3)], 1
    )
    return Laid(weight=full, colours=colours)


def lay_all(photos: list[Photo], found: Solution, model: FaceModel, flat: Unwrapped) -> list[Laid]:
    """Lay photos on the chart, each with its own expression."""
    mean, skin = model.mean, head_faces(model, "skin")
    count = len(mean.rest_m)
    bare = Scan(
        path=Path("model"), points=mean.rest_m, faces=mean.faces, uv=np.zeros((count, 2)),
        image=np.full((1, 1, 3), 255, np.uint8), colours=np.ones((count, 3)), has_colour=True,
        has_loose_image=False,
    )  # fmt: skip
    all_laid = []
    with MeshViews(bare) as views:
        for k, photo in enumerate(photos):
            vertices = found.shape(model, k)
            normals = vertex_normals(vertices.astype(np.float32), skin)
            all_laid.append(lay(views, flat, vertices, normals, found.cameras[k], photo.image))
    return all_laid


def blend(all_laid: list[Laid], flat: Unwrapped) -> tuple[Float64Array, Float64Array]:
    """Colours of texels 0 to 255 ``[T, 3]``, and how well they are seen ``[T]``."""
    weights = np.stack([laid.weight for laid in all_laid])
    total = np.maximum(weights.sum(0), 1e-6)
    values = np.stack([np.log(laid.colours + 8.0) for laid in all_laid])
    for _ in range(3):
        mean = np.einsum("ihw,ihwc->hwc", weights, values) / total[..., None]
        for k, weight in enumerate(weights):
            both = (weight > 0.3) & (total - weight > 0.3)
            if both.sum() > 500:
                values[k] += np.median((mean - values[k])[both], axis=0)
    seen = flat.seen.astype(np.float64)

    def blurred(plane: Float64Array) -> Float64Array:
        return np.asarray(gaussian_filter(plane, DETAIL_TEXELS))

    best = weights**BEST
    best /= np.maximum(best.sum(0), 1e-9)
    found = np.zeros((*seen.shape, 3))
    for weight, own, value in zip(weights, best, values, strict=True):
        share = blurred((weight > 0).astype(np.float64))
        for c in range(3):
            coarse = blurred(value[..., c] * (weight > 0)) / np.maximum(share, 1e-3)
            found[..., c] += weight / total * coarse + own * (value[..., c] - coarse)
    colours = np.exp(found[flat.seen]) - 8.0
    return np.clip(colours, 0, 255), np.clip(weights.max(0)[flat.seen], 0, 1)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fitted:
    """Photos with what was found in them.

    Attributes:
        off_px: Median distance of landmarks from the model's.
        is_sized: The size is known, not the usual one.
    """

    photos: list[Photo]
    solution: Solution
    off_px: float
    is_sized: bool


def fit_photos(photos: list[Photo], tell: Tell, pupils_m: float | None = None) -> Fitted:
    """Fit cameras, identity and expressions; photos that disagree with the others are left out.

    Args:
        pupils_m: How far apart the pupils are when the person looks far, if that is known.
    """
    (found, spots), model = fit_landmarks(photos, pupils_m), read_model()
    if len(photos) > 2:
        likeness = alike(lay_all(photos, found, model, unwrap(model, COMPARED)))
        keep = likeness > UNLIKE * np.median(likeness)
        for photo, kept in zip(photos, keep, strict=True):
            if not kept:
                tell(f"left out: {photo.name}: unlike the other photos; another person?")
        if not keep.all():
            photos = [photo for photo, kept in zip(photos, keep, strict=True) if kept]
            found, spots = fit_landmarks(photos, pupils_m)
    apart = [
        np.linalg.norm(camera.project(found.points(spots, k))[0] - photo.landmarks[:, :2], axis=1)
        for k, (camera, photo) in enumerate(zip(found.cameras, photos, strict=True))
    ]
    off_px = float(np.median(apart))
    tell(f"{len(photos)} photos fitted; landmarks lie {off_px:.1f} px off in the median")
    if found.spread[:20].mean() > VAGUE:
        tell("the shape is mostly an average one: more photos from other sides make it yours")
    return Fitted(photos=photos, solution=found, off_px=off_px, is_sized=pupils_m is not None)


def alike(all_laid: list[Laid]) -> Float64Array:
    """How well details of each photo's face correlate with the mean of the others'. ``[I]``."""
    fine, seen = [], []
    for laid in all_laid:
        weight = laid.weight[:FACE, :FACE]
        grey = weight * np.log(laid.colours[:FACE, :FACE].mean(2) + 8.0)
        near, far = (
            gaussian_filter(grey, s) / np.maximum(gaussian_filter(weight, s), 1e-3) for s in (1, 5)
        )
        seen.append(weight > 0.2)
        fine.append((near - far) * seen[-1])
    total, count = np.sum(fine, axis=0), np.sum(seen, axis=0)
    found = []
    for one, mine in zip(fine, seen, strict=True):
        both = mine & (count > 1)
        others = (total - one)[both] / (count - 1)[both]
        found.append(np.corrcoef(one[both], others)[0, 1] if both.sum() > 500 else 1.0)
    return np.array(found)


def unshaded(albedo: Float64Array, slopes: Float64Array, weights: Float64Array) -> Float64Array:
    """Colours ``[T, 3]`` without the light on them, which the stage adds by itself.

    It is what of their logarithm follows from the slope of skin alone, in nine terms (Ramamoorthi
    and Hanrahan 2001), alike in all channels; robustly, since lips and brows are no shade. Shadows
    that are cast stay; the mean is what shows as bright as before on the stage.

    Args:
        slopes: Normals. ``[T, 3]``.
        weights: How well each texel shows skin. ``[T]``.
    """
    x, y, z = (slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-9)).T
    terms = np.stack([x**0, x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], 1)
    some = np.flatnonzero(weights > 0.3)[::7]
    if not len(some):
        return albedo
    basis, bright = terms[some], np.log(np.maximum(albedo[some], 1e-3)).mean(1)
    share, found = weights[some], np.zeros(terms.shape[1])
    for _ in range(4):
        weighted = basis.T * share
        prior = SHADE_KEPT * share.sum() * np.diag([0.0] + [1.0] * (len(found) - 1))
        found = np.linalg.solve(weighted @ basis + prior, weighted @ bright)
        share = weights[some] / (1 + ((bright - basis @ found) / SHADE_NOISE) ** 2) ** 2
    light = terms @ found - np.average(basis @ found, weights=share)
    shade = np.exp(CAST_TWICE - np.clip(light, -SHADE_MOST, SHADE_MOST))
    return np.asarray(albedo * shade[:, None])


def unlike_skin(colours: Float64Array, skin: Float64Array) -> Float64Array:
    """How far colours ``[..., 3]`` are from skin's in hue, and how much darker, in logarithms: what
    is brighter and of skin's hue is skin in more light, as bald heads and foreheads are. ``[...]``.
    """
    apart = np.log(np.maximum(colours, 1e-3)) - np.log(skin)
    level = apart.mean(-1, keepdims=True)
    return np.asarray(np.abs(apart - level).mean(-1) + np.maximum(-level[..., 0], 0))


def head_of_photos(fitted: Fitted, chosen: dict[str, str], source: str) -> OwnHead:
    """Make the fitted head of photos.

    Args:
        chosen: Fields of `Person` that the user names.
        source: What the head was made of.
    """
    photos, found, model = fitted.photos, fitted.solution, read_model()
    flat = unwrap(model)
    all_laid = lay_all(photos, found, model, flat)
    rest_m = model.shaped(found.shape(model)).rest_m
    colours, alpha = blend(all_laid, flat)
    albedo = unlit(linear(colours))
    coverage = flat.at(hair_coverage(rest_m))
    above = np.clip((coverage - HAIR_AT[0]) / (HAIR_AT[1] - HAIR_AT[0]), 0, 1)
    height = flat.at(rest_m)[:, 1]
    alpha *= np.clip((height - CLOTHES_Y_M[1]) / (CLOTHES_Y_M[0] - CLOTHES_Y_M[1]), 0, 1)
    skin = np.median(albedo[(alpha > 0.5) & (np.abs(height + 0.02) < 0.03)], axis=0)
    albedo[alpha < 0.02] = skin
    # On forehead and temples a fringe is hair, wherever the hairline is; a collar is no skin.
    unlike = unlike_skin(albedo, skin) > LIKE_FRINGE
    places = landmark_places().at(found.coefficients)
    beside = np.abs(flat.at(rest_m)[:, 0]) > np.abs(places[BROW_ENDS, 0]).max() + ABOVE_M
    temple = beside & (height > places[CORNERS, 1].min())
    unlike &= (height > places[BROWS, 1].max() + ABOVE_M) | temple | (height < NECK_Y_M)
    reached = flat.soften(unlike.astype(np.float64), FRINGE_EDGES)
    above = np.maximum(above, np.clip(4 * reached, 0, 1))
    slopes = flat.at(vertex_normals(rest_m.astype(np.float32), head_faces(model, "skin")))
    albedo = unshaded(albedo, slopes, alpha * (1 - above) * (height > NECK_Y_M))
    worn = wear(model, rest_m, flat, albedo, alpha * (1 - above))
    scalp = (coverage > 0.3) & (coverage < 0.95) & (alpha > 0.3)
    style, hair = "short", None
    guessed: tuple[str, ...] = ("back of the head", "hair: style and volume")
    if scalp.sum() > 200:
        shown = np.median(albedo[scalp], axis=0)
        if unlike_skin(shown, worn.skin) < LIKE_SCALP:
            style = "bald"
            worn = wear(model, rest_m, flat, albedo, alpha)
        else:
            hair = np.clip(shown / HAIR_SHINE, 0.003, 0.6)
    else:
        guessed = (*guessed, "colour of the hair")
    iris = _iris(photos, found.cameras, worn.skin)
    return worn.head(found.coefficients, style, hair, iris, chosen, source, guessed)


def _iris(
    photos: list[Photo], cameras: tuple[Camera, ...], skin: Float64Array
) -> Float64Array | None:
    """Colour of the irises, of the photos that look most straight at the face."""
    frontal = np.argsort([-abs(camera.rotation[2, 2]) for camera in cameras])[:4]
    rings = []
    for photo in (photos[k] for k in frontal):
        places = photo.landmarks[:, :2].astype(np.float64)
        for middle, edge in EYES:
            radius = float(np.linalg.norm(places[list(edge)] - places[middle], axis=1).mean())
            column, row = np.round(places[middle]).astype(int)
            reach = int(np.ceil(radius))
            y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
            far = np.hypot(x, y) / max(radius, 1e-6)
            ring = (far > IRIS_RING[0]) & (far < IRIS_RING[1]) & (y > -0.3 * reach)
            rows = np.clip(row + y[ring], 0, len(photo.image) - 1)
            columns = np.clip(column + x[ring], 0, photo.image.shape[1] - 1)
            rings.append(photo.image[rows, columns])
    return iris_colour(np.concatenate(rings), skin)
