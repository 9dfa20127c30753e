"""A small avatar with random weights but the look of a head, for tests that need a valid one."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import EXIT_SIZES, STILL_NAME, exit_shapes, faces_name
from pica_core.avatar.linear import REGION
from pica_core.avatar.manifest import Manifest, ViewSpan
from pica_core.avatar.spec import (
    ENCODER_CHANNELS,
    EXPRESSION_CHANNELS,
    MAP_SIZE,
    PIXEL_CHANNELS,
    XYZ_CHANNELS,
    AvatarSpec,
    spec_tensor_shapes,
)
from pica_core.codec.latent_stream import LatentEncoder
from pica_core.types import LATENT_SHAPE, NUM_LATENT, FloatArray

PAPER_SPEC = AvatarSpec(block="H2")
"""The paper's sizes; H2 is the block whose parameter count lies nearest to the paper's 5.47 M."""

NUM_BASES, REACH_M = 6, 4e-3
NUM_STILL = 2
"""Regions of a toy's mesh that never move."""
TOY_SPEC = AvatarSpec(uv_encoding_size=64, axis_encoding_size=200)
"""The shipped sizes but for smaller encoding maps: files of 1 MB, tests of milliseconds."""


def head_surface(u: FloatArray, v: FloatArray) -> FloatArray:
    """A bumpy head in metres: u runs from the right ear over the face (0.5) to the left one.

    v runs from top to chin. The back is open, so UVs have no seam.
    """
    turn = (u - 0.5) * 1.7 * np.pi
    tilt = (v - 0.5) * 0.92 * np.pi
    nose = 0.022 * np.exp(-((turn / 0.18) ** 2) - ((tilt - 0.15) / 0.28) ** 2)
    eyes = -0.012 * np.exp(-(((np.abs(turn) - 0.42) / 0.16) ** 2) - ((tilt + 0.12) / 0.11) ** 2)
    mouth = 0.006 * np.exp(-((turn / 0.3) ** 2) - ((tilt - 0.62) / 0.07) ** 2)
    radius = 0.095 + nose + eyes + mouth
    x = radius * np.cos(tilt) * np.sin(turn) * 0.85
    y = -radius * np.sin(tilt) * 1.25
    z = radius * np.cos(tilt) * np.cos(turn)
    return np.stack([x, y, z], axis=-1).astype(np.float32)


def grid_faces(rows: int, columns: int) -> npt.NDArray[np.int32]:
    """Two counter-clockwise triangles per cell of a grid: columns run to +x, rows downwards."""
    corner = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    triangles = np.stack([np.stack([a, c, b], -1), np.stack([b, c, d], -1)], axis=-2)
    return np.ascontiguousarray(triangles.reshape(-1, 3))


def make_toy_avatar(*, seed: int = 7, spec: AvatarSpec = TOY_SPEC, grid: int = 48) -> Avatar:
    """A valid avatar: plausible mesh, skin-like colours with features, random decoders."""
    rng = np.random.default_rng(seed)
    tensors: dict[str, npt.NDArray[np.generic]] = {}
    for key, shape in spec_tensor_shapes(spec).items():
        if key.startswith("encoder."):
            continue
        fan_in = int(np.prod(shape[1:])) if key.endswith(".weight") else 1
        spread = 0.05 if "bias" in key else np.sqrt(1.5 / fan_in)
        tensors[key] = (rng.standard_normal(shape) * spread).astype(np.float32)
    texel = (np.arange(MAP_SIZE, dtype=np.float32) + 0.5) / MAP_SIZE
    tensors["geometry.mean"] = head_surface(*np.meshgrid(texel, texel))
    tensors |= _paint(spec, rng, tensors)
    corner = np.linspace(0.004, 0.996, grid, dtype=np.float32)
    u, v = np.meshgrid(corner, corner)
    tensors["mesh.vertex_uv"] = np.stack([u, v], axis=-1).reshape(-1, 2)
    tensors["mesh.faces"] = grid_faces(grid, grid)
    tensors |= _encoder(rng)
    manifest = Manifest(
        name="Toy",
        identity=f"toy-{seed}",
        licence="Apache-2.0",
        spec=spec,
        position_scale_m=0.003,
        bounds_min_m=(-0.15, -0.2, -0.15),
        bounds_max_m=(0.15, 0.2, 0.2),
        view_span=ViewSpan(-60.0, 60.0, -40.0, 40.0),
        model_card={"training": "none: random weights"},
    )
    return Avatar(manifest, tensors)


def _encoder(rng: np.random.Generator) -> dict[str, npt.NDArray[np.generic]]:
    """An expression encoder of random weights."""
    tensors: dict[str, npt.NDArray[np.generic]] = {}
    width = 52
    for index, out in enumerate(ENCODER_CHANNELS):
        weight = rng.standard_normal((out, width)) / np.sqrt(width)
        tensors[f"encoder.{index}.weight"] = weight.astype(np.float32)
        tensors[f"encoder.{index}.bias"] = np.zeros(out, np.float32)
        width = out
    return tensors


def toy_payload(value: float = 0.0) -> bytes:
    """A frame of a face all of whose shapes are at `value`, at its seat."""
    frame = LatentEncoder().encode(np.full(NUM_ARKIT, value), np.zeros(3), np.zeros(3), 0)
    assert frame is not None
    return frame.payload


