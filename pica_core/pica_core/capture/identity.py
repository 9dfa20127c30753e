"""Who the built-in heads are: every identity is one row of numbers.

The measures are millimetres and start from the means of published surveys of living people, moved
within about one standard deviation per identity:

- Farkas, "Anthropometry of the Head and Face" (2nd ed., 1994): face height sellion-menton, nose,
lips, eye fissure; - Zhuang & Bradtmiller, "Head-and-face anthropometric survey of U.S. respirator
users", J. Occup. Environ. Hyg. 2(11),
  2005: head breadth and length, bizygomatic and bigonial breadth, interpupillary distance, by sex;
- Bekerman, Gottlieb & Vaiman, "Variations in eyeball diameters of the healthy adults", J.
Ophthalmol. 2014: 24 mm.

The heads are invented. None of them is a likeness of a person, and none was measured from one.
"""

from __future__ import annotations

from dataclasses import dataclass, field

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
    """Bizygomatic breadth."""
    jaw_breadth: float = 108.0
    """Bigonial breadth."""
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
    """Vermilion colour."""
    freckles: float = 0.0
    """Amount of freckles, 0 to 1."""
    stubble: float = 0.0
    """Beard shadow, 0 to 1."""
    makeup: float = 0.0
    """Eyeliner, lip colour and blush, 0 to 1."""
    age: float = 0.2
    """Lines and unevenness, 0 to 1."""
    brow_rgb: Rgb = (0.06, 0.035, 0.02)
    """Brow hair colour."""
    brow_thickness: float = 1.0
    """Relative height of the brows."""
    iris_rgb: Rgb = (0.16, 0.07, 0.025)
    """Iris colour."""
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
    """Proportions."""
    hair: Hair = field(default_factory=Hair)
    """Hair shell."""
    skin: Skin = field(default_factory=Skin)
    """Colours and marks."""


IDENTITIES: dict[str, Identity] = {
    "S1": Identity(
        name="S1",
        seed=11,
        face=FaceShape(nose_breadth=34.5, nose_bridge=1.2, brow_ridge=1.7, eye_opening=8.8),
        hair=Hair(
            rgb=(0.045, 0.026, 0.016),
            curl=0.25,
            front=80.0,
            fringe=0.0,
            top_thickness=17.0,
            side_thickness=3.5,
            sweep=0.75,
        ),
        skin=Skin(
            rgb=(0.60, 0.345, 0.235),
            stubble=0.55,
            age=0.35,
            brow_thickness=1.15,
            iris_rgb=(0.09, 0.16, 0.22),
            cloth_rgb=(0.035, 0.055, 0.09),
        ),
    ),
    "S2": Identity(
        name="S2",
        seed=23,
        face=FaceShape(
            head_breadth=146.0,
            head_length=186.0,
            cheekbone_breadth=131.0,
            jaw_breadth=94.0,
            face_height=112.0,
            eye_distance=62.0,
            eye_width=30.5,
            eye_opening=9.5,
            eye_tilt=2.6,
            brow_height=18.5,
            brow_ridge=0.3,
            nose_breadth=37.0,
            nose_length=46.0,
            nose_protrusion=17.5,
            nose_bridge=0.85,
            nose_tip_lift=1.2,
            mouth_width=51.0,
            upper_lip=9.0,
            lower_lip=11.0,
            lip_fullness=1.45,
            chin_breadth=32.0,
            chin_projection=-1.0,
            cheek_fullness=0.97,
            neck_breadth=98.0,
            ear_length=57.0,
        ),
        hair=Hair(
            rgb=(0.020, 0.013, 0.010),
            front=79.0,
            side=26.0,
            nape=-44.0,
            top_thickness=36.0,
            side_thickness=22.0,
            fringe=0.0,
            curl=1.0,
        ),
        skin=Skin(
            rgb=(0.300, 0.150, 0.090),
            redness=0.7,
            lip_rgb=(0.27, 0.075, 0.075),
            freckles=0.25,
            makeup=0.7,
            age=0.1,
            brow_rgb=(0.02, 0.012, 0.008),
            brow_thickness=0.8,
            iris_rgb=(0.075, 0.032, 0.014),
            cloth_rgb=(0.16, 0.035, 0.05),
        ),
    ),
}
"""The identities that ship. A new one is a new row."""


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
