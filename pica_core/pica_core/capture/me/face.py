"""The face model at rest as a thing to be fitted, identity as a linear basis; and a fitted head of
a real person: what a scan comes to, and what is captured.

    vertices = mean + identity modes [100]      places on it = three vertices each

Where the 478 landmarks of the face networks lie on the model is stored beside this file. It was
measured (``scripts/make_landmarks.py``) on people of the model, drawn from several sides: a medoid
and its spread. Landmarks of the face's outline have a large spread, since the networks put them
where the outline of the *picture* is; those at eyes, nose and lips have half a millimetre.

Frames: everything of the model is in metres in our head frame (x to the subject's left, y up, z
forward, the middle between the eyeballs at ``EYES_AT_M``). A `Similarity` leads from there to the
frame of whatever the model is fitted to.

A fit is least squares, with the modes' own prior: coefficients of people are about N(0, 1).
Residuals are in metres, divided by ``noise_m``.

    fit -> `OwnHead` -> `OwnSubject` -> capture -> train -> export

The chain behind `OwnHead` is that of all people (`person.subject`). Skin wears the texture that the
fit made, on the model's own chart (`chart_uv`), over painted skin of the same tone: the texture's
alpha says how well each texel was seen, and what was not seen is painted in the colours of `look`.
"""

import functools
import io
import json
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.capture.dataset.files import read_arrays, write_archive
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import NUM_MODES, RIGHTS, FaceModel, Person, read_model
from pica_core.capture.person.subject import dress, paint
from pica_core.capture.rig.head import RigHead
from pica_core.capture.rig.names import map_names
from pica_core.capture.stage.paint import Growth
from pica_core.capture.stage.subject import Subject
from pica_core.capture.triangles import components
from pica_core.errors import CaptureError
from pica_core.types import Array, ByteArray, Float64Array, IntArray

LANDMARKS = 478
TABLE = Path(str(files("pica_core.capture.me") / "landmarks.npz"))
SPREAD_FLOOR_M = 0.0008
"""Landmarks are never trusted more than this: a pixel of the networks' crop is that wide."""
ROUNDS, ALL_COUNT = 10, 4
"""Turns of a fit between pose and shape, and how many of them trust every place alike."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Similarity:
    """Takes head-frame points to another frame: ``scale * rotation @ p + translation``.

    Attributes:
        scale: Units of the other frame per metre.
        rotation: ``[3, 3]``, a proper rotation.
        translation: In the other frame's units. ``[3]``.
    """

    scale: float
    rotation: Float64Array
    translation: Float64Array

    def apply(self, points_m: Float64Array) -> Float64Array:
        """Head frame to the other one. ``[..., 3]``."""
        return self.scale * points_m @ self.rotation.T + self.translation

    def undo(self, points: Float64Array) -> Float64Array:
        """The other frame to the head frame, metres. ``[..., 3]``."""
        return (points - self.translation) @ self.rotation / self.scale


def align(
    points_m: Float64Array, others: Float64Array, weights: Float64Array, scale: float | None = None
) -> Similarity:
    """The similarity that brings points ``[N, 3]`` nearest to others, weighted (Umeyama 1991); of
    this scale, if it is given."""
    share = (weights / weights.sum())[:, None]
    one, two = (share * points_m).sum(0), (share * others).sum(0)
    a, b = points_m - one, others - two
    u, size, v = np.linalg.svd((share * b).T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    rotation = u * sign @ v
    if scale is None:
        scale = float((size * sign).sum() / (share * a * a).sum())
    return Similarity(scale=scale, rotation=rotation, translation=two - scale * rotation @ one)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Places:
    """Fixed places on the face model, as a linear function of identity.

    Attributes:
        mean_m: Places on the mean head. ``[N, 3]``.
        identity_m: What each mode adds. ``[100, N, 3]``.
        noise_m: How far a measurement of each is off, standard deviation. ``[N]``.
    """

    mean_m: Float64Array
    identity_m: Float64Array
    noise_m: Float64Array

    def at(self, coefficients: Float64Array) -> Float64Array:
        """Where they are for one person, head frame of the mean, metres. ``[N, 3]``."""
        return self.mean_m + np.tensordot(coefficients, self.identity_m, 1)


@functools.cache
def landmark_table() -> dict[str, Array]:
    """What is known of the 478 landmarks of the face networks, see `scripts/make_landmarks.py`."""
    with np.load(TABLE) as stored:
        vertices = stored["vertices"]
        return {name: stored[name].astype(np.float64) for name in stored} | {"vertices": vertices}


def landmark_values(values: Array) -> Float64Array:
    """Values of the full model's vertices ``[..., P, C]`` at the landmarks. ``[..., 478, C]``."""
    table = landmark_table()
    corners = values[..., table["vertices"], :].astype(np.float64)
    return np.einsum("nk,...nkc->...nc", table["weights"], corners)


