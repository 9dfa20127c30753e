"""Draw docs/limits.png: faces under growing trouble, and at falling bitrates.

python scripts/limits_sheet.py [SOURCE [AVATAR]]

Each cell shows two faces: the true one at the moment that the display means to show, and the one
that it shows. The moment is that of the 95th percentile of the rendered error in the troubled third
of a run, so nineteen of twenty moments look better. Policy: the receiver's own.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from PIL import Image

from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.head import FaceRenderer
from pica_client.bench.network.scenarios import BY_NAME
from pica_client.bench.network.stream_trial import Face, Schedule, deliver, play
from pica_client.bench.playout import true_face
from pica_client.playout.buffer import Playout
from pica_client.render.drawing import drawn_mse
from pica_client.stats import percentile
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_sample import LatentSample, ReceivedFrame
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, StreamConfig

OUT = Path(__file__).resolve().parent.parent / "docs" / "limits.png"
SIZE_PX = 240
RENDERS_PER_S = 5
MAX_COLOURS = 160
SCHEDULE = Schedule(seconds=30.0)
ROWS = (
    ("jitter", ("jitter-0", "jitter-20", "jitter-80", "jitter-200")),
    ("stalls", ("stall-100", "stall-300", "stall-1000")),
    ("TCP segments lost", ("retransmit-1", "retransmit-5")),
    ("datagrams lost", ("loss-1", "loss-5", "loss-10", "loss-30")),
    ("dropped by the relay", ("thin-5", "thin-10", "thin-30")),
    ("rate of the way", ("rate-64", "rate-32", "rate-16")),
)
QUALITIES = (7, 5, 3, 1)

matplotlib.use("agg")


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """One pair of faces."""

    title: str
    true: npt.NDArray[np.uint8]
    shown: npt.NDArray[np.uint8]


def main() -> None:
    """Run, render, write."""
    source = sys.argv[1] if len(sys.argv) > 1 else "performance:talk"
    library = AvatarLibrary()
    name = sys.argv[2] if len(sys.argv) > 2 else library.names[0]
    avatar = library.load(library.find(name))
    library.close()
    face = true_face(source, avatar)
    with FaceRenderer(avatar, size_px=SIZE_PX, views=("front",)) as renderer:
        rows = [
            (label, [_network_cell(name, face, avatar, renderer) for name in names])
            for label, names in ROWS
        ]
        cells = [_quality_cell(quality, face, avatar, renderer) for quality in QUALITIES]
        rows.append(("bitrate, no trouble", cells))
    figure = _draw(rows, f"{source}, synthetic avatar {avatar.manifest.name}")
    file = io.BytesIO()
    figure.savefig(file, dpi=100)
    picture = Image.open(file).convert("RGB").quantize(MAX_COLOURS)
    picture.save(OUT, optimize=True)
    print(f"wrote {OUT}, {OUT.stat().st_size / 1e3:.0f} kB")


def _ends(avatar: Avatar, **config: Any) -> tuple[LatentEncoder, LatentDecoder]:
    profile = avatar.stream_profile()
    if profile is None:
        sys.exit(f"avatar {avatar.manifest.name} has no stream profile")
    return LatentEncoder(profile, StreamConfig(**config)), LatentDecoder(profile)


def _network_cell(name: str, face: Face, avatar: Avatar, renderer: FaceRenderer) -> Cell:
    delivery = deliver(face, _ends(avatar), BY_NAME[name], SCHEDULE)
    ticks = play(delivery, Playout(), SCHEDULE)
    pairs = []
    for tick in ticks[:: round(SCHEDULE.display_hz / RENDERS_PER_S)]:
        if SCHEDULE.begin_s <= tick.now_s < SCHEDULE.end_s and tick.played is not None:
            meant_s = tick.now_s - delivery.base_delay_s - tick.report.delay_s
            pairs.append((face(meant_s), tick.played.sample))
    scenario = BY_NAME[name]
    return _cell(f"{scenario.level:g} {scenario.unit}", pairs, renderer)


def _quality_cell(quality: int, face: Face, avatar: Avatar, renderer: FaceRenderer) -> Cell:
    encoder, decoder = _ends(avatar, quality=quality)
    pairs: list[tuple[LatentSample, LatentSample]] = []
    sent = num_bytes = 0
    for index in range(round(SCHEDULE.seconds * SCHEDULE.fps)):
        true = face(index / SCHEDULE.fps)
        time_us = round(index / SCHEDULE.fps * 1e6)
        frame = encoder.encode(true.latent, true.rotation, true.translation_m, time_us)
        if frame is None:
            continue
        read = decoder.receive(
            ReceivedFrame(sent, time_us, frame.layer, frame.is_keyframe, frame.payload)
        )
        sent += 1
        num_bytes += len(frame.payload)
        if index % round(SCHEDULE.fps / RENDERS_PER_S) == 0:
            pairs += [(true, each.sample) for each in read]
    kbps = num_bytes * 8 / SCHEDULE.seconds / 1e3
    return _cell(f"quality {quality}: {kbps:.1f} kbit/s", pairs, renderer)


def _cell(
    title: str, pairs: Iterable[tuple[LatentSample, LatentSample]], renderer: FaceRenderer
) -> Cell:
    """The pair at the 95th percentile of the error."""
    drawn = [tuple(map(renderer.draw_sample, pair)) for pair in pairs]
    errors = [drawn_mse(true, shown) for true, shown in drawn]
    true, shown = drawn[errors.index(percentile(sorted(errors), 95))]
    mean = float(np.mean(errors))
    rows, columns = np.nonzero(true.covered[0] | shown.covered[0])
    centre = (int(rows.min()) + int(rows.max())) // 2, (int(columns.min()) + columns.max()) // 2
    half = SIZE_PX * 3 // 10
    box = tuple(slice(max(middle - half, 0), max(middle - half, 0) + 2 * half) for middle in centre)
    return Cell(f"{title} · MSE {mean:.0f}", true.image[0][box], shown.image[0][box])


def _draw(rows: list[tuple[str, list[Cell]]], title: str) -> Figure:
    columns = max(len(cells) for _, cells in rows)
    figure, grid = plt.subplots(
        len(rows), columns, figsize=(2.5 * columns, 1.52 * len(rows) + 0.5), layout="constrained"
    )
    for axes, (label, cells) in zip(grid, rows, strict=True):
        for axis in axes:
            axis.axis("off")
        for axis, cell in zip(axes, cells, strict=False):
            axis.imshow(np.concatenate([cell.true, cell.shown], axis=1))
            axis.set_title(cell.title, fontsize=8, pad=2)
        axes[0].text(
            -0.04,
            0.5,
            label,
            rotation=90,
            va="center",
            ha="right",
            transform=axes[0].transAxes,
            fontsize=8,
        )
    figure.suptitle(
        "left true, right shown, at the 95th percentile of the error; MSE: mean over the trouble\n"
        f"{title}",
        fontsize=9,
    )
    return figure


if __name__ == "__main__":
    main()
