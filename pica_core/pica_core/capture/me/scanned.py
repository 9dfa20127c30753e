"""From a scan to a fitted head: its colours on the model's chart, its hair, and what it lacks.

Each texel of the model's skin takes the colour of the scan's nearest samples, as opaque as those
are near, level and no border. Under it lies painted skin of the scan's own tone, which shows where
the scan has holes, at the lids' edges (a scan's lids are glued to its eyes) and inside the mouth.

Hair: the model's scalp was drawn out to the scan's surface, hair or skin, and wears its colours;
where the scan has no crown, a style is proposed.
"""

from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from scipy.ndimage import distance_transform_edt

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.me.face import (
    TEXTURE_SIZE,
    OwnHead,
    chart_uv,
    landmark_places,
    landmark_values,
)
from pica_core.capture.me.register import Registered
from pica_core.capture.person.choices import (
    CLIP,
    EYE_COLOURS,
    HAIR_COLOURS,
    NUM_MODES,
    SKIN_TONES,
    FaceModel,
    Person,
    read_model,
)
from pica_core.capture.rig.features import find_features, hair_coverage
from pica_core.gl import create_context, link_program
from pica_core.types import BoolArray, ByteArray, Float64Array, FloatArray, Int64Array

FLAT = """#version 330
in vec2 uv;
in vec3 marks;
out vec3 mark;
void main() { mark = marks; gl_Position = vec4(uv * 2.0 - 1.0, 0.0, 1.0); }
"""
MARK = """#version 330
in vec3 mark;
out vec3 mark_out;
void main() { mark_out = mark; }
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Unwrapped:
    """The model's skin laid flat.

    Attributes:
        seen: Which texels of a head's texture are skin. ``[S, S]``.
        faces: Corners of the triangle of each of these. ``[T, 3]``.
        weights: Where in it each lies. ``[T, 3]``.
    """

    seen: BoolArray
    faces: Int64Array
    weights: Float64Array

    def at(self, values: FloatArray | Float64Array) -> Float64Array:
        """Values of vertices ``[P, ...]`` at the texels. ``[T, ...]``."""
        return np.einsum("tk,tk...->t...", self.weights, values[self.faces])

    def soften(self, values: Float64Array, rounds: int) -> Float64Array:
        """Mix values of texels ``[T]`` with those around them, one edge of the mesh farther each
        round, also across the seams of the chart."""
        corners = self.faces.ravel()
        weights = self.weights.ravel().clip(1e-6)  # GL leaves some a little below 0
        share = np.maximum(np.bincount(corners, weights), 1e-6)
        for _ in range(rounds):
            values = self.at(np.bincount(corners, weights * np.repeat(values, 3)) / share)
        return values


def unwrap(model: FaceModel, size: int | None = None) -> Unwrapped:
    """Find the triangle of each texel of the model's skin, on a texture so wide."""
    size = size or TEXTURE_SIZE
    skin = model.mean.part == MATERIALS.index("skin")
    uv = chart_uv(model)[model.mean.uv_faces[skin]].reshape(-1, 2)
    count = len(uv) // 3
    ends = np.tile([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], (count, 1))
    data = np.concatenate([uv, np.repeat(np.arange(count) + 1.0, 3)[:, None], ends], 1)
    context: Any = create_context()
    try:
        program = link_program(context, vertex=FLAT, fragment=MARK)
        corners = context.buffer(data.astype("f4").tobytes())
        mesh = context.vertex_array(program, [(corners, "2f 3f", "uv", "marks")])
        target = context.framebuffer([context.texture((size, size), 3, dtype="f4")])
        target.use()
        target.clear()
        context.enable_only(moderngl.NOTHING)
        mesh.render()
        marks = np.frombuffer(target.read(components=3, dtype="f4"), np.float32)
    finally:
        context.gc()
        context.release()
    marks = marks.reshape(size, size, 3)
    seen = marks[..., 0] > 0.5
    number, a, b = marks[seen].astype(np.float64).T
    faces = model.mean.faces[skin][np.rint(number).astype(np.int64) - 1]
    return Unwrapped(
        seen=seen, faces=faces.astype(np.int64), weights=np.stack([a, b, 1 - a - b], 1)
    )


