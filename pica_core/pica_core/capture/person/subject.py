"""A person on the stage: a rig of the face model, dressed and painted by what was chosen."""

import functools
from dataclasses import asdict
from typing import Any

import numpy as np

from pica_core.avatar.arkit import ARKIT_NAMES
from pica_core.capture.person.choices import (
    CLOTH_COLOURS,
    EYE_COLOURS,
    HAIR_COLOURS,
    SKIN_TONES,
    Person,
)
from pica_core.capture.person.dress import dress
from pica_core.capture.person.model import RIGHTS, read_model
from pica_core.capture.rig.head import RigHead
from pica_core.capture.rig.names import map_names
from pica_core.capture.stage.paint import Growth
from pica_core.capture.stage.subject import BAKE_SIZE, Subject

GREY = np.array((0.28, 0.27, 0.26))


def paint(person: Person) -> dict[str, Any]:
    """A person's colours and marks, as `appearance.frag` names them."""
    tone = np.stack(
        [np.interp(person.skin, np.arange(1, 7), np.array(SKIN_TONES)[:, k]) for k in range(3)]
    )
    light = float(np.interp(person.skin, [1, 6], [1.0, 0.25]))
    lips = tone * (0.80, 0.52, 0.55) + np.array((0.045, 0.0, 0.006)) * light
    hair = np.array(HAIR_COLOURS[person.hair_colour])
    faded = hair + (GREY - hair) * 0.75 * person.grey
    return {
        "seed": float(person.seed % 997) + 0.5,
        "skin_rgb": tuple(tone), "lip_rgb": tuple(lips), "hair_rgb": tuple(hair),
        "brow_rgb": tuple(np.minimum(0.8 * faded, 0.12)), "brows": person.brows,
        "iris_rgb": EYE_COLOURS[person.eyes], "redness": person.redness,
        "age": float(np.clip((person.age - 20) / 55, 0, 1.1)), "freckles": person.freckles,
        "moles": person.moles, "makeup": person.makeup, "grey": person.grey,
        "stubble": float({"none": 0.10 if person.sex == "male" else 0.0, "stubble": 0.85,
                          "moustache": 0.45, "goatee": 0.45}.get(person.beard, 0.3)),
        "cloth_rgb": CLOTH_COLOURS[person.clothes_colour],
        "cloth_knit": {"turtleneck": 1.0, "hoodie": 0.6}.get(person.clothes, 0.25),
        "tooth_white": person.teeth,
    }  # fmt: skip


class PersonSubject(Subject):
    """A person on the stage."""

    def __init__(
        self,
        person: Person,
        *,
        bake_size: int = BAKE_SIZE,
        self_shadow: bool = True,
        coarse: bool = False,
    ) -> None:
        head, growth = make_head(person, coarse=coarse)
        super().__init__(
            head,
            {
                "source": "synthetic: a person of ICT-FaceKit Light's modes, not a real one",
                "licence": RIGHTS,
                "person": asdict(person),
            },
            look=paint(person),
            growth=growth,
            bake_size=bake_size,
            self_shadow=self_shadow,
        )


@functools.lru_cache(maxsize=8)
def make_head(person: Person, *, coarse: bool = False) -> tuple[RigHead, Growth]:
    """The posable head of a person, seconds of work, and its hair; calls share them."""
    mesh = read_model(coarse=coarse).mesh(person.coefficients)
    dressed, growth = dress(mesh, person)
    moved = np.abs(mesh.motion_m).max((1, 2)) > 0
    names = map_names([name for name, moves in zip(ARKIT_NAMES, moved, strict=True) if moves])
    return RigHead(dressed, names, f"{person.sex}, {person.age}"), growth
