"""A fitted head of a real person: what a scan comes to, and what is captured.

    fit -> `OwnHead` -> `OwnSubject` -> capture -> train -> export

The chain behind `OwnHead` is that of all people (`person.subject`): lids and lips closed, hair and
clothes added, eyes, teeth and tongue painted. Skin wears the texture that the fit made, on the
model's own chart (`chart_uv`), over painted skin of the same tone: the texture's
alpha says how well each texel was seen, and what was not seen is painted in the colours of
`look`.
"""

import io
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.capture.dataset.files import read_arrays, write_archive
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import RIGHTS, FaceModel, Person, read_model
from pica_core.capture.person.subject import dress, paint
from pica_core.capture.rig.head import RigHead
from pica_core.capture.rig.names import map_names
from pica_core.capture.stage.paint import Growth
from pica_core.capture.stage.subject import Subject
from pica_core.capture.triangles import components
from pica_core.errors import CaptureError
from pica_core.types import ByteArray, Float64Array

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
    """

    rest_m: Float64Array
    texture: ByteArray
    person: Person
    look: dict[str, tuple[float, ...]]
    guessed: tuple[str, ...] = field(default=())

    def write(self, path: Path) -> None:
        """Write it, as `read_head` reads it.

        Raises:
            CaptureError: The file cannot be written.
        """
        told = {"person": asdict(self.person), "look": self.look, "guessed": self.guessed}
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
                "source": "made from a scan of the person, who has agreed",
                "licence": f"the person's own; face model: {RIGHTS}",
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
