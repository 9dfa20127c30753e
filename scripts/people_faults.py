"""Count folds and parts that poke out for people of the face model, as docs/people.md shows.

python scripts/people_faults.py --facekit ICT-FaceKit [--seeds 20] [--combinations 1000]
    [--recording FILE.csv] [--first 0] [--worst FOLDER]

Every person is posed at each of the 52 shapes at 1, at 25 blinks that are half-way, and at
combinations: half of them from takes as training has them, half (evenly spread) from a real Live
Link Face recording, where one is given.
Nothing is drawn, but for the worst pose of each kind with `--worst`. Prints a row per seed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from pica_client.sources.livelink_csv import load_livelink_csv
from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.camera import look_at
from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.dress import dress
from pica_core.capture.person.model import FaceModel, read_model
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.rig.mesh import build_mesh
from pica_core.capture.rig.names import map_names
from pica_core.capture.stage.expressions import blend, sample_takes

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from helpers.mesh_faults import MeshChecks

SEED = 7
KINDS = ("folded", "eyes", "teeth", "through")


def half_blinks() -> npt.NDArray[np.float64]:
    """Lids on their way, over eyes that look ahead, up, down and aside, and squint. ``[25, 52]``"""
    also: tuple[dict[str, float], ...] = (
        {}, {"eyeLookUp": 0.6}, {"eyeLookDown": 0.6}, {"eyeLookOut": 0.6}, {"eyeSquint": 0.7},
    )  # fmt: skip
    closed = (0.2, 0.35, 0.5, 0.65, 0.8)
    return np.stack([blend(eyeBlink=share, **more) for share in closed for more in also])


def combinations(count: int, recording: Path | None) -> npt.NDArray[np.float64]:
    """Expressions ``[count, 52]``."""
    made = np.concatenate([take.arkit for take in sample_takes(count, SEED)]).astype(np.float64)
    if recording is None:
        return made[:count]
    real = load_livelink_csv(recording).arkit
    spread = np.linspace(0, len(real) - 1, count // 2).astype(int)
    return np.concatenate([made[::2][: count - len(spread)], real[spread]])


def count(model: FaceModel, seed: int, mixed: npt.NDArray[np.float64], worst: Path | None) -> None:
    """Print the row of one seed; draw its worst pose of each kind."""
    person = draw_person(seed, model.sex_direction())
    source = model.person(person.coefficients)
    mesh = dress(build_mesh(source, map_names(list(source.shapes))), person).mesh
    checks = MeshChecks(mesh)
    groups = (np.eye(NUM_ARKIT), half_blinks(), mixed)
    poses = np.concatenate(groups)
    found = [checks.faults(each) for each in poses]
    table = np.array([[getattr(each, kind) for kind in KINDS] for each in found])
    ends = np.cumsum([len(group) for group in groups])
    sums = [" + ".join(map(str, part.sum(0))) for part in np.split(table, ends[:-1])]
    look = f"{person.hair}, {person.beard}, {person.clothes}"
    bad = int((table[ends[-2] :].sum(1) > 0).sum())
    at_rest = int(checks.folded_at_rest.sum())
    print(f"| {seed} | {look} | {at_rest} | {' | '.join(sums)} | {bad} |", flush=True)
    shapes = table[:NUM_ARKIT]
    for k, kind in enumerate(KINDS):
        names = {ARKIT_NAMES[j]: int(shapes[j, k]) for j in np.flatnonzero(shapes[:, k])}
        if names:
            print(f"  {kind}: {names}", file=sys.stderr, flush=True)
    if worst is None or not table.any():
        return
    subject = PersonSubject(model, person, bake_size=1024, self_shadow=False)
    for k in np.flatnonzero(table.any(0)).tolist():
        pose = poses[int(table[:, k].argmax())]
        points = checks.pose(pose)
        places = (checks.folds(points), *checks.pokes(points))[k]
        target = places[np.linalg.norm(places - np.median(places, 0), axis=1).argmin()] / 1000
        centre = target + 0.16 * (target - [0, target[1], -0.03]) / np.linalg.norm(target)
        subject.pose(pose)
        tiles = [
            subject.draw(
                look_at(name="", centre_m=np.array(at), target_m=np.array(to), vertical_fov=fov,
                        width=512, height=512)
            ).image
            for at, to, fov in ((centre, target, 0.35), ((0.0, 0.0, 1.0), (0.0, -0.01, 0.0), 0.36))
        ]  # fmt: skip
        Image.fromarray(np.concatenate(tiles, 1)).save(worst / f"{seed}_{KINDS[k]}.png")
    subject.release()


def main() -> None:
    """Count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--facekit", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--combinations", type=int, default=1000)
    parser.add_argument("--recording", type=Path)
    parser.add_argument("--worst", type=Path)
    options = parser.parse_args()
    if options.worst:
        options.worst.mkdir(parents=True, exist_ok=True)
    model, mixed = (
        read_model(options.facekit),
        combinations(options.combinations, options.recording),
    )
    kinds = "folds + eyes + teeth + skin through"
    print(
        f"| seed | hair, beard, clothes | folded at rest | full shapes: {kinds} "
        "| half blinks | combinations | combinations with a fault |"
    )
    print("|---|---|---|---|---|---|---|")
    for seed in range(options.first, options.first + options.seeds):
        count(model, seed, mixed, options.worst)


if __name__ == "__main__":
    main()
