"""Who the built-in heads are: every identity is one row of numbers.

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
    """Vermilion colour."""
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
    who.name: who
    for who in (
        Identity(
            name="S1",
            seed=11,
            face=FaceShape(
                jaw_breadth=111.0,
                face_height=122.0,
                nose_breadth=35.0,
                nose_length=51.0,
                nose_protrusion=21.0,
                nose_bridge=1.25,
                brow_ridge=1.7,
                eye_opening=8.3,
                neck_breadth=112.0,
                age=0.25,
            ),
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
                age=0.3,
                brow_thickness=1.15,
                iris_rgb=(0.075, 0.13, 0.18),
                cloth_rgb=(0.035, 0.055, 0.09),
            ),
        ),
        Identity(
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
                eye_opening=9.2,
                eye_tilt=2.6,
                brow_height=18.5,
                brow_ridge=0.1,
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
                neck_breadth=92.0,
                ear_length=57.0,
                age=0.1,
            ),
            hair=Hair(
                rgb=(0.020, 0.013, 0.010),
                front=79.0,
                side=22.0,
                nape=-44.0,
                top_thickness=44.0,
                side_thickness=38.0,
                fringe=0.0,
                curl=1.0,
                rise=15.0,
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
        Identity(
            name="S3",
            seed=37,
            face=FaceShape(
                head_breadth=155.0,
                head_length=198.0,
                cheekbone_breadth=140.0,
                jaw_breadth=110.0,
                face_height=124.0,
                eye_distance=65.0,
                eye_width=29.0,
                eye_opening=7.6,
                eye_tilt=0.2,
                brow_height=16.0,
                brow_ridge=1.6,
                nose_breadth=38.5,
                nose_length=54.0,
                nose_protrusion=21.5,
                nose_bridge=1.3,
                nose_tip_lift=-1.2,
                mouth_width=55.0,
                upper_lip=4.8,
                lower_lip=7.0,
                lip_fullness=0.75,
                chin_breadth=42.0,
                chin_projection=1.0,
                cheek_fullness=1.0,
                neck_breadth=120.0,
                ear_length=69.0,
                age=0.8,
            ),
            hair=Hair(
                rgb=(0.12, 0.10, 0.085),
                grey=0.8,
                front=97.0,
                recession=7.0,
                side=24.0,
                nape=-44.0,
                top_thickness=7.0,
                side_thickness=4.0,
                fringe=0.0,
                curl=0.2,
                sweep=-0.4,
                rise=14.0,
            ),
            skin=Skin(
                rgb=(0.56, 0.30, 0.20),
                redness=1.5,
                lip_rgb=(0.40, 0.16, 0.13),
                stubble=0.25,
                age=0.85,
                brow_rgb=(0.20, 0.17, 0.14),
                brow_thickness=1.25,
                iris_rgb=(0.085, 0.085, 0.045),
                cloth_rgb=(0.09, 0.085, 0.075),
            ),
        ),
        Identity(
            name="S4",
            seed=41,
            face=FaceShape(
                head_breadth=148.0,
                head_length=182.0,
                cheekbone_breadth=134.0,
                jaw_breadth=97.0,
                face_height=113.0,
                eye_distance=62.5,
                eye_width=28.5,
                eye_opening=8.4,
                eye_tilt=3.0,
                brow_height=20.0,
                brow_ridge=0.0,
                nose_breadth=34.5,
                nose_length=46.0,
                nose_protrusion=16.5,
                nose_bridge=0.55,
                nose_tip_lift=0.6,
                mouth_width=47.0,
                upper_lip=7.5,
                lower_lip=9.5,
                lip_fullness=1.1,
                chin_breadth=32.0,
                chin_projection=-1.5,
                cheek_fullness=1.06,
                neck_breadth=90.0,
                ear_length=57.0,
                age=0.0,
            ),
            hair=Hair(
                rgb=(0.014, 0.011, 0.010),
                front=53.0,
                side=-62.0,
                nape=-84.0,
                top_thickness=13.0,
                side_thickness=11.0,
                fringe=4.0,
                curl=0.06,
                covers_ears=True,
            ),
            skin=Skin(
                rgb=(0.66, 0.42, 0.29),
                redness=0.7,
                lip_rgb=(0.48, 0.17, 0.16),
                makeup=0.4,
                age=0.0,
                brow_rgb=(0.025, 0.018, 0.014),
                brow_thickness=0.85,
                iris_rgb=(0.05, 0.022, 0.011),
                cloth_rgb=(0.13, 0.13, 0.125),
            ),
        ),
        Identity(
            name="S5",
            seed=53,
            face=FaceShape(
                head_breadth=151.0,
                head_length=192.0,
                cheekbone_breadth=137.0,
                jaw_breadth=107.0,
                face_height=121.0,
                eye_distance=63.5,
                eye_width=31.5,
                eye_opening=9.0,
                eye_tilt=1.2,
                brow_height=15.5,
                brow_ridge=1.3,
                nose_breadth=38.0,
                nose_length=53.0,
                nose_protrusion=21.5,
                nose_bridge=1.45,
                nose_tip_lift=-0.8,
                mouth_width=53.0,
                upper_lip=7.5,
                lower_lip=9.5,
                lip_fullness=1.1,
                chin_breadth=38.0,
                chin_projection=0.0,
                cheek_fullness=1.02,
                neck_breadth=112.0,
                ear_length=63.0,
                age=0.45,
            ),
            hair=Hair(
                rgb=(0.016, 0.012, 0.010),
                front=76.0,
                side=18.0,
                nape=-46.0,
                top_thickness=22.0,
                side_thickness=6.0,
                fringe=0.0,
                curl=0.6,
                sweep=-0.6,
                recession=4.0,
                rise=8.0,
            ),
            skin=Skin(
                rgb=(0.40, 0.215, 0.130),
                redness=0.6,
                lip_rgb=(0.30, 0.115, 0.105),
                stubble=0.6,
                beard=1.0,
                age=0.45,
                brow_rgb=(0.014, 0.010, 0.008),
                brow_thickness=1.35,
                iris_rgb=(0.050, 0.024, 0.012),
                cloth_rgb=(0.02, 0.05, 0.04),
            ),
        ),
        Identity(
            name="S6",
            seed=67,
            face=FaceShape(
                head_breadth=146.0,
                head_length=187.0,
                cheekbone_breadth=131.0,
                jaw_breadth=95.0,
                face_height=114.0,
                eye_distance=61.5,
                eye_width=28.5,
                eye_opening=8.2,
                eye_tilt=0.6,
                brow_height=17.0,
                brow_ridge=0.2,
                nose_breadth=34.0,
                nose_length=50.0,
                nose_protrusion=19.5,
                nose_bridge=1.05,
                nose_tip_lift=-0.6,
                mouth_width=50.0,
                upper_lip=4.6,
                lower_lip=6.8,
                lip_fullness=0.75,
                chin_breadth=34.0,
                chin_projection=0.0,
                cheek_fullness=1.0,
                neck_breadth=93.0,
                ear_length=62.0,
                age=0.9,
            ),
            hair=Hair(
                rgb=(0.33, 0.29, 0.25),
                grey=0.7,
                front=80.0,
                side=-22.0,
                nape=-58.0,
                top_thickness=26.0,
                side_thickness=15.0,
                fringe=0.0,
                curl=0.55,
                sweep=0.35,
                parting=-18.0,
                covers_ears=True,
            ),
            skin=Skin(
                rgb=(0.66, 0.40, 0.30),
                redness=1.2,
                lip_rgb=(0.46, 0.19, 0.17),
                freckles=0.2,
                makeup=0.45,
                age=0.9,
                brow_rgb=(0.26, 0.21, 0.17),
                brow_thickness=0.7,
                iris_rgb=(0.07, 0.11, 0.13),
                cloth_rgb=(0.10, 0.06, 0.12),
            ),
        ),
    )
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