STAGE_LIGHT = np.array([1.62, 1.55, 1.49])
"""Mean light of the stage on a face (measured on drawn people)."""


def linear(srgb: Float64Array | ByteArray) -> Float64Array:
    """Linear colours of sRGB ones, 0 to 255."""
    value = np.asarray(srgb, np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def unlit(colour: Float64Array) -> Float64Array:
    """What the stage must be given to show a linear colour: its tone curve backwards."""
    y = np.minimum(colour, 0.98)
    # y = x (1 + 0.16 x) / (1 + 0.42 x)
    half = 0.5 * (1 - 0.42 * y) / 0.16
    x = -half + np.sqrt(half**2 + y / 0.16)
    return np.asarray(x / 0.92 / STAGE_LIGHT)


BROW_EDGES = (
    ((70, 63, 105, 66, 107), (46, 53, 52, 65, 55)),
    ((336, 296, 334, 293, 300), (285, 295, 282, 283, 276)),
)
"""Landmarks along upper and lower edge of each brow, from the subject's right to the left."""
BROW_HAIRS, BETWEEN_HAIRS = 0.9, 0.06
"""Share of a brow that is more like skin than its hairs, so that thin, fair and grey ones are seen;
and that of skin in these (measured on drawn people)."""


def skin_colours(
    albedo: Float64Array, face: BoolArray, places: Float64Array, lips: Float64Array,
    landmarks: Float64Array,
) -> tuple[dict[str, tuple[float, ...]], float]:  # fmt: skip
    """Colours of skin, lips and brows by their names in `PAINT`, and the nearest tone, 1 to 6.

    Args:
        albedo: Of texels, linear. ``[T, 3]``.
        face: Those of the inner face that are seen. ``[T]``.
        places: Where they lie, head frame. ``[T, 3]``.
        lips: How deep in the lips, see `Features.lips`. ``[T]``.
        landmarks: Of the face networks. ``[478, 3]``.
    """
    y = places[:, 1]
    cheek = face & (lips < -0.8) & (y < 0.005) & (y > -0.06)
    rest = cheek if cheek.sum() > 100 else face
    skin = np.median(albedo[rest], axis=0) if rest.any() else np.array(SKIN_TONES[1])
    look = {"skin_rgb": _as_colour(skin)}
    if (mouth := face & (lips > 0.3)).sum() > 50:
        look["lip_rgb"] = _as_colour(np.median(albedo[mouth], axis=0))
    if (brow := face & _within_brows(places, landmarks)).sum() > 50:
        apart = np.abs(np.log(np.maximum(albedo[brow], 1e-3)) - np.log(skin)).mean(1)
        hairs = albedo[brow][apart >= np.quantile(apart, BROW_HAIRS)]
        found = np.median(hairs, axis=0) - BETWEEN_HAIRS * skin
        look["brow_rgb"] = _as_colour(found / (1 - BETWEEN_HAIRS))
    steps = np.linspace(1, 6, 51)
    tones = [np.interp(steps, np.arange(1, 7), np.array(SKIN_TONES)[:, k]) for k in range(3)]
    apart = np.linalg.norm(np.log(np.stack(tones, 1)) - np.log(np.maximum(skin, 1e-3)), axis=1)
    return look, float(steps[apart.argmin()])


def _within_brows(places: Float64Array, landmarks: Float64Array) -> BoolArray:
    """Which places are in the inner half of a brow. ``[T]``."""
    found = np.zeros(len(places), bool)
    for edges in BROW_EDGES:
        upper, lower = landmarks[np.array(edges)]
        across, height, _ = 0.5 * (upper + lower).T
        half = 0.25 * np.linalg.norm(upper - lower, axis=1)
        line, reach = (
            np.interp(places[:, 0], across, values, left=np.nan, right=np.nan)
            for values in (height, half)
        )
        found |= np.abs(places[:, 1] - line) < reach
    return found


def _as_colour(rgb: Float64Array) -> tuple[float, ...]:
    return tuple(np.round(np.clip(rgb, 0.005, 0.9), 4).tolist())


def nearest_name(table: dict[str, tuple[float, float, float]], rgb: Float64Array) -> str:
    """The name of the nearest colour of a table such as `choices.EYE_COLOURS`."""
    wanted = np.log(np.maximum(rgb, 1e-3))
    return min(table, key=lambda name: float(np.linalg.norm(np.log(table[name]) - wanted)))


NEAREST = 4
"""Samples that a texel's colour is mixed of."""
NEAR_M = (0.0015, 0.005)
"""Distance of the scan at which a texel is opaque, and not at all."""
LID_EDGE_M = (0.0012, 0.0030)
"""Distance to the eye opening over which the scan's colours begin."""
FEATHER_EDGES = 3
"""Edges of the mesh over which colours pass into proposed ones."""
IRIS_M = (0.0022, 0.0050)
"""Radii of the ring in which the iris is looked for."""
LIKE_SKIN, LIKE_HAIR = 0.35, 0.45
"""Difference of log colours below which an iris is a closed lid, and above which a scalp has
hair."""
SCALP_SEEN = 0.4
"""Share of the scalp that a scan must have for its hair to be taken."""
PROPOSED = "short"
"""Hair of a scan without a crown."""


def head_of_scan(found: Registered, chosen: dict[str, str]) -> OwnHead:
    """Make the fitted head of a registered scan.

    Args:
        chosen: Fields of `Person` that the user names: hair, hair_colour, eyes, clothes ...
    """
    model = read_model()
    flat = unwrap(model)
    colours, alpha = _colours(found, flat.at(found.rest_m), flat.at(found.seen))
    worn = wear(model, found.rest_m, flat, colours, alpha)
    scalp = flat.at(hair_coverage(found.rest_m)) > 0.3
    style, hair = _hair(colours[scalp], worn.alpha[scalp], worn.skin)
    guessed = () if style != PROPOSED else ("hair: the scan has no crown",)
    return worn.head(
        found.face.coefficients, style, hair, _iris(found, worn.skin), chosen, "a scan", guessed
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Worn:
    """A shape with its colours.

    Attributes:
        alpha: How well each texel of the skin is known. ``[T]``.
        texture: As `OwnHead` has it.
        look: Colours that were found.
        tone: Of the skin, 1 to 6.
    """

    rest_m: Float64Array
    alpha: Float64Array
    texture: ByteArray
    look: dict[str, tuple[float, ...]]
    tone: float

    @property
    def skin(self) -> Float64Array:
        """Colour of the skin, linear. ``[3]``."""
        return np.array(self.look["skin_rgb"])

    def head(
        self,
        coefficients: Float64Array,
        style: str,
        hair: Float64Array | None,
        iris: Float64Array | None,
        chosen: dict[str, str],
        source: str,
        guessed: tuple[str, ...],
    ) -> OwnHead:
        """The fitted head, with hair and eyes that were found or not."""
        guessed = ("inside of the mouth, teeth and tongue", "clothes", *guessed)
        look = dict(self.look)
        if iris is None:
            guessed = (*guessed, "colour of the eyes")
        else:
            look["iris_rgb"] = tuple(iris.tolist())
        if hair is not None:
            look["hair_rgb"] = tuple(hair.tolist())
        choices: dict[str, Any] = {
            "sex": "male" if coefficients @ read_model().male > 0 else "female",
            "hair": style, "clothes": "tee", "clothes_colour": "charcoal",
            "hair_colour": "brown" if hair is None else nearest_name(HAIR_COLOURS, hair),
            "eyes": "brown" if iris is None else nearest_name(EYE_COLOURS, iris),
        }  # fmt: skip
        for option, name in (("eyes", "iris_rgb"), ("hair_colour", "hair_rgb")):
            if option in chosen:
                look.pop(name, None)
        clipped = np.clip(coefficients[:NUM_MODES], -CLIP, CLIP)
        person = Person(seed=0, skin=self.tone, coefficients=tuple(clipped.tolist()))
        return OwnHead(
            rest_m=self.rest_m,
            texture=self.texture,
            person=replace(person, **choices | chosen),
            look=look,
            guessed=guessed,
            source=source,
        )


def wear(
    model: FaceModel, rest_m: Float64Array, flat: Unwrapped,
    colours: Float64Array, alpha: Float64Array,
) -> Worn:  # fmt: skip
    """Put colours on a shape.

    Args:
        colours: Of texels, linear, as `unlit` has them. ``[T, 3]``.
        alpha: How well they are known. ``[T]``.
    """
    features = find_features(model.shaped(rest_m))
    lips, gap = flat.at(features.lips), flat.at(features.eye_gap_m)
    alpha = alpha * np.clip((gap - LID_EDGE_M[0]) / np.diff(LID_EDGE_M)[0], 0, 1)
    alpha *= np.clip((1.2 - lips) / 0.4, 0, 1)
    inner = flat.at(features.regions["face"].astype(np.float64)) > 0.5
    places = flat.at(rest_m)
    landmarks = landmark_values(rest_m)
    look, tone = skin_colours(colours, inner & (alpha > 0.5), places, lips, landmarks)
    texture = np.zeros((*flat.seen.shape, 4), np.uint8)
    texture[flat.seen, :3] = np.rint(255 * np.clip(colours, 0, 1) ** (1 / 2.2))
    texture[flat.seen, 3] = np.rint(255 * np.minimum(alpha, flat.soften(alpha, FEATHER_EDGES)))
    # What filters reach beyond the edges is as the edge.
    row, column = distance_transform_edt(~flat.seen, return_distances=False, return_indices=True)
    return Worn(rest_m=rest_m, alpha=alpha, texture=texture[row, column], look=look, tone=tone)


def _colours(
    found: Registered, places: Float64Array, seen: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """What the stage needs to show the scan's colours at places ``[T, 3]``, linear, and how well
    they are known ``[T]``."""
    cloud = found.cloud
    apart, near = cloud.tree.query(places, NEAREST)
    weights = 1 / np.maximum(apart, 2e-4) ** 2
    weights /= weights.sum(1, keepdims=True)
    colours = np.einsum("tk,tkc->tc", weights, cloud.colours[near])
    level = np.clip((NEAR_M[1] - apart[:, 0]) / (NEAR_M[1] - NEAR_M[0]), 0, 1)
    return unlit(linear(255 * colours)), level * seen * cloud.inside[near[:, 0]]


def _hair(
    colours: Float64Array, alpha: Float64Array, skin: Float64Array
) -> tuple[str, Float64Array | None]:
    """Style and colour of the hair, from texels of the scalp."""
    if not len(alpha) or (alpha > 0.5).mean() < SCALP_SEEN:
        return PROPOSED, None
    colour = np.clip(np.median(colours[alpha > 0.5], axis=0), 0.003, 0.6)
    unlike = np.abs(np.log(colour) - np.log(skin)).mean()
    return ("buzz", colour) if unlike > LIKE_HAIR else ("bald", None)


def _iris(found: Registered, skin: Float64Array) -> Float64Array | None:
    """Colour of the irises, where the scan has open eyes."""
    pupils = landmark_places().at(found.face.coefficients)[[468, 473]]
    rings = []
    for pupil in pupils:
        offset = np.linalg.norm(found.cloud.points - pupil, axis=1)
        ring = (offset > IRIS_M[0]) & (offset < IRIS_M[1])
        rings.append(found.cloud.colours[ring & (found.cloud.points[:, 1] < pupil[1])])
    return iris_colour(255 * np.concatenate(rings), skin)


def iris_colour(srgb: Float64Array | ByteArray, skin: Float64Array) -> Float64Array | None:
    """Colour of irises that show so ``[N, 3]``, 0 to 255; none of closed lids."""
    if len(srgb) < 20:
        return None
    colour = np.clip(unlit(linear(np.median(srgb, axis=0))), 0.008, 0.3)
    return None if np.abs(np.log(colour) - np.log(skin)).max() < LIKE_SKIN else colour
