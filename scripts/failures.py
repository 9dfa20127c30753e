"""Where methods fail: train models on a small capture that is spoilt in known ways, and measure.

    python scripts/failures.py --out failures
    python scripts/chart.py --record failures scripts/failures.py --out failures

The capture, every model and what was measured of it stay in the folder; the same command goes on.
Held-out frames are compared with the true pictures through the true cameras. `sheet.jpg` shows one
frame by condition (rows) and model (columns, truth first).
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation
from torch import Tensor

from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.subject import PersonSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import AvatarModel, Surface
from pica_core.model.networks import sample_map
from pica_core.train.config import SMALL
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import ModelEvaluator, mse
from pica_core.train.train import open_trainer
from pica_core.types import Array, FloatArray

MODELS = ("full", "baseline", "linear")
NEAR = ("mouth", "eyes")
"""Cameras of three times the focal length, which no model is trained on."""
SIDE = 128
OPTIONS = RenderOptions(frames=48, cameras=8, size=f"{SIDE}x{SIDE}", seed=7)
CONFIG = replace(
    SMALL,
    mesh_source="tracked",
    depth=10.0,
    geometry_steps=60,
    joint_steps=120,
    joint_batch=1,
    driver_steps=0,
    pixels_per_image=2048,
    uv_encoding_size=128,
    axis_encoding_size=1000,
    texture_size=128,
)
SIGMAS, CODES = 6.0, 5
SHOWN = 2
"""Which held-out frame stands on the sheet."""
Spoil = Callable[[Path, Capture, np.random.Generator], None]


def wrong_cameras(folder: Path, capture: Capture, random: np.random.Generator) -> None:
    """A fifth of cameras, one of five: turned by one degree, and moved by one centimetre."""
    turn = Rotation.from_rotvec([0, np.radians(1), 0]).as_matrix()
    cameras = [
        replace(c, rotation=turn @ c.rotation, translation_m=turn @ c.translation_m + [0.01, 0, 0])
        if c.name == "left"
        else c
        for c in capture.cameras
    ]
    multiface.write_aside(folder / multiface.KRT, multiface.krt_text(cameras).encode())


def missing_images(folder: Path, capture: Capture, random: np.random.Generator) -> None:
    """30 % of the images."""
    for path in sorted((folder / "images").glob("*/*/*.png")):
        if random.random() < 0.3:
            path.unlink()


def depth_outliers(folder: Path, capture: Capture, random: np.random.Generator) -> None:
    """30 % of the depths off by up to three centimetres."""
    for path in sorted((folder / "depth").glob("*/*/*.png")):
        depth = np.array(Image.open(path)).astype(np.int32)
        off = random.integers(-300, 300, depth.shape) * (random.random(depth.shape) < 0.3)
        spoilt = np.where(depth > 0, depth + off, 0).astype(np.uint16)
        Image.fromarray(spoilt).save(path)


def unsteady_tracking(folder: Path, capture: Capture, random: np.random.Generator) -> None:
    """Each frame's mesh off by 2 mm and 1 degree, held-out ones, too."""
    for frame in capture.frames:
        turn = Rotation.from_rotvec(np.radians(random.normal(0, 1, 3))).as_matrix()
        mesh = capture.vertices_m(frame) @ turn.T + random.normal(0, 0.002, 3)
        data = (multiface.MILLIMETRES * mesh).astype("<f4").tobytes()
        multiface.write_aside(
            folder / multiface.part_path("tracked_mesh", frame.segment, frame.name), data
        )


def few_frames(folder: Path, capture: Capture, random: np.random.Generator) -> None:
    """16 frames of 41: the others have no mesh."""
    frames = list(capture.frames_of("train"))
    kept = {frames[at] for at in np.linspace(0, len(frames) - 1, 16).round().astype(int)}
    for frame in frames:
        if frame not in kept:
            (folder / multiface.part_path("tracked_mesh", frame.segment, frame.name)).unlink()


SPOILT: dict[str, Spoil] = {
    "right data": lambda folder, capture, random: None,
    "wrong cameras": wrong_cameras,
    "missing images": missing_images,
    "depth outliers": depth_outliers,
    "unsteady tracking": unsteady_tracking,
    "few frames": few_frames,
    "both gradient paths": lambda folder, capture, random: None,
}


def open_second_path(model: AvatarModel) -> None:
    """Let image losses move vertices through the pixel decoder's input, too (paper A.3)."""
    assert isinstance(model, PixelCodecAvatar)

    def shade(appearance: Tensor, surface: Surface) -> Tensor:
        codes = sample_map(appearance, surface.uv).flatten(0, 1)
        xyz_m, uv = surface.xyz_m.flatten(0, 1), surface.uv.flatten(0, 1)
        colours: Tensor = model.pixel_decoder(codes, xyz_m, uv)
        return colours.view(surface.xyz_m.shape)

    model.shade = shade  # type: ignore[method-assign]


def spoilt_capture(out: Path, condition: str) -> Path:
    """A copy of the capture, spoilt; always the same."""
    true, folder = out / "capture", out / condition.replace(" ", "_")
    if not (true / multiface.CAPTURE).is_file():
        render_subject(lambda: PersonSubject(draw_person(7), coarse=True), OPTIONS, true)
    if not (folder / "done").exists():
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(true, folder)
        for camera in NEAR:
            for path in (folder / "images").glob(f"*/{camera}"):
                shutil.rmtree(path)
        SPOILT[condition](folder, Capture.open(true), np.random.default_rng(0))
        (folder / "done").touch()
    return folder


