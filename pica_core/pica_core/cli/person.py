"""`pica capture person`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pica_core.capture.dataset.multiface import write_aside
from pica_core.capture.person.choices import (
    CLIP,
    NAMED,
    Person,
    draw_person,
    read_coefficients,
    read_person,
)
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.cli.capture import RenderArguments, baked_side
from pica_core.errors import CaptureError

FILE = "person.json"


@dataclass(frozen=True, kw_only=True, slots=True)
class PersonOptions(RenderArguments):
    """Options of `pica capture person`. What is not named is drawn from the seed."""

    lenses: str = "mixed"
    """mixed: some cameras look at mouth and eyes from near; one: all have one lens and look at the
    head, as in the paper's dome."""
    person: Path | None = None
    """A person.json: makes that person again."""
    coefficients: Path | None = None
    """JSON list of up to 100 coefficients of the identity modes, instead of drawn ones."""
    sex: str | None = None
    """female or male."""
    age: int | None = None
    """Years, 18 to 90."""
    skin: float | None = None
    """Tone of the skin, 1 (lightest) to 6 (darkest)."""
    hair: str | None = None
    """bald, buzz, short, swept, parted, receding, curly, afro, bob, long or tied."""
    hair_colour: str | None = None
    """black, brown, light_brown, blond, red, grey or white."""
    beard: str | None = None
    """none, stubble, moustache, goatee, short or full."""
    eyes: str | None = None
    """brown, dark, hazel, green, blue or grey."""
    clothes: str | None = None
    """tee, vneck, shirt, turtleneck or hoodie."""
    clothes_colour: str | None = None
    """white, charcoal, navy, burgundy, olive, teal, ochre, sand or lilac."""

    def choose(self) -> tuple[Person, int]:
        """The person that is meant, and how many coefficients were clipped."""
        names = (*NAMED, "age", "skin")
        chosen = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if self.person is not None:
            if chosen or self.coefficients is not None:
                named = [*chosen, "coefficients"][0]
                raise CaptureError(f"--person says all; leave out --{named.replace('_', '-')}")
            return read_person(self.person)
        clipped = 0
        if self.coefficients is not None:
            chosen["coefficients"], clipped = read_coefficients(self.coefficients)
        return draw_person(self.seed, **chosen), clipped


def person(options: PersonOptions) -> dict[str, Any]:
    """Render a person of the face model into a capture directory."""
    stage = RenderOptions(lenses=options.lenses, **options.values())
    console = Console(stderr=True, highlight=False)
    who, clipped = options.choose()
    if clipped:
        console.print(f"{clipped} coefficients were beyond {CLIP:g} and were clipped")
    console.print(
        f"{who.sex}, {who.age} years, skin {who.skin:g}, hair {who.hair} {who.hair_colour}, "
        f"beard {who.beard}, eyes {who.eyes}, {who.clothes} {who.clothes_colour}"
    )
    notes: list[str] = []

    def make() -> PersonSubject:
        subject = PersonSubject(who, bake_size=baked_side(stage))
        for note in subject.notes:
            console.print(note)
        notes.extend(subject.notes)
        return subject

    made = options.render(console, lambda show: render_subject(make, stage, options.out, show))
    write_aside(options.out / FILE, who.as_json().encode())
    return made | {
        "notes": notes,
        "clipped": clipped,
        "largest_coefficient": float(np.abs(who.coefficients).max()),
        "person": str(options.out / FILE),
    }
