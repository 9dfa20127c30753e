"""Who the built-in heads are: every identity is one column of numbers.

The measures are millimetres and start from the means of published surveys of living people, moved
within one or two standard deviations per identity:

- Farkas, "Anthropometry of the Head and Face" (2nd ed., 1994): face height sellion-menton, nose,
  lips, eye fissure, ears;
- Zhuang & Bradtmiller, "Head-and-face anthropometric survey of U.S. respirator users", J. Occup.
  Environ. Hyg. 2(11), 2005: head breadth and length, bizygomatic and bigonial breadth,
  interpupillary distance, by sex;
- Bekerman, Gottlieb & Vaiman, "Variations in eyeball diameters of the healthy adults", J.
  Ophthalmol. 2014: 24 mm.

The heads are invented. None of them is a likeness of a person, and none was measured from one.
"""

from dataclasses import dataclass, field
from typing import Any

from pica_core.errors import CaptureError

Rgb = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class FaceShape:
    """Proportions of a head, in millimetres unless a line says otherwise."""

    head_breadth: float = 152.0
    """Widest breadth of the cranium."""
    head_length: float = 194.0
    """Glabella to occiput."""
    cheekbone_breadth: float = 138.0
    """Breadth over the zygomatic arches."""
    jaw_breadth: float = 108.0
    """Breadth between the jaw's angles (gonia)."""
    face_height: float = 120.0
    """Sellion to menton."""
    eye_distance: float = 64.0
    """Between the pupils."""
    eye_width: float = 30.0
    """Palpebral fissure, canthus to canthus."""
    eye_opening: float = 9.2
    """Palpebral fissure height at rest."""
    eye_tilt: float = 1.5
    """How much higher the outer canthus lies than the inner one."""
    brow_height: float = 17.0
    """Pupil to brow centre."""
    brow_ridge: float = 1.0
    """Strength of the supraorbital ridge; 1 is a man's mean, 0.4 a woman's."""
    nose_breadth: float = 36.0
    """Ala to ala."""
    nose_length: float = 50.0
    """Sellion to subnasale."""
    nose_protrusion: float = 20.0
    """Subnasale to tip."""
    nose_bridge: float = 1.0
    """Height of the bridge, relative."""
    nose_tip_lift: float = 0.0
    """Tip above its usual place; positive turns the nose up."""
    mouth_width: float = 54.0
    """Between the corners of the mouth."""
    upper_lip: float = 7.0
    """Height of the upper vermilion."""
    lower_lip: float = 9.0
    """Height of the lower vermilion."""
    lip_fullness: float = 1.0
    """How far the lips pout, relative."""
    chin_breadth: float = 40.0
    """Breadth of the chin's flat part."""
    chin_projection: float = 0.0
    """Pogonion ahead of its usual place."""
    cheek_fullness: float = 1.0
    """Soft cheek below the cheekbone, relative."""
    neck_breadth: float = 114.0
    """Breadth of the neck below the jaw."""
    ear_length: float = 62.0
    """Top to lobe."""
    age: float = 0.2
    """Depth of folds, bags and jowls: 0 about twenty years, 1 about eighty."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Hair:
    """The hair shell: where it ends and how thick it is. Azimuth 0 is the front, 180 the back."""

    rgb: Rgb = (0.05, 0.03, 0.02)
    """Linear colour of a strand."""
    front: float = 74.0
    """Hairline above the forehead, mm above the ear axis."""
    side: float = 22.0
    """Lower end above and in front of the ear, mm."""
    nape: float = -48.0
    """Lower end at the back, mm."""
    top_thickness: float = 16.0
    """Shell above the scalp at the crown, mm."""
    side_thickness: float = 6.0
    """Shell above the scalp at the sides, mm."""
    fringe: float = 6.0
    """How far the front edge stands off the forehead, mm."""
    parting: float = 0.0
    """Azimuth of the parting, degrees towards the subject's left; 0 means combed back."""
    curl: float = 0.2
    """Waviness of the strands, 0 straight to 0.8 wavy; above that hair is coils."""
    sweep: float = 0.0
    """How far strands turn towards the subject's left on their way from crown to edge, radians."""
    grey: float = 0.0
    """Share of strands that have lost their colour, 0 to 1."""
    rise: float = 9.0
    """How far from the hairline the shell gains two thirds of its thickness, mm."""
    recession: float = 0.0
    """How far the hairline has withdrawn above the temples, mm."""
    covers_ears: bool = False
    """True when the sides hang over the ears."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Skin:
    """Colours and marks, linear RGB where a line says colour."""

    rgb: Rgb = (0.62, 0.36, 0.25)
    """Base skin colour."""
    redness: float = 1.0
    """Strength of the blood-rich regions: cheeks, nose, ears, lids."""
    lip_rgb: Rgb = (0.45, 0.16, 0.14)
    """Colour of the vermilion."""
    freckles: float = 0.0
    """Amount of freckles, 0 to 1."""
    stubble: float = 0.0
    """Beard shadow, 0 to 1."""
    beard: float = 0.0
    """Short full beard, 0 to 1."""
    makeup: float = 0.0
    """Eyeliner, lip colour and blush, 0 to 1."""
    age: float = 0.2
    """Lines and unevenness, 0 to 1."""
    brow_rgb: Rgb = (0.06, 0.035, 0.02)
    """Brow hair colour."""
    brow_thickness: float = 1.0
    """Relative height of the brows."""
    iris_rgb: Rgb = (0.16, 0.07, 0.025)
    """Colour of the iris."""
    cloth_rgb: Rgb = (0.05, 0.07, 0.10)
    """Colour of the collar."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Identity:
    """One invented person."""

    name: str
    """Identity name, as in ``--head``."""
    seed: int
    """Fixes the marks that chance places: pores, freckles, strands."""
    face: FaceShape = field(default_factory=FaceShape)
    """Proportions of the head."""
    hair: Hair = field(default_factory=Hair)
    """Shape and colour of the hair shell."""
    skin: Skin = field(default_factory=Skin)
    """Colours and marks."""


