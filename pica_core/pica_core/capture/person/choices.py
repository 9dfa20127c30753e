"""Who a person is: every choice by name and number, drawn from a seed or named by the user.

`person.json` holds all of it, so that anybody with the face model makes the same person again.
What is wrong with a file is a `CaptureError` that names it.

The face model that ships (``face_model.npz``) has a mean head, its 52 shapes, and 100 identity
modes. It is ICT-FaceKit Light, reduced and quantised by ``scripts/make_face_model.py``: integers in
the steps below, each but the first as its difference to the one before, split into planes of bytes.
The parts of its faces, its charts and seams, eyeballs, ears and neck are stored with it; the
islands of its charts are stretched so that each triangle has the room that it needs.

Source of the model: Li et al., "Learning Formation of Physically-Based Face Attributes", CVPR 2020.
    MIT licence, Copyright (c) 2020 USC Institute for Creative Technologies.
"""

import functools
import json
from dataclasses import asdict, dataclass, fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.capture.dataset.multiface import read_json
from pica_core.capture.person.hair import LOOKS, STYLES
from pica_core.capture.rig.mesh import EYES_AT_M, MARKS, Eyeball, RigFrame, RigMesh, fit_sphere
from pica_core.errors import CaptureError, check_ranges
from pica_core.types import Array, ByteArray, Float64Array, FloatArray, Int64Array, IntArray

