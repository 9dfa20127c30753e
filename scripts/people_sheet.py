"""Draw people of the face model as their cameras see them, a row each.

    python scripts/people_sheet.py docs/people.jpg --facekit ICT-FaceKit [person.json ...]
    python scripts/people_sheet.py docs/expressions.jpg --facekit ICT-FaceKit --expressions

From the left: front, three quarters, profile, back, smiling, the eyes, astonished. With
--expressions: twelve expressions, and eyes and mouth from near.
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
SIDES = {False: 200, True: 160}
"""Rows and columns of each picture, pixels; with --expressions."""
FACE = (0.16, 0.1, 0.84, 0.78)
"""Left, top, right and bottom of the face in a picture of the head, as shares of its side."""
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
EXPRESSIONS = (
    *((expression, azimuth, 0, "head") for expression, azimuth in (
        (SMILE, 10),
        (blend(mouthSmile=1.0, cheekSquint=0.9, eyeSquint=0.6, jawOpen=0.4, mouthUpperUp=0.5), -9),
        (ASTONISHED, 0),
        (blend(mouthFrown=0.9, browInnerUp=0.8, mouthShrugLower=0.5, eyeLookDown=0.3), 10),
        (blend(browDown=1.0, noseSneer=0.6, mouthPress=0.5, eyeSquint=0.5), 0),
        (blend(noseSneer=1.0, mouthUpperUp=0.9, browDown=0.5, mouthFrown=0.3), -15),
        (blend(mouthPucker=1.0, browOuterUp=0.5), 15),
        (blend(mouthFunnel=0.9, jawOpen=0.35), 0),
        (blend(cheekPuff=1.0, mouthPress=0.3), -15),
        (blend(eyeBlink=1.0), 0),
        (blend(eyeLookOutLeft=0.9, eyeLookInRight=0.9, mouthLeft=0.7, jawLeft=0.4), 0),
        (blend(mouthRollLower=0.8, mouthRollUpper=0.8, eyeLookUp=0.7, browInnerUp=0.4), 0),
    )),
    (blend(eyeLookOutLeft=0.4, eyeLookInRight=0.4), 0, 2, "eyes"),
    (blend(jawOpen=0.5, mouthSmile=0.5, mouthUpperUp=0.4, mouthLowerDown=0.3), 0, 0, "mouth"),
)  # fmt: skip
"""Smile, laugh, astonishment, grief, anger, disgust, pucker, funnel, puffed cheeks, closed eyes, a
glance aside, lips rolled in; then eyes and mouth."""


def main() -> None:
    """Draw all that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("people", nargs="*", type=Path, default=PEOPLE, help="person.json files")
    parser.add_argument("--facekit", type=Path, required=True, help="clone of ICT-FaceKit")
    parser.add_argument("--expressions", action="store_true", help="twelve expressions instead")
    options = parser.parse_args()
    views, side = EXPRESSIONS if options.expressions else VIEWS, SIDES[options.expressions]
    model = read_model(options.facekit)
    rows = []
    for file in options.people:
        subject = PersonSubject(model, read_person(file)[0], bake_size=2048)
        row = []
        for expression, azimuth, elevation, part in views:
            subject.pose(expression)
            camera = aimed_camera(part, azimuth, elevation, part, width=2 * side, height=2 * side)
            picture = Image.fromarray(subject.draw(camera).image)
            if options.expressions and part == "head":
                left, top, right, bottom = (2 * side * share for share in FACE)
                picture = picture.crop((left, top, right, bottom))
            row.append(picture.resize((side, side), Image.Resampling.BOX))
        subject.release()
        rows.append(np.hstack([np.asarray(picture) for picture in row]))
    Image.fromarray(np.vstack(rows)).save(options.out, quality=88)


if __name__ == "__main__":
    main()
