"""Draw people of the face model as their cameras see them, a row each.

    python scripts/people_sheet.py docs/people.jpg --facekit ICT-FaceKit [person.json ...]

From the left: front, three quarters, profile, back, smiling, the eyes, astonished.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from pica_core.capture.person.choices import read_person
from pica_core.capture.person.model import read_model
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.stage.dome import aimed_camera
from pica_core.capture.stage.expressions import blend

PEOPLE = sorted((Path(__file__).resolve().parent / "people").glob("*.json"))
SIDE = 200
SMILE = blend(mouthSmile=0.8, jawOpen=0.2, cheekSquint=0.5, eyeSquint=0.3)
ASTONISHED = blend(jawOpen=0.9, browInnerUp=0.8, eyeWide=0.6)
VIEWS = (
    (blend(), 0, 0, "head"),
    (blend(), 40, 4, "head"),
    (blend(), -90, 4, "head"),
    (blend(), 180, 5, "head"),
    (SMILE, -15, 0, "head"),
    (blend(), 0, 2, "eyes"),
    (ASTONISHED, 0, 0, "head"),
)
"""Expression, azimuth and elevation in degrees, and what fills the picture."""


def main() -> None:
    """Draw all that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("people", nargs="*", type=Path, default=PEOPLE, help="person.json files")
    parser.add_argument("--facekit", type=Path, required=True, help="clone of ICT-FaceKit")
    options = parser.parse_args()
    model = read_model(options.facekit)
    rows = []
    for file in options.people:
        subject = PersonSubject(model, read_person(file)[0], bake_size=2048)
        row = []
        for expression, azimuth, elevation, part in VIEWS:
            subject.pose(expression)
            camera = aimed_camera(part, azimuth, elevation, part, width=2 * SIDE, height=2 * SIDE)
            picture = Image.fromarray(subject.draw(camera).image)
            row.append(picture.resize((SIDE, SIDE), Image.Resampling.BOX))
        subject.release()
        rows.append(np.hstack([np.asarray(picture) for picture in row]))
    Image.fromarray(np.vstack(rows)).save(options.out, quality=88)


if __name__ == "__main__":
    main()