def with_bases(avatar: Avatar) -> Avatar:
    """The same mesh at rest, whose vertices bases move: in regions of falling rank."""
    rng = np.random.default_rng(4)
    vertices_m = avatar.mean_vertices_m
    rows = -(-len(vertices_m) // REGION)
    moving = max(rows - NUM_STILL, 1)
    rank = (moving - np.arange(rows)).clip(0, NUM_BASES).astype(np.int32)
    sheet = np.resize(vertices_m, (rows * REGION, 3))
    mix = rng.uniform(-1, 1, (rank.sum(), NUM_BASES)) * REACH_M / avatar.manifest.position_scale_m
    tensors = {n: a for n, a in avatar.tensors.items() if not n.startswith("geometry.")}
    tensors |= {
        "linear.weight": rng.standard_normal((NUM_BASES, NUM_LATENT)).astype(np.float32) / 16,
        "linear.bias": np.zeros(NUM_BASES, np.float32),
        "linear.mix": mix.astype(np.float32),
        "linear.basis": rng.uniform(-1, 1, (rank.sum(), REGION, 3)).astype(np.float32),
        "linear.mean": sheet.reshape(rows, REGION, 3).astype(np.float32),
        "linear.rank": rank,
    }
    spec = replace(avatar.spec, geometry="bases")
    return Avatar(replace(avatar.manifest, spec=spec), tensors)


def with_toy_levels(avatar: Avatar) -> Avatar:
    """A toy avatar with bases, and exits of random weights, coarser grids as their meshes."""
    rng = np.random.default_rng(8)
    avatar = avatar if avatar.spec.geometry == "bases" else with_bases(avatar)
    tensors = dict(avatar.tensors)
    grid = round(len(tensors["mesh.vertex_uv"]) ** 0.5)
    tensors[STILL_NAME] = np.zeros(LATENT_SHAPE, np.float32)
    for level in EXIT_SIZES:
        kept = np.unique(np.linspace(0, grid - 1, max(3, grid * level // MAP_SIZE)).round())
        corner = kept.astype(np.int32)
        index = (corner[:, None] * grid + corner).reshape(-1).astype(np.int32)
        tensors[faces_name(level)] = index[grid_faces(len(corner), len(corner))]
        for name, shape in exit_shapes(level).items():
            spread = np.sqrt(1.5 / np.prod(shape[1:])) if name.endswith("weight") else 0.05
            tensors[name] = (rng.standard_normal(shape) * spread).astype(np.float32)
    return Avatar(avatar.manifest, tensors)


def _paint(
    spec: AvatarSpec, rng: np.random.Generator, tensors: dict[str, npt.NDArray[np.generic]]
) -> dict[str, FloatArray]:
    """Encodings and a pixel decoder that show eyes, lips and hair, so that a picture is worth a
    look.

    m_uv holds four masks in [-1, 1]; the hidden layers hand them on through their sines, the last
    one turns them into colours. All other weights are random and small, so every input matters a
    little.
    """
    texel = (np.arange(spec.uv_encoding_size, dtype=np.float32) + 0.5) / spec.uv_encoding_size
    u, v = np.meshgrid(texel, texel)
    turn, tilt = (u - 0.5) * 1.7 * np.pi, (v - 0.5) * 0.92 * np.pi
    eye = np.exp(-(((np.abs(turn) - 0.42) / 0.15) ** 4) - ((tilt + 0.12) / 0.07) ** 4)
    iris = np.exp(-(((np.abs(turn) - 0.42) / 0.06) ** 4) - ((tilt + 0.12) / 0.06) ** 4)
    lips = np.exp(-((turn / 0.3) ** 4) - ((tilt - 0.62) / 0.06) ** 4)
    hair = 1 / (1 + np.exp((tilt + 0.75 - 0.5 * (np.abs(turn) > 1.2)) * 20))
    maps = np.stack([eye, iris, lips, hair], axis=-1)
    painted = {"xyz.0.weight": (tensors["xyz.0.weight"] * 12).astype(np.float32)}
    num_masks = 0
    if "joint" in spec.encoding_channels:
        num_masks = 4
        painted["uv_encoding"] = (2 * maps - 1).astype(np.float32)
    if "axes" in spec.encoding_channels:
        for name in ("u_encoding", "v_encoding"):
            painted[name] = (tensors[name] * 0.2).astype(np.float32)
    first = EXPRESSION_CHANNELS + XYZ_CHANNELS[-1]
    last = len(PIXEL_CHANNELS) - 1
    for layer in range(last + 1):
        shape = tensors[f"pixel.{layer}.weight"].shape
        weight = rng.standard_normal(shape) * (0.15 if layer < last else 0.05)
        for mask in range(num_masks if layer < last else 0):
            weight[mask] *= 0.2
            weight[mask, first + mask if layer == 0 else mask] = 1.3
        painted[f"pixel.{layer}.weight"] = weight.astype(np.float32)
    skin = np.array([0.80, 0.60, 0.50]) * rng.uniform(0.6, 1.05)
    white, brown, red = [0.9, 0.9, 0.88], [0.2, 0.13, 0.1], [0.68, 0.3, 0.29]
    steps = np.array([white - skin, np.subtract(brown, white), red - skin, brown - skin])
    steps = steps[:num_masks]
    on = np.float64(1)
    for _ in range(last):
        on = np.sin(1.3 * on)
    painted[f"pixel.{last}.weight"][:, :num_masks] = (steps / (2 * on)).T
    painted[f"pixel.{last}.bias"] = (skin + steps.sum(axis=0) / 2).astype(np.float32)
    return painted