def measure(out: Path, condition: str, variant: str, seed: int) -> dict[str, Any]:
    """Train a model, and measure it: the MSE from the evaluation views and from near, how far
    vertices are off, and what codes far from all others give."""
    data = TrainingData(Capture.open(spoilt_capture(out, condition)))
    true = Capture.open(out / "capture")
    found: dict[str, list[float]] = {"mse": [], "near": [], "off_mm": []}
    config = replace(CONFIG, variant=variant, seed=seed)
    with open_trainer(data, config, out / "runs" / f"{condition} {variant} {seed}") as trainer:
        if condition == "both gradient paths":
            open_second_path(trainer.model)
        trainer.run()
        evaluator = ModelEvaluator(data, trainer.model, trainer.rasteriser)
        for index in data.test_frames:
            frame, latent = data.capture.frames[index], evaluator.latent(index, "encoder")
            vertices_m, wanted_m = evaluator.vertices_m(latent), true.true_vertices_m(frame)
            if trainer.model.topology == "tracked":
                wanted_m = wanted_m[true.dense_vertex]
            apart_m = np.linalg.norm(vertices_m - wanted_m, axis=1)
            found["off_mm"].append(1000 * float(apart_m.mean()))
            for view in (*data.images.evaluation_views, *NEAR):
                camera, image = true.head_camera(frame, view), true.image(frame, view)
                picture = evaluator.draw(latent, camera, vertices_m=vertices_m)
                error = mse(picture.colours, image.reshape(-1, 3)[picture.pixels])
                found["near" if view in NEAR else "mse"].append(error)
                if seed == 0 and index == data.test_frames[SHOWN]:
                    keep(out, condition, view, variant, picture.on(0 * image))
                    keep(out, condition, view, "truth", image)
        row = {name: float(np.mean(errors)) for name, errors in found.items()}
        for number, (moved_mm, shown) in enumerate(far_codes(evaluator)):
            found.setdefault("moved_mm", []).append(moved_mm)
            if seed == number == 0:
                keep(out, condition, "6 sigma", variant, shown)
        row["moved_mm"] = float(np.median(found["moved_mm"]))
    return {"condition": condition, "model": variant, "seed": seed, **row}


def far_codes(evaluator: ModelEvaluator) -> Iterator[tuple[float, FloatArray]]:
    """How far codes at `SIGMAS` deviations from their mean move the vertex that moves most, mm, and
    their pictures."""
    data = evaluator.data
    latents = torch.cat([evaluator.latent(frame, "encoder") for frame in data.train_frames])
    mean, deviation = latents.mean(0), latents.std(0)
    rest_m = evaluator.vertices_m(mean[None])
    camera = data.images.camera(0, "front")
    random = np.random.default_rng(0)
    for _ in range(CODES):
        signs = torch.from_numpy(random.choice((-1, 1), mean.shape))
        latent = (mean + SIGMAS * deviation * signs)[None]
        away_m = np.linalg.norm(evaluator.vertices_m(latent) - rest_m, axis=1)
        shown = evaluator.draw(latent, camera).on(np.zeros((SIDE, SIDE, 3)))
        yield 1000 * float(away_m.max()), shown


def keep(out: Path, condition: str, view: str, name: str, shown: Array) -> None:
    """Write a picture for the sheet."""
    path = picture_path(out, condition, view, name)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(shown.round().astype(np.uint8)).save(path)


def picture_path(out: Path, condition: str, view: str, name: str) -> Path:
    """Where `keep` writes."""
    return out / "pictures" / f"{condition} {view} {name}.png"


def draw_sheet(out: Path) -> None:
    """Lay the pictures side by side."""
    rows = [(condition, "left") for condition in SPOILT]
    rows += [("right data", "mouth"), ("right data", "6 sigma")]
    columns = ("truth", *MODELS)
    sheet = Image.new("RGB", (SIDE * len(columns), SIDE * len(rows)))
    for at, (condition, view) in enumerate(rows):
        for column, name in enumerate(columns):
            path = picture_path(out, condition, view, name)
            if path.exists():
                sheet.paste(Image.open(path), (SIDE * column, SIDE * at))
    sheet.save(out / "sheet.jpg", quality=90)


def main() -> None:
    """Do what is left, and print the result as the last line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    out: Path = options.out
    torch.set_num_threads(1)
    done = out / "rows.jsonl"
    rows = [json.loads(line) for line in done.read_text().splitlines()] if done.exists() else []
    rows = [row for row in rows if row["seed"] < options.seeds]
    known = {(row["condition"], row["model"], row["seed"]) for row in rows}
    for seed, condition, model in product(range(options.seeds), SPOILT, MODELS):
        is_idle = condition == "both gradient paths" and model != "full"  # they have one path
        if not is_idle and (condition, model, seed) not in known:
            rows.append(measure(out, condition, model, seed))
            print(rows[-1], file=sys.stderr, flush=True)
            with done.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    draw_sheet(out)
    print(json.dumps({"rows": rows}))


if __name__ == "__main__":
    main()