_FACES: dict[str, tuple[Any, ...]] = {
    "head_breadth":      ( 152.0,  146.0,  155.0,  148.0,  151.0,  146.0),
    "head_length":       ( 194.0,  186.0,  198.0,  182.0,  192.0,  187.0),
    "cheekbone_breadth": ( 138.0,  131.0,  140.0,  134.0,  137.0,  131.0),
    "jaw_breadth":       ( 111.0,   94.0,  110.0,   97.0,  107.0,   95.0),
    "face_height":       ( 122.0,  112.0,  124.0,  113.0,  121.0,  114.0),
    "eye_distance":      (  64.0,   62.0,   65.0,   62.5,   63.5,   61.5),
    "eye_width":         (  30.0,   30.5,   29.0,   28.5,   31.5,   28.5),
    "eye_opening":       (   8.3,    9.2,    7.6,    8.4,    9.0,    8.2),
    "eye_tilt":          (   1.5,    2.6,    0.2,    3.0,    1.2,    0.6),
    "brow_height":       (  17.0,   18.5,   16.0,   20.0,   15.5,   17.0),
    "brow_ridge":        (   1.7,    0.1,    1.6,    0.0,    1.3,    0.2),
    "nose_breadth":      (  35.0,   37.0,   38.5,   34.5,   38.0,   34.0),
    "nose_length":       (  51.0,   46.0,   54.0,   46.0,   53.0,   50.0),
    "nose_protrusion":   (  21.0,   17.5,   21.5,   16.5,   21.5,   19.5),
    "nose_bridge":       (  1.25,   0.85,    1.3,   0.55,   1.45,   1.05),
    "nose_tip_lift":     (   0.0,    1.2,   -1.2,    0.6,   -0.8,   -0.6),
    "mouth_width":       (  54.0,   51.0,   55.0,   47.0,   53.0,   50.0),
    "upper_lip":         (   7.0,    9.0,    4.8,    7.5,    7.5,    4.6),
    "lower_lip":         (   9.0,   11.0,    7.0,    9.5,    9.5,    6.8),
    "lip_fullness":      (   1.0,   1.45,   0.75,    1.1,    1.1,   0.75),
    "chin_breadth":      (  40.0,   32.0,   42.0,   32.0,   38.0,   34.0),
    "chin_projection":   (   0.0,   -1.0,    1.0,   -1.5,    0.0,    0.0),
    "cheek_fullness":    (   1.0,   0.97,    1.0,   1.06,   1.02,    1.0),
    "neck_breadth":      ( 112.0,   92.0,  120.0,   90.0,  112.0,   93.0),
    "ear_length":        (  62.0,   57.0,   69.0,   57.0,   63.0,   62.0),
    "age":               (  0.25,    0.1,    0.8,    0.0,   0.45,    0.9),
}  # fmt: skip
"""Proportions of the heads, one column each, in the order of `_SEEDS`."""
_HAIR: dict[str, tuple[Any, ...]] = {
    "rgb": ((0.045, 0.026, 0.016), (0.02, 0.013, 0.01), (0.12, 0.1, 0.085),
            (0.014, 0.011, 0.01), (0.016, 0.012, 0.01), (0.33, 0.29, 0.25)),
    "front":             (  80.0,   79.0,   97.0,   53.0,   76.0,   80.0),
    "side":              (  22.0,   22.0,   24.0,  -62.0,   18.0,  -22.0),
    "nape":              ( -48.0,  -44.0,  -44.0,  -84.0,  -46.0,  -58.0),
    "top_thickness":     (  17.0,   44.0,    7.0,   13.0,   22.0,   26.0),
    "side_thickness":    (   3.5,   38.0,    4.0,   11.0,    6.0,   15.0),
    "fringe":            (   0.0,    0.0,    0.0,    4.0,    0.0,    0.0),
    "parting":           (   0.0,    0.0,    0.0,    0.0,    0.0,  -18.0),
    "curl":              (  0.25,    1.0,    0.2,   0.06,    0.6,   0.55),
    "sweep":             (  0.75,    0.0,   -0.4,    0.0,   -0.6,   0.35),
    "grey":              (   0.0,    0.0,    0.8,    0.0,    0.0,    0.7),
    "rise":              (   9.0,   15.0,   14.0,    9.0,    8.0,    9.0),
    "recession":         (   0.0,    0.0,    7.0,    0.0,    4.0,    0.0),
    "covers_ears":       (False, False, False,  True, False,  True),
}  # fmt: skip
"""Hair shells, in the same order."""
_SKINS: dict[str, tuple[Any, ...]] = {
    "rgb": ((0.6, 0.345, 0.235), (0.3, 0.15, 0.09), (0.56, 0.3, 0.2),
            (0.66, 0.42, 0.29), (0.4, 0.215, 0.13), (0.66, 0.4, 0.3)),
    "redness":           (   1.0,    0.7,    1.5,    0.7,    0.6,    1.2),
    "lip_rgb": ((0.45, 0.16, 0.14), (0.27, 0.075, 0.075), (0.4, 0.16, 0.13),
                (0.48, 0.17, 0.16), (0.3, 0.115, 0.105), (0.46, 0.19, 0.17)),
    "freckles":          (   0.0,   0.25,    0.0,    0.0,    0.0,    0.2),
    "stubble":           (  0.55,    0.0,   0.25,    0.0,    0.6,    0.0),
    "beard":             (   0.0,    0.0,    0.0,    0.0,    1.0,    0.0),
    "makeup":            (   0.0,    0.7,    0.0,    0.4,    0.0,   0.45),
    "age":               (   0.3,    0.1,   0.85,    0.0,   0.45,    0.9),
    "brow_rgb": ((0.06, 0.035, 0.02), (0.02, 0.012, 0.008), (0.2, 0.17, 0.14),
                 (0.025, 0.018, 0.014), (0.014, 0.01, 0.008), (0.26, 0.21, 0.17)),
    "brow_thickness":    (  1.15,    0.8,   1.25,   0.85,   1.35,    0.7),
    "iris_rgb": ((0.075, 0.13, 0.18), (0.075, 0.032, 0.014), (0.085, 0.085, 0.045),
                 (0.05, 0.022, 0.011), (0.05, 0.024, 0.012), (0.07, 0.11, 0.13)),
    "cloth_rgb": ((0.035, 0.055, 0.09), (0.16, 0.035, 0.05), (0.09, 0.085, 0.075),
                  (0.13, 0.13, 0.125), (0.02, 0.05, 0.04), (0.1, 0.06, 0.12)),
}  # fmt: skip
"""Colours and marks, in the same order."""
_SEEDS = {"S1": 11, "S2": 23, "S3": 37, "S4": 41, "S5": 53, "S6": 67}


def _column(table: dict[str, tuple[Any, ...]], at: int) -> dict[str, Any]:
    return {name: values[at] for name, values in table.items()}


IDENTITIES: dict[str, Identity] = {
    name: Identity(
        name=name,
        seed=seed,
        face=FaceShape(**_column(_FACES, at)),
        hair=Hair(**_column(_HAIR, at)),
        skin=Skin(**_column(_SKINS, at)),
    )
    for at, (name, seed) in enumerate(_SEEDS.items())
}
"""The identities that ship. A new one is a new column."""


def get_identity(name: str) -> Identity:
    """Look an identity up by name.

    Raises:
        CaptureError: No identity has this name; the message lists the known ones.
    """
    try:
        return IDENTITIES[name]
    except KeyError:
        known = ", ".join(IDENTITIES)
        raise CaptureError(f"head {name!r} is unknown; built in are {known}") from None
