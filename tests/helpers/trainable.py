"""Models of nobody in particular, for tests that need one to train, export or judge."""

from dataclasses import replace

import numpy as np

from helpers.toy import grid_faces, head_surface
from pica_core.avatar.file import Avatar
from pica_core.avatar.linear import fit_bases, split_bases
from pica_core.avatar.manifest import Manifest, ViewSpan
from pica_core.avatar.spec import MAP_SIZE
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import FacePrior, LinearPrior
from pica_core.model.linear import CODE_SIZE
from pica_core.train.export import avatar_tensors


def toy_prior(*, dense: int = 16, tracked: int = 9, scale_m: float = 0.005) -> FacePrior:
    """The toy's head as a mean face, with two grids of so many rows over the same UV square;
    decoded offsets are in units of `scale_m`."""
    texel = (np.arange(MAP_SIZE, dtype=np.float32) + 0.5) / MAP_SIZE
    tracked_uv = grid_uv(tracked)
    position_mean = head_surface(*np.meshgrid(texel, texel))
    return FacePrior(
        position_mean=position_mean,
        tracked_position_mean=position_mean,
        position_scale_m=scale_m,
        dense_uv=grid_uv(dense),
        tracked_uv=tracked_uv,
        tracked_mean_m=head_surface(tracked_uv[:, 0], tracked_uv[:, 1]),
        texture_mean=np.full((64, 64, 3), [0.8, 0.6, 0.5], np.float32),
    )


def toy_linear_prior(*, dense: int = 24) -> FacePrior:
    """`toy_prior` with bases of meshes that move in five ways."""
    prior = toy_prior(dense=dense)
    uv = np.concatenate([prior.dense_uv, prior.tracked_uv])
    rng = np.random.default_rng(5)
    ways = [np.sin((1 + k) * np.pi * uv[:, :1]) * rng.standard_normal(3) for k in range(5)]
    weights = rng.standard_normal((30, len(ways)))
    moved_m = 4e-3 * np.tensordot(weights, np.stack(ways), axes=1)
    meshes_m = (head_surface(uv[:, 0], uv[:, 1]) + moved_m).astype(np.float32)
    count = dense * dense
    both = fit_bases(meshes_m, CODE_SIZE, np.arange(len(uv)) < count)
    bases = both.select(np.arange(count, dtype=np.int32))
    return replace(
        prior,
        linear=LinearPrior(
            tracked=both.select(np.arange(count, len(uv), dtype=np.int32)),
            parts=split_bases(bases, prior.dense_uv),
            texels=np.arange(100, 150, dtype=np.int32),
            projection=rng.standard_normal((len(bases.components_m), 150)).astype(np.float32),
            deviation_m=np.linalg.norm(bases.components_m, axis=2).mean(1),
        ),
    )


def grid_uv(count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """UVs of a square grid of vertices, inside the border texels."""
    corner = np.linspace(0.01, 0.99, count, dtype=np.float32)
    return np.stack(np.meshgrid(corner, corner), -1).reshape(-1, 2)


def exported(model: PixelCodecAvatar) -> Avatar:
    """The avatar of a model that draws a grid of 16 x 16 vertices."""
    manifest = Manifest(
        name="Judged",
        identity="none",
        licence="Apache-2.0",
        spec=model.spec,
        position_scale_m=model.position_scale_m,
        view_span=ViewSpan(-60.0, 60.0, -40.0, 40.0),
        bounds_min_m=(-0.2, -0.2, -0.2),
        bounds_max_m=(0.2, 0.2, 0.2),
    )
    return Avatar(manifest, avatar_tensors(model, grid_uv(16), grid_faces(16, 16)))
