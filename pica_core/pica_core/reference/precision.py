"""What an avatar loses when its file stores it in fewer bits: error, and flicker.

The avatar as it is in memory is the truth. Stored and read back, it decodes the frames of a
sentence again; colours and positions are compared at every vertex of the mesh, seen from the front.
Flicker is the change of the colour error from one frame to the next: an error that stays put is a
slightly other face, one that jumps is seen at once, and a mean over single frames tells neither
from the other.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar, save_avatar
from pica_core.avatar.storage import Precision, storage_of
from pica_core.capture.stage.expressions import sentence
from pica_core.reference.decoders import FRONT, decode_expression_map, decode_position_map
from pica_core.reference.pixel import decode_pixels
from pica_core.reference.sampling import sample_bilinear
from pica_core.types import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class PrecisionCost:
    """What one way of storing an avatar costs."""

    precision: Precision
    bytes: int
    """Size of the file."""
    mse: float
    """Mean squared error of colours against the avatar in memory, on 0-255."""
    flicker_mse: float
    """Mean square of the colour error's change from frame to frame, on 0-255."""
    position_error_um: float
    """Mean distance of vertices, micrometres."""


def measure_precisions(avatar: Avatar, frames: int = 8, seed: int = 0) -> list[PrecisionCost]:
    """Store an avatar in every precision and look what comes back.

    Args:
        avatar: The truth; best one whose file was stored as float32.
        frames: How many consecutive frames, at 30 a second. Each takes seconds.
    """
    arkit = sentence(np.random.default_rng(seed), frames)
    latents = ExpressionEncoder(avatar).encode(arkit)
    colours, positions = _decode(avatar, latents)
    found: list[PrecisionCost] = []
    with tempfile.TemporaryDirectory() as folder:
        for precision in get_args(Precision):
            path = Path(folder) / f"{precision}.pica"
            save_avatar(path, avatar, storage_of(precision, avatar.tensors))
            stored = load_avatar(path)
            sent = ExpressionEncoder(stored).encode(arkit)
            found_colours, found_positions = _decode(stored, sent)
            error = 255 * (found_colours - colours)
            distance = np.linalg.norm(found_positions - positions, axis=-1)
            found.append(
                PrecisionCost(
                    precision=precision,
                    bytes=path.stat().st_size,
                    mse=float(np.square(error).mean()),
                    flicker_mse=float(np.square(np.diff(error, axis=0)).mean()),
                    position_error_um=float(1e6 * distance.mean()),
                )
            )
    return found


def _decode(avatar: Avatar, latents: Array) -> tuple[Array, Array]:
    """Colours ``[T, V, 3]`` in 0..1 and positions in metres ``[T, V, 3]`` of every vertex."""
    uv, full = avatar.tensors["mesh.vertex_uv"], avatar.spec.map_size
    colours, positions = [], []
    for latent in latents:
        vertices_m = avatar.vertices_of(decode_position_map(avatar, latent), full)
        codes = sample_bilinear(decode_expression_map(avatar, latent, FRONT), uv)
        rgb = decode_pixels(avatar.spec, avatar.tensors, codes, vertices_m, uv)
        colours.append(np.clip(rgb, 0, 1))
        positions.append(vertices_m)
    return np.stack(colours), np.stack(positions)