NUM_MODES = 100
RIGHTS = "ICT-FaceKit Light, MIT licence, (c) 2020 USC Institute for Creative Technologies"
REST_M, MODE_M, MOTION_M, UV_STEP = 1e-8, 2.5e-6, 2e-7, 2.0**-24
"""Steps in which places, modes, shapes and texture coordinates are stored: so fine that a person is
the same to the triangle as one made of the public files."""
EYES = ("eye_left", "eye_right")
COARSE = "coarse_"
"""Prefix of the triangles of the coarse mesh, over some of the same vertices."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FaceModel:
    """The mean head, and what each identity mode adds to its vertices.

    Attributes:
        mean: Metres, head frame.
        modes_m: float32 ``[100, P, 3]``.
        male: Coefficients of a typical man's face; those of a woman's are its opposite. ``[100]``.
    """

    mean: RigMesh
    modes_m: FloatArray
    male: Float64Array

    def mesh(self, coefficients: npt.ArrayLike) -> RigMesh:
        """The bare head of one identity ``[100]``; its shapes move it as they move the mean."""
        offset = np.tensordot(np.asarray(coefficients, np.float32), self.modes_m, 1)
        return self.shaped(self.mean.rest_m + offset)

    def shaped(self, rest: Float64Array) -> RigMesh:
        """The bare head with its vertices at these places ``[P, 3]``, moved so that its eyes lie
        where eyes of our heads do."""
        spheres = [fit_sphere(rest[eye.vertices]) for eye in self.mean.eyes]
        move = EYES_AT_M - np.mean([centre for centre, _, _ in spheres], axis=0)
        eyes = [
            replace(eye, centre_m=centre + move, radius_m=radius)
            for eye, (centre, radius, _) in zip(self.mean.eyes, spheres, strict=True)
        ]
        return replace(self.mean, rest_m=rest + move, eyes=tuple(eyes))


def _sums(planes: ByteArray, axis: int = 0) -> Int64Array:
    """Integers from planes of bytes of their differences along an axis, coordinates apart."""
    folded = sum(plane.astype(np.int32) << (8 * place) for place, plane in enumerate(planes))
    changes = np.moveaxis((folded >> 1) ^ -(folded & 1), -2, -1)
    return np.cumsum(changes, axis=axis, dtype=np.int32)


@functools.lru_cache(maxsize=2)
def read_model(*, coarse: bool = False) -> FaceModel:
    """Read the face model, a fifth of a second; it does not change, so calls share it.

    Args:
        coarse: The mesh of 9,000 triangles, for trials that are to take seconds.
    """
    with np.load(str(files("pica_core.capture") / "face_model.npz")) as stored:
        table: dict[str, Array] = {name: stored[name] for name in stored.files}
    prefix = COARSE if coarse else ""
    part = table[prefix + "part"].astype(np.int32)
    used, faces = _compact(_sums(table[prefix + "faces"]))
    used_uv, uv_faces = _compact(_sums(table[prefix + "uv_faces"]))

    def marked(name: str) -> Int64Array:
        return np.flatnonzero(np.isin(used, table[name]))

    eyes = [
        Eyeball(side=side, centre_m=np.zeros(3), radius_m=0.0, vertices=marked(name), turned=False)
        for side, name in zip((1.0, -1.0), EYES, strict=True)
    ]
    motion = _sums(table["motion"], 1)[:, used]
    mean = RigMesh(
        rest_m=REST_M * _sums(table["rest"])[used].astype(np.float64),
        motion_m=np.float32(MOTION_M) * motion.astype(np.float32),
        faces=faces,
        uv=UV_STEP * _sums(table["uv"])[used_uv].astype(np.float64),
        uv_faces=uv_faces,
        part=part,
        material=np.full(len(part), -1, np.int32),
        eyes=tuple(eyes),
        frame=RigFrame(unit="m", turned=False, guessed=()),
        dropped=(),
        marks={name: marked(name) for name in MARKS},
    )
    modes = np.float32(MODE_M) * _sums(table["modes"], 1)[:, used].astype(np.float32)
    return FaceModel(mean=mean, modes_m=modes, male=table["male"])


def _compact(faces: Int64Array) -> tuple[Int64Array, IntArray]:
    """The vertices that triangles use, and the triangles in these."""
    used, index = np.unique(faces, return_inverse=True)
    return used, index.reshape(-1, 3).astype(np.int32)


SPREAD, CLIP = 0.8, 2.0
"""Standard deviation of drawn coefficients, and the limit of any (0.9 and less looks natural)."""
SEXES = ("female", "male")
SKIN_TONES, HAIR_COLOURS = LOOKS["skin_tones"], LOOKS["hair_colours"]
"""Skin from the lightest, 1, to the darkest, 6 (chosen)."""
EYE_COLOURS, CLOTH_COLOURS = LOOKS["eye_colours"], LOOKS["cloth_colours"]
BEARDS = ("none", "stubble")
CLOTHES = tuple(LOOKS["cuts"])


@dataclass(frozen=True, kw_only=True, slots=True)
class Person:
    """A person who does not exist."""

    seed: int
    """Fixes what chance places: pores, freckles, moles, strands, folds."""
    coefficients: tuple[float, ...] = (0.0,) * NUM_MODES
    """Weights of the identity modes, each within the limit `CLIP`."""
    sex: str = "female"
    """One of `SEXES`: moves the coefficients, and the chances of the other choices."""
    age: int = 35
    """Years, 18 to 90: lines, spots, and grey."""
    skin: float = 2.0
    """Tone from 1, lightest, to 6, darkest."""
    redness: float = 0.7
    freckles: float = 0.0
    moles: float = 0.3
    hair: str = "short"
    """One of `hair.STYLES`."""
    hair_colour: str = "brown"
    grey: float = 0.0
    """Share of strands that have lost their colour."""
    beard: str = "none"
    brows: float = 1.0
    """Thickness of the brows, relative."""
    makeup: float = 0.0
    eyes: str = "brown"
    teeth: float = 0.5
    """Whiteness: 0 is yellow, 1 white."""
    clothes: str = "tee"
    clothes_colour: str = "navy"

    def __post_init__(self) -> None:
        if len(self.coefficients) != NUM_MODES:
            raise CaptureError(f"coefficients are {len(self.coefficients)}; {NUM_MODES} are needed")
        if not np.isfinite(self.coefficients).all():
            raise CaptureError("coefficients are not all finite")
        for name, known in NAMED.items():
            value = getattr(self, name)
            if value not in known:
                raise CaptureError(f"{name} is {value!r}; there are {', '.join(known)}")
        check_ranges(self, CaptureError, **RANGES)

    def as_json(self) -> str:
        """All choices, as `person.json` holds them."""
        return json.dumps(asdict(self), indent=1) + "\n"


NAMED: dict[str, tuple[str, ...]] = {
    "sex": SEXES, "hair": tuple(STYLES), "hair_colour": tuple(HAIR_COLOURS), "beard": BEARDS,
    "eyes": tuple(EYE_COLOURS), "clothes": CLOTHES, "clothes_colour": tuple(CLOTH_COLOURS),
}  # fmt: skip
RANGES: dict[str, tuple[float, float]] = {
    "seed": (0, 2**31), "age": (18, 90), "skin": (1, 6), "redness": (0, 1.5), "freckles": (0, 1),
    "moles": (0, 1), "grey": (0, 1), "brows": (0.4, 1.8), "makeup": (0, 1), "teeth": (0, 1),
}  # fmt: skip


def draw_person(seed: int, **chosen: Any) -> Person:
    """A person by chance; what is `chosen` stands, and what hangs on it follows.

    Args:
        seed: Fixes all that is not chosen.
        **chosen: Fields of `Person` that are not to be drawn.
    """
    random = np.random.default_rng([seed, 0x9E25])
    drawn = np.clip(random.normal(0.0, SPREAD, NUM_MODES), -CLIP, CLIP)
    dice = {name: float(random.random()) for name in ("sex", "age", "skin", "hair", "colour")}
    sex = chosen.get("sex", SEXES[int(dice["sex"] < 0.5)])
    man = sex == "male"
    age = int(chosen.get("age") or 20 + 58 * dice["age"] ** 1.3)
    skin = float(chosen.get("skin") or 1 + 5 * dice["skin"])
    old = float(np.clip((age - 35) / 40, 0, 1))
    styles = (
        ("short", "swept", "parted", "buzz", "curly", "receding", "bald", "afro")
        if man else ("long", "bob", "parted", "curly", "afro", "short", "swept")
    )  # fmt: skip
    colours = ("black", "brown") if skin > 3 else ("brown", "light_brown", "blond", "red", "black")
    eyes = ("dark", "brown") if skin > 3 else ("brown", "hazel", "green", "blue", "grey")

    def pick(names: tuple[str, ...]) -> str:
        return names[int(random.integers(len(names)))]

    values: dict[str, Any] = {
        "coefficients": drawn + (1.0 if man else -1.0) * read_model().male,
        "sex": sex, "age": age, "skin": round(skin, 2),
        "redness": round(float(random.uniform(0.5, 1.0) * np.interp(skin, [1, 6], [1.1, 0.4])), 2),
        "freckles": round(float(np.clip(random.normal(-0.1, 0.35), 0, 1)) * (skin < 3.2), 2),
        "moles": round(float(random.uniform(0.1, 0.7)), 2),
        "hair": pick(styles), "hair_colour": pick(colours),
        "grey": round(float(np.clip(random.uniform(0.2, 1.2) * old, 0, 0.95)), 2),
        "beard": pick(BEARDS) if man else "none",
        "brows": round(float(random.uniform(0.9, 1.4) if man else random.uniform(0.65, 1.0)), 2),
        "makeup": 0.0 if man else round(float(random.uniform(0.0, 0.6)), 2),
        "eyes": pick(eyes), "teeth": round(float(random.uniform(0.3, 0.9)), 2),
        "clothes": pick(CLOTHES), "clothes_colour": pick(tuple(CLOTH_COLOURS)),
    }  # fmt: skip
    values.update(chosen)
    clipped = np.clip(np.asarray(values["coefficients"], np.float64), -CLIP, CLIP)
    values["coefficients"] = tuple(round(float(c), 4) for c in clipped)
    return Person(seed=seed, **values)


def read_person(path: Path) -> Person:
    """A person as `Person.as_json` wrote it; coefficients beyond `CLIP` are clipped."""
    table = read_json(path)
    if unknown := sorted(set(table) - {each.name for each in fields(Person)}):
        raise CaptureError(f"{path}: {unknown[0]!r} is no property of a person")
    try:
        coefficients = np.array(table["coefficients"], np.float64).reshape(-1)
        table["coefficients"] = tuple(np.clip(coefficients, -CLIP, CLIP).tolist())
        return Person(**table)
    except (ValueError, TypeError, KeyError) as error:
        raise CaptureError(f"{path}: not a person ({error})") from error
