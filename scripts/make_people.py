"""Make the people that ship as avatars: capture each from the face model.

    python scripts/make_people.py --facekit ICT-FaceKit --work work                # all six
    python scripts/make_people.py --facekit ICT-FaceKit --work work --names Nora   # one of them

A capture that is finished is left alone, and one that was stopped goes on.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

PEOPLE = {
    "Nora": "--seed 5 --sex female --age 30 --skin 2 --hair long --hair-colour light_brown "
    "--eyes blue --clothes shirt --clothes-colour navy",
    "Amara": "--seed 11 --sex female --age 27 --skin 5 --hair afro --hair-colour black "
    "--eyes brown --clothes hoodie --clothes-colour teal",
    "Elias": "--seed 8 --sex male --age 45 --skin 1.6 --hair swept --hair-colour brown "
    "--beard full --eyes hazel --clothes shirt --clothes-colour burgundy",
    "Yun": "--seed 21 --sex female --age 62 --skin 3 --hair tied --hair-colour black "
    "--eyes dark --clothes turtleneck --clothes-colour lilac",
    "Tariq": "--seed 17 --sex male --age 24 --skin 4.2 --hair curly --hair-colour black "
    "--beard stubble --eyes dark --clothes tee --clothes-colour ochre",
    "Henrik": "--seed 13 --sex male --age 68 --skin 1.5 --hair receding --hair-colour grey "
    "--beard none --eyes blue --clothes vneck --clothes-colour charcoal",
}
"""Name of each avatar, and the choices that make its person."""
STAGE = "--frames 384 --cameras 12 --size 448x448 --texture-size 512"


def main() -> None:
    """Capture who is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--facekit", type=Path, required=True, help="clone of ICT-FaceKit")
    parser.add_argument("--work", type=Path, required=True, help="captures")
    parser.add_argument("--names", nargs="*", default=list(PEOPLE), choices=list(PEOPLE))
    options = parser.parse_args()
    for name in options.names:
        out = options.work / name.lower() / "capture"
        if (out / "person.json").exists():
            continue
        words = ["--facekit", str(options.facekit), "--out", str(out), *STAGE.split()]
        command = ["capture", "person", *words, *PEOPLE[name].split()]
        subprocess.run([sys.executable, "-m", "pica_command", *command], check=True)


if __name__ == "__main__":
    main()
