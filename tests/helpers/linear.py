"""A toy avatar whose vertices come from bases, made without training anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar.file import Avatar
from pica_core.avatar.linear import REGION
from pica_core.avatar.spec import AvatarSpec
from pica_core.latent import NUM_LATENT
from pica_core.sampling import sample_vertices

NUM_BASES = 6
NUM_STILL = 2
"""Regions that never move."""
REACH_M = 4e-3


def make_linear_avatar(grid: int = 40, seed: int = 4) -> Avatar:
    """A grid of vertices, in regions of falling rank."""
    rng = np.random.default_rng(seed)
    toy = make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=grid)
    count = grid * grid
    rows = -(-count // REGION)
    rank = np.maximum(rows - NUM_STILL - np.arange(rows), 0).clip(0, NUM_BASES).astype(np.int32)
    sheet = np.resize(
        sample_vertices(toy.tensors["geometry.mean"], toy.tensors["mesh.vertex_uv"]),
        (rows * REGION, 3),
    )
    scale_m = toy.manifest.position_scale_m
    mix = rng.uniform(-1, 1, (rank.sum(), NUM_BASES)) * REACH_M / scale_m
    tensors = {
        name: a
        for name, a in toy.tensors.items()
        if name != "geometry.mean" and not name.startswith("geometry.")
    }
    tensors |= {
        "linear.weight": rng.standard_normal((NUM_BASES, NUM_LATENT)).astype(np.float32) / 16,
        "linear.bias": np.zeros(NUM_BASES, np.float32),
        "linear.mix": mix.astype(np.float32),
        "linear.basis": rng.uniform(-1, 1, (rank.sum(), REGION, 3)).astype(np.float32),
        "linear.mean": sheet.reshape(rows, REGION, 3).astype(np.float32),
        "linear.rank": rank,
    }
    spec = replace(toy.spec, geometry="bases")
    return with_toy_levels(Avatar(replace(toy.manifest, spec=spec, variant="linear"), tensors))