@functools.cache
def landmark_places() -> Places:
    """The 478 landmarks of the face networks on the full model."""
    model = read_model()
    return Places(
        mean_m=landmark_values(model.mean.rest_m),
        identity_m=landmark_values(model.modes_m),
        noise_m=np.maximum(landmark_table()["spread_m"], SPREAD_FLOOR_M),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Face:
    """A fitted face.

    Attributes:
        coefficients: Of the identity modes. ``[100]``.
        pose: From the head frame to the frame of what it was fitted to.
        residual_m: Distance of each place to what was measured. ``[N]``.
    """

    coefficients: Float64Array
    pose: Similarity
    residual_m: Float64Array


def fit_face(
    places: Places, measured: Float64Array, weights: Float64Array, *, scale: float | None = None
) -> Face:
    """Fit pose, size and identity to measured places.

    Args:
        measured: In any frame and unit. ``[N, 3]``.
        weights: How much each counts beside its noise, 0: not at all. ``[N]``.
        scale: Units per metre, where they are known; found if not.
    """
    coefficients = np.zeros(NUM_MODES)
    prior = np.full(NUM_MODES + 7, 1.0)
    prior[NUM_MODES:] = 1e-3
    if scale is not None:
        prior[-1] = 1e6
    robust, columns = weights.copy(), places.identity_m.reshape(NUM_MODES, -1).T
    for turn in range(ROUNDS):
        here = places.at(coefficients)
        pose = align(here, measured, robust / places.noise_m**2, scale)
        target = pose.undo(measured)
        if turn >= ALL_COUNT:  # from here on far places count less (Geman and McClure's weight)
            apart = np.linalg.norm(target - here, axis=1)
            robust = weights / (1 + (apart / (4 * places.noise_m)) ** 2) ** 2
        stiff = np.repeat(np.sqrt(robust) / places.noise_m, 3)
        # A little more turn, shift and size go along, so that neither waits for the other.
        rows = stiff[:, None] * np.concatenate([columns, -small_moves(target)], 1)
        right = stiff * (target - places.mean_m).ravel()
        solved = np.linalg.solve(rows.T @ rows + np.diag(prior**2), rows.T @ right)
        coefficients = np.asarray(solved[:NUM_MODES], np.float64)
    here = places.at(coefficients)
    pose = align(here, measured, robust / places.noise_m**2, scale)
    residual = np.linalg.norm(pose.undo(measured) - here, axis=1)
    return Face(coefficients=coefficients, pose=pose, residual_m=residual)


def small_moves(points: Float64Array) -> Float64Array:
    """How points move in small turns, shifts along the axes, and growth. ``[3 N, 7]``."""
    moves = [np.cross(axis, points) for axis in np.eye(3)]
    moves += [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    return np.stack([*moves, points], -1).reshape(-1, 7)


def head_faces(model: FaceModel, *parts: str) -> IntArray:
    """Triangles of some parts of the model. ``[F, 3]``."""
    return model.mean.faces[np.isin(model.mean.part, [MATERIALS.index(name) for name in parts])]


TEXTURE_SIZE = 1024
"""Side of a fitted head's texture, texels: 0.3 mm on the face (chosen)."""
CHART_SIDE = 1.075
ISLANDS = (
    (0.000, 0.000, 1.00), (0.683, 0.000, 0.55), (0.435, 0.700, 0.90), (0.683, 0.360, 1.00),
    (0.715, 0.360, 1.00), (0.000, 0.700, 0.80), (0.730, 0.700, 0.50), (0.850, 0.700, 0.50),
    (0.910, 0.700, 0.50),
)  # fmt: skip
"""Where on a square of this side the skin's islands go, and their scales: face, back of the head,
crown, two pieces of ears, shoulders, mouth, two eye sockets. On the model's own chart they lie on
top of each other."""
TOLD = ("look", "guessed", "source")
NERSEMBLE_FILMS = "films of NeRSemble v2"
"""A source that has a licence of its own."""
FILE = "me.npz"
"""A fitted head, in the folder of its making."""


def chart_uv(model: FaceModel) -> Float64Array:
    """Texture coordinates of the model with its skin spread over the texture; v downwards. ``[T,
    2]`` for ``model.mean.uv_faces``. Other parts keep theirs, and have no texture."""
    uv, mean = model.mean.uv.copy(), model.mean
    skin = mean.uv_faces[mean.part == MATERIALS.index("skin")]
    label = components(mean.uv_faces, len(uv))
    for island, (u, v, scale) in zip(np.unique(label[skin]), ISLANDS, strict=True):
        mine = label == island
        uv[mine] = ((uv[mine] - uv[mine].min(0)) * scale + [u, v]) / CHART_SIDE
    return uv


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OwnHead:
    """A fitted head.

    Attributes:
        rest_m: Vertices of the full face model (`read_model`), head frame, metres. ``[P, 3]``.
        texture: Skin on the model's chart, sRGB and how well each texel was seen, row 0 is v = 0.
            uint8 ``[S, S, 4]``.
        person: Hair, clothes, and choices for what nothing shows.
        look: Linear colours that were found, by the names of `stage.paint.PAINT` (``skin_rgb``,
            ``hair_rgb``, ``brow_rgb``, ``lip_rgb``, ``iris_rgb``); they go before the person's.
        guessed: What was not seen and is proposed, in words.
        source: What it was made of.
    """

    rest_m: Float64Array
    texture: ByteArray
    person: Person
    look: dict[str, tuple[float, ...]]
    guessed: tuple[str, ...] = field(default=())
    source: str = "a scan"

    @property
    def licence(self) -> str:
        """Licences of what is made of it."""
        owner = "NeRSemble v2's" if self.source == NERSEMBLE_FILMS else "the person's own"
        return f"{owner}; face model: {RIGHTS}"

    def write(self, path: Path) -> None:
        """Write it, as `read_head` reads it.

        Raises:
            CaptureError: The file cannot be written.
        """
        told = {"person": asdict(self.person), **{k: getattr(self, k) for k in TOLD}}
        stored = io.BytesIO()
        Image.fromarray(self.texture).save(stored, "PNG")
        write_archive(
            path,
            rest_m=self.rest_m,
            texture=np.frombuffer(stored.getvalue(), np.uint8),
            told=np.frombuffer(json.dumps(told).encode(), np.uint8),
        )


def read_head(path: Path) -> OwnHead:
    """Read a fitted head.

    Raises:
        CaptureError: It is none.
    """
    found = read_arrays(path)
    try:
        told = json.loads(found["told"].tobytes())
        person = told["person"]
        return OwnHead(
            rest_m=found["rest_m"].astype(np.float64),
            texture=np.asarray(Image.open(io.BytesIO(found["texture"].tobytes()))),
            person=Person(**person | {"coefficients": tuple(person["coefficients"])}),
            look={name: tuple(value) for name, value in told["look"].items()},
            guessed=tuple(told["guessed"]),
            source=str(told["source"]),
        )
    except (KeyError, ValueError, TypeError, OSError) as error:
        raise CaptureError(f"{path}: not a fitted head ({error})") from error


class OwnSubject(Subject):
    """A fitted head on the stage, whose further options are those of `Subject`."""

    def __init__(self, own: OwnHead, **options: Any) -> None:
        head, growth = own_rig(own)
        super().__init__(
            head,
            {
                "source": f"made from {own.source} of the person, who has agreed",
                "licence": own.licence,
                "guessed": list(own.guessed),
            },
            albedo={0: own.texture},
            look=paint(own.person) | own.look | {"over_paint": 1.0},
            growth=growth,
            **options,
        )


def own_rig(own: OwnHead) -> tuple[RigHead, Growth]:
    """The posable head, dressed, and its hair; seconds of work."""
    model = read_model()
    skin = model.mean.part == MATERIALS.index("skin")
    bare = replace(
        model.shaped(own.rest_m),
        material=np.where(skin, 0, -1).astype(np.int32),
        uv=chart_uv(model),
    )
    dressed, growth = dress(bare, own.person)
    moved = np.abs(dressed.motion_m).max((1, 2)) > 0
    names = map_names([name for name, moves in zip(ARKIT_NAMES, moved, strict=True) if moves])
    return RigHead(dressed, names, "me"), growth
