"""The live encoder in closed form: a ridge regression from expressions, and what of them bends.

Geometry learns more from many posed meshes than from a capture's frames (`capture.stage.synth`).
"""

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.capture.stage.synth import Poses
from pica_core.latent import LATENT_CHANNELS
from pica_core.model.bases import Bases
from pica_core.model.interface import ExpressionEncoder
from pica_core.types import FloatArray

RIDGE, BEND_RIDGE = 1e-5, 1e-3
"""Strength of the regression in squared tracker values, for them and for what bends (chosen on two
people, `docs/training.md`; a shape that is never shown stays without effect)."""
GEOMETRY = slice(None, None, LATENT_CHANNELS)
"""The first channel's entries in a flat latent: weights of bases."""
CHUNK = 64
"""Meshes that are projected at a time."""


def regress(arkit: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Matrix ``[D, 52 + B]`` and offset ``[D]`` from lifted expressions, of ``[N, 52]``, to values
    ``[N, D]``, float64."""
    given, wanted = ExpressionEncoder.lifted(arkit.double()), wanted.double()
    mean, rest = given.mean(0), wanted.mean(0)
    offsets = given - mean
    ridge = torch.full_like(mean, BEND_RIDGE)
    ridge[:NUM_ARKIT] = RIDGE
    products = offsets.T @ offsets + len(arkit) * torch.diag(ridge)
    matrix = torch.linalg.solve(products, offsets.T @ (wanted - rest)).T
    return matrix, rest - matrix @ mean


def regress_geometry(poses: Poses, bases: Bases, weight: FloatArray) -> tuple[Tensor, Tensor]:
    """`regress` from posed meshes to all entries of the latent's first channel, ``[64, 52 + B]``.

    Args:
        poses: Their vertices in the order of the bases'.
        bases: Of an avatar.
        weight: From latents to their weights, the file's ``linear.weight``.
    """
    parts = [
        bases.weights_of(poses.vertices_m[start : start + CHUNK])
        for start in range(0, len(poses.arkit), CHUNK)
    ]
    codes = np.concatenate(parts) @ np.linalg.pinv(weight[:, GEOMETRY]).T
    return regress(torch.from_numpy(poses.arkit), torch.from_numpy(codes))
