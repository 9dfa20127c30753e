"""From a scan to a fitted head: its colours on the model's chart, its hair, and what it lacks.

Each texel of the model's skin takes the colour of the scan's nearest samples, as opaque as those
are near, level and no border. Under it lies painted skin of the scan's own tone, which shows where
the scan has holes, at the lids' edges (a scan's lids are glued to its eyes) and inside the mouth.

Hair: the model's scalp was drawn out to the scan's surface, hair or skin, and wears its colours;
where the scan has no crown, a style is proposed.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from pica_core.capture.me.face import landmark_places
from pica_core.capture.me.head import OwnHead
from pica_core.capture.me.register import Registered
from pica_core.capture.me.skin import linear, nearest_name, skin_colours, stored, unlit
from pica_core.capture.me.unwrap import Unwrapped
from pica_core.capture.person.choices import (
    CLIP,
    EYE_COLOURS,
    HAIR_COLOURS,
    NUM_MODES,
    Person,
    read_model,
)
from pica_core.capture.rig.features import find_features, hair_coverage
from pica_core.types import Float64Array

NEAREST = 4
"""Samples that a texel's colour is mixed of."""
NEAR_M = (0.0015, 0.005)
"""Distance of the scan at which a texel is opaque, and not at all."""
LID_EDGE_M = (0.0012, 0.0030)
"""Distance to the eye opening over which the scan's colours begin."""
FEATHER_TEXELS = 4.0
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
    features = find_features(model.shaped(found.rest_m))
    guessed = ["inside of the mouth, teeth and tongue", "clothes"]
    with Unwrapped(model) as flat:
        places = flat.at(found.rest_m)
        colours, alpha = _colours(found, places, flat.at(found.seen))
        lips, gap = flat.at(features.lips), flat.at(features.eye_gap_m)
        alpha *= np.clip((gap - LID_EDGE_M[0]) / np.diff(LID_EDGE_M)[0], 0, 1)
        alpha *= np.clip((1.2 - lips) / 0.4, 0, 1)
        inner = flat.at(features.regions["face"].astype(np.float64)) > 0.5
        look, tone = skin_colours(colours, inner & (alpha > 0.5), places, lips, features)
        scalp = flat.at(hair_coverage(found.rest_m)) > 0.3
        texture = np.zeros((*flat.seen.shape, 4), np.uint8)
        texture[flat.seen, :3] = stored(colours)
        opaque = np.zeros(flat.seen.shape)
        opaque[flat.seen] = alpha
        # Not over the edges of islands, where nothing lies beside.
        share = gaussian_filter(flat.seen.astype(np.float64), FEATHER_TEXELS)
        soft = gaussian_filter(opaque, FEATHER_TEXELS) / np.maximum(share, 1e-6)
        texture[..., 3] = np.rint(255 * np.minimum(opaque, soft))
        # What filters reach beyond the edges is as the edge.
        row, column = distance_transform_edt(
            ~flat.seen, return_distances=False, return_indices=True
        )
        texture = texture[row, column]
    style, hair = _hair(colours[scalp], alpha[scalp], np.array(look["skin_rgb"]))
    if style == PROPOSED:
        guessed.append("hair: the scan has no crown")
    iris = _iris(found, np.array(look["skin_rgb"]))
    if iris is None:
        guessed.append("colour of the eyes")
    else:
        look["iris_rgb"] = tuple(iris.tolist())
    if hair is not None:
        look["hair_rgb"] = tuple(hair.tolist())
    choices: dict[str, Any] = {
        "sex": "male" if found.face.coefficients @ model.male > 0 else "female",
        "hair": style, "clothes": "tee", "clothes_colour": "charcoal",
        "hair_colour": "brown" if hair is None else nearest_name(HAIR_COLOURS, hair),
        "eyes": "brown" if iris is None else nearest_name(EYE_COLOURS, iris),
    }  # fmt: skip
    for option, name in (("eyes", "iris_rgb"), ("hair_colour", "hair_rgb")):
        if option in chosen:
            look.pop(name, None)
    coefficients = np.clip(found.face.coefficients[:NUM_MODES], -CLIP, CLIP)
    person = Person(seed=0, skin=tone, coefficients=tuple(coefficients.tolist()))
    return OwnHead(
        rest_m=found.rest_m,
        texture=texture,
        person=replace(person, **choices | chosen),
        look=look,
        source="scan",
        guessed=tuple(guessed),
    )


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
    pupils = landmark_places().at(found.face.coefficients, found.face.shapes)[[468, 473]]
    rings = []
    for pupil in pupils:
        offset = np.linalg.norm(found.cloud.points - pupil, axis=1)
        ring = (offset > IRIS_M[0]) & (offset < IRIS_M[1])
        rings.append(found.cloud.colours[ring & (found.cloud.points[:, 1] < pupil[1])])
    colours = np.concatenate(rings)
    if len(colours) < 20:
        return None
    colour = np.clip(unlit(linear(255 * np.median(colours, axis=0))), 0.008, 0.3)
    return None if np.abs(np.log(colour) - np.log(skin)).max() < LIKE_SKIN else colour
