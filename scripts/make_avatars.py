"""Make the avatars that ship: capture each person of the face model, train, export, draw.

    python scripts/make_avatars.py --work work                # all six
    python scripts/make_avatars.py --work work --names nora   # one of them
    python scripts/make_avatars.py --work work --fit-size     # size alone
    python scripts/make_avatars.py --work work --portraits    # pictures for the viewer's form alone

About twenty minutes each on a core. What is done is left alone and what was stopped goes on. The
people are described in `scripts/people`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, head_matrix, view_direction
from pica_client.render.seats import plan_seats
from pica_client.render.views import ViewState, plan_camera
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar, save_avatar
from pica_core.gl import create_context

HERE = Path(__file__).resolve().parent
PEOPLE = {file.stem: file for file in sorted((HERE / "people").glob("*.json"))}
FOLDER = HERE.parent / "pica_core" / "pica_core" / "avatars"
STAGE = "--frames 320 --cameras 10 --size 384x384"
MOST_BYTES = 4_000_000
PORTRAIT_PX = 128
TRAINING = "--variant linear --preset long --threads 1"
LICENCE = "Apache-2.0; face model ICT-FaceKit: MIT, (c) 2020 USC ICT"


def main() -> None:
    """Make what is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="captures and runs")
    parser.add_argument("--names", nargs="*", default=list(PEOPLE), choices=list(PEOPLE))
    parser.add_argument("--fit-size", action="store_true", help="bring files to their size alone")
    parser.add_argument("--portraits", action="store_true", help="draw the pictures alone")
    options = parser.parse_args()
    for name in options.names:
        if options.fit_size:
            fit_size(FOLDER / f"{name}.pica")
            continue
        if options.portraits:
            draw_portrait(FOLDER / f"{name}.pica")
            continue
        place = options.work / name
        if (place / "done").exists():
            continue
        make(name, place)
        (place / "done").touch()


def make(name: str, place: Path) -> None:
    """Make one avatar, as far as that is not done."""
    capture, run, file = place / "capture", place / "run", str(FOLDER / f"{name}.pica")
    if not (capture / "person.json").exists():
        words = ["--person", str(PEOPLE[name]), "--out", str(capture)]
        pica("capture", "person", *words, *STAGE.split())
    of = ["--capture", str(capture), "--out"]
    if not (run / "evaluation.json").exists():
        more = ["--resume"] if (run / "checkpoint.pt").exists() else []
        pica("train", *of, str(run), *TRAINING.split(), *more)
    words = ["--run", str(run), *of, file, "--licence", LICENCE, "--threads", "1"]
    pica("export", *words, "--name", name.title())
    fit_size(Path(file))
    pica("avatar", "info", file)
    draw_portrait(Path(file))


def fit_size(file: Path) -> None:
    """Leave out the directions of bases that move their region least, until a file is small."""
    while (excess := file.stat().st_size - MOST_BYTES) > 0:
        avatar = load_avatar(file)
        tensors = dict(avatar.tensors)
        mix, basis, rank = (tensors[f"linear.{name}"] for name in ("mix", "basis", "rank"))
        moved = np.square(mix).sum(1) * np.square(basis).sum((1, 2))
        bytes_each = basis[0].size + 2 * mix.shape[1]
        kept = np.sort(np.argsort(moved)[-(-excess // bytes_each) :])
        region = np.repeat(np.arange(len(rank)), rank)[kept]
        tensors["linear.mix"], tensors["linear.basis"] = mix[kept], basis[kept]
        tensors["linear.rank"] = np.bincount(region, minlength=len(rank)).astype(np.int32)
        print(f"{file}: {len(mix) - len(kept)} of {len(mix)} directions left out", file=sys.stderr)
        save_avatar(file, replace(avatar, tensors=tensors))


def draw_portrait(file: Path) -> None:
    """Draw an avatar at rest, from straight ahead, into a PNG file beside its own."""
    avatar, size = load_avatar(file), (PORTRAIT_PX, PORTRAIT_PX)
    seats = plan_seats("grid", 1, 1.0)
    camera = plan_camera(seats, ViewState(), *size)
    place = head_matrix(seats.seats[0], np.zeros(3), np.zeros(3))
    latent = ExpressionEncoder(avatar).encode(np.zeros(NUM_ARKIT, np.float32))
    maps = OnnxDecoder(avatar).decode(latent, view_direction(place, camera.centre_m))
    context = create_context()
    try:
        renderer = Renderer(context, size, RenderOptions(fade_busts=True))
        renderer.add_avatar("avatar", avatar)
        renderer.update_maps("avatar", maps.position_map, maps.expression_map)
        renderer.draw([Placement(slot="avatar", world_from_head=place)], camera)
        Image.fromarray(renderer.read_image()).save(file.with_suffix(".png"), optimize=True)
    finally:
        context.release()


def pica(*words: str) -> None:
    """Run a command, and stop where it fails."""
    print("pica", *words, file=sys.stderr)
    subprocess.run([sys.executable, "-m", "pica_command", *words], check=True)


if __name__ == "__main__":
    main()
