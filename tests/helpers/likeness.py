"""Whom of 50 drawn people a fitted head is most like, without a network that knows faces.

Its landmarks differ from those of the average face in a direction, whatever its size: fits keep
about 0.4 of how far. Beside it count the colours of skin, lips, brows, irises and hair, each by how
well photos show it. Numbers were fixed on other people than 304 to 306.
"""

import functools
from typing import Any

import numpy as np

from pica_core.capture.me.face import OwnHead, align, landmark_values
from pica_core.capture.person.choices import HAIR_COLOURS, Person, draw_person, read_model
from pica_core.capture.person.subject import paint
from pica_core.types import Float64Array

PEOPLE = range(301, 351)
TURN = 0.3
"""By how much the cosine of a head's direction to its person's usually lacks of 1."""
COLOURS = {"skin_rgb": 0.1, "lip_rgb": 0.12, "brow_rgb": 0.2, "iris_rgb": 0.2, "hair_rgb": 0.3}
"""Usual difference of each colour's logarithm."""


def likeness_order(head: OwnHead) -> list[int]:
    """Seeds of the people, the most alike first."""
    shape = direction(landmark_values(head.rest_m))

    def apart(seed: int) -> float:
        person, other = drawn(seed)
        return ((1 - float(shape @ other)) / TURN) ** 2 + colour_distance(head, person)

    return sorted(PEOPLE, key=apart)


@functools.cache
def drawn(seed: int) -> tuple[Person, Float64Array]:
    """A person, and where its landmarks lie from the average face's."""
    person, (mean, modes) = draw_person(seed), landmark_model()
    return person, direction(mean + np.tensordot(person.coefficients, modes, 1))


@functools.cache
def landmark_model() -> tuple[Float64Array, Float64Array]:
    """Landmarks of the average face, and what each mode adds."""
    model = read_model()
    return landmark_values(model.mean.rest_m), landmark_values(model.modes_m)


def direction(landmarks: Float64Array) -> Float64Array:
    """Of the difference of landmarks from the average face's. ``[3 * 468]``."""
    mean = landmark_model()[0][:468]
    places = align(landmarks[:468], mean, np.ones(468)).apply(landmarks[:468])
    return (places - mean).ravel() / np.linalg.norm(places - mean)


def colour_distance(head: OwnHead, person: Person) -> float:
    """Sum of the squares of differences, in their usual ones."""
    look: dict[str, Any] = paint(person)
    hair, grey = np.array(look["hair_rgb"]), np.array(HAIR_COLOURS["grey"])
    look["hair_rgb"] = hair + (grey - hair) * person.grey
    total = 0.0
    for name, usual in COLOURS.items():
        off = 0.0
        if name == "hair_rgb" and "bald" in (head.person.hair, person.hair):
            off = float(head.person.hair != person.hair)
        elif name in head.look:
            one, other = (np.log(np.array(each) + 0.01) for each in (head.look[name], look[name]))
            off = float(np.abs(one - other).mean())
        total += (off / usual) ** 2
    return total
