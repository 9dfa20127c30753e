"""The losses of training, each a function of tensors and nothing else.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 5 "Joint Learning with a Dense Mesh
Decoder" and appendix A.2. The paper writes norms and states no units. Ours, so that no loss depends
on the size of images, maps or meshes:

    image       mean square, colours from 0 to 1; hue counts more (`TrainConfig.chroma`)
    depth       mean absolute error, millimetres
    normal      mean squared distance of unit vectors
    mesh        weighted mean squared distance, square millimetres
    smoothness  root mean squares of the map's gradient and of the mesh Laplacian, millimetres
    KL          mean over latent entries, nats

Every loss is made of one term for each image or mesh of the batch, and their mean: a batch cut in
two equal halves gives the mean of the halves' losses and gradients.

The Laplacian has cotangent weights as in Sorkine et al., "Laplacian Surface Editing" (2004):

    (L x)_i  =  x_i - sum_j w_ij x_j / sum_j w_ij        w_ij = (cot a_ij + cot b_ij) / 2

over the neighbours j of vertex i, with a and b the angles opposite to the edge. Rows are
normalised, so that L x is a length: how far a vertex lies from where its neighbours would put it.
Ours: cotangents are limited to +-`COTANGENT_LIMIT` and weights to at least `LEAST_WEIGHT`. A mesh
that was sampled from a tracked one has triangles of no area where the tracked one has no surface
(inside the mouth), and obtuse triangles have negative cotangents, whose rows may add up to nothing.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.types import Float64Array, Int64Array

DEPTH_LIMIT_M = 0.010
"""Depth that is further off teaches nothing (paper 5): it is a hole, an outlier, or another
surface."""
MILLIMETRES = 1000.0
LUMA = (0.299, 0.587, 0.114)
_LEAST_SQUARE = 1e-12
"""Keeps the root of a mean square differentiable where everything is smooth, square mm."""


def equal_shares(mask: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """Weights of the pixels that count, ``[N, K]``, by which each image's add up to 1 / N; an image
    without any adds up to 0."""
    counted = mask.to(dtype)
    return counted / (len(mask) * counted.sum(1, keepdim=True).clamp_min(1))


def image_loss(predicted: Tensor, observed: Tensor, share: Tensor, chroma: float = 0.0) -> Tensor:
    """Mean squared difference of colours ``[N, K, 3]``, where 1.0 is 255 of 8-bit sRGB.

    Args:
        share: From `equal_shares`, ``[N, K]``.
        chroma: How much more what is left of the difference counts when that of the luma (ITU-R
            BT.601) is taken off.
    """
    difference = predicted - observed
    red, green, blue = (
        weight * part for weight, part in zip(LUMA, difference.unbind(-1), strict=True)
    )
    luma = (red + green + blue)[..., None]
    squares = difference.square() + chroma * (difference - luma).square()
    return (squares.mean(-1) * share).sum()


def depth_mask(predicted_m: Tensor, observed_m: Tensor) -> Tensor:
    """Where depth is known and within the limit: the paper's W_D. bool ``[N, K]``.

    Args:
        predicted_m: Depth of the decoded mesh along the camera's axis, metres, ``[N, K]``.
        observed_m: Measured depth, metres, 0 where unknown, ``[N, K]``.
    """
    return (observed_m > 0) & ((predicted_m.detach() - observed_m).abs() < DEPTH_LIMIT_M)


def depth_loss(predicted_m: Tensor, observed_m: Tensor, mask: Tensor, share: Tensor) -> Tensor:
    """Mean absolute depth error, millimetres, over pixels of known depth.

    Pixels outside `mask` count as 0: the more of them, the weaker the loss. 0 where nothing is
    known.

    Args:
        mask: From `depth_mask`, ``[N, K]``.
        share: From `equal_shares` of the pixels with known depth, ``[N, K]``.
    """
    error = (predicted_m - observed_m).abs() * MILLIMETRES
    return (torch.where(mask, error, torch.zeros_like(error)) * share).sum()


def screen_normals(points: Tensor, right: Tensor, below: Tensor) -> Tensor:
    """Unit normals of a depth image by forward differences, towards the camera, ``[N, K, 3]``; the
    zero vector where the three points lie on a line.

    Args:
        points: Surface points in camera axes (x right, y down, z forward), ``[N, K, 3]``.
        right: The same of each pixel's right neighbour, ``[N, K, 3]``.
        below: The same of the neighbour below, ``[N, K, 3]``.
    """
    normals = torch.linalg.cross(below - points, right - points)
    # Points are metres apart by fractions of a millimetre: keep the smallest useful area.
    return normals / (normals.square().sum(-1, keepdim=True) + 1e-24).sqrt()


def normal_loss(predicted: Tensor, observed: Tensor, share: Tensor) -> Tensor:
    """Mean squared distance of unit normals ``[N, K, 3]``, 0 to 4.

    Args:
        share: From `equal_shares` of the pixels whose own depth and neighbours' depths pass
            `depth_mask`, ``[N, K]``.
    """
    return ((predicted - observed).square().sum(-1) * share).sum()


def mesh_loss(predicted_m: Tensor, tracked_m: Tensor, weights: Tensor) -> Tensor:
    """Weighted mean squared distance of vertices, in square millimetres.

    Args:
        predicted_m: Vertices sampled from the decoded position maps, metres, ``[N, V, 3]``.
        tracked_m: Tracked vertices, metres, ``[N, V, 3]``.
        weights: Importance per vertex, at least 0, ``[V]``; 0 masks a vertex out (the paper's W_M
            does so to the mouth, where a tracked mesh is a guess).
    """
    distance = ((predicted_m - tracked_m) * MILLIMETRES).square().sum(2)
    return (distance * weights).sum() / (weights.sum().clamp_min(1e-12) * len(distance))


def mean_norm(values: Tensor) -> Tensor:
    """The root mean square of each of N arrays ``[N, ...]``, averaged over them; smooth at 0."""
    squares = values.square().flatten(1).mean(1)
    return (squares + _LEAST_SQUARE).sqrt().mean()


def gradient_smoothness(position_map_m: Tensor) -> Tensor:
    """Differences of neighbouring texels of position maps G (metres, ``[N, 3, H, W]``) along rows
    and along columns: RMS of each, added, mm.

    Source: appendix A.2, "Gradient Smoothness".
    """
    map_mm = position_map_m * MILLIMETRES
    along_x = map_mm[..., :, 1:] - map_mm[..., :, :-1]
    along_y = map_mm[..., 1:, :] - map_mm[..., :-1, :]
    return mean_norm(along_x) + mean_norm(along_y)


def kl_loss(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Divergence of N(mean, exp(log_variance)) from N(0, 1), averaged over latent entries, nats."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).mean()


COTANGENT_LIMIT = 50.0
"""Largest size of a cotangent (chosen: angles from 1 to 179 degrees go through)."""
LEAST_WEIGHT = 1e-6
"""Smallest weight of an edge: a row without any other averages its neighbours alike."""
ROUGH_WEIGHTS = {"hair": 1.25, "mouth": 1.25}
"""W_L by region of a topology (paper A.2)."""
PLAIN_WEIGHT = 0.25
"""W_L elsewhere (paper A.2)."""
MEAN_RATE = 1e-4
"""How fast the mean mesh follows a batch (paper A.2, lambda_mu)."""


def cotangent_weights(
    vertices_m: npt.ArrayLike, faces: npt.NDArray[np.integer]
) -> tuple[Int64Array, Float64Array]:
    """Directed edges of a mesh and their cotangent weights.

    Args:
        vertices_m: Of the neutral mesh, any length unit, ``[V, 3]``.
        faces: ``[F, 3]``.

    Returns:
        Edges (i, j) sorted, each once in either direction, int64 ``[E, 2]``, and weights w_ij of
        at least `LEAST_WEIGHT`, float64 ``[E]``.
    """
    points = np.asarray(vertices_m, np.float64)
    triangles = np.asarray(faces, np.int64)
    edges, halves = [], []
    for corner in range(3):
        apex, i, j = (triangles[:, (corner + k) % 3] for k in range(3))
        to_i, to_j = points[i] - points[apex], points[j] - points[apex]
        area = np.linalg.norm(np.cross(to_i, to_j), axis=1)
        cotangent = (to_i * to_j).sum(1) / np.maximum(area, 1e-300)
        half = np.clip(cotangent, -COTANGENT_LIMIT, COTANGENT_LIMIT) / 2
        edges += [np.stack([i, j], 1), np.stack([j, i], 1)]
        halves += [half, half]
    # An edge of two triangles comes twice in either direction; equal ones are added.
    unique, place = np.unique(np.concatenate(edges), axis=0, return_inverse=True)
    weights = np.bincount(place.reshape(-1), np.concatenate(halves), len(unique))
    return unique, np.maximum(weights, LEAST_WEIGHT)


class Laplacian(NamedTuple):
    """L as directed edges (i, j), sorted, int64 ``[E]`` each, and w_ij / sum_j w_ij, ``[E]``."""

    first: Tensor
    second: Tensor
    weights: Tensor

    def of(self, values: Tensor) -> Tensor:
        """L x of ``[V, C]``; 0 of a vertex without neighbours."""
        difference = values.index_select(0, self.first) - values.index_select(0, self.second)
        return torch.zeros_like(values).index_add(0, self.first, difference * self.weights[:, None])


def mesh_laplacian(
    vertices_m: npt.ArrayLike, faces: npt.NDArray[np.integer], like: Tensor
) -> Laplacian:
    """L of a mesh.

    Args:
        vertices_m: The coarse neutral mesh at the vertices of the mesh that is drawn, ``[V, 3]``.
        faces: ``[F, 3]``.
        like: Gives type and device.
    """
    edges, weights = cotangent_weights(vertices_m, faces)
    sums = np.bincount(edges[:, 0], weights)
    first, second = (torch.from_numpy(end.copy()).to(like.device) for end in edges.T)
    return Laplacian(first, second, torch.from_numpy(weights / sums[edges[:, 0]]).to(like))


def laplacian_smoothness(
    laplacian: Laplacian, vertices_m: Tensor, mean_m: Tensor, weights: Tensor
) -> Tensor:
    """Root mean square of W_L L (S(G) - V_mu) of each mesh, averaged over meshes, millimetres.

    Args:
        laplacian: L.
        vertices_m: S(G), the decoded meshes, metres, ``[N, V, 3]``.
        mean_m: V_mu, metres, ``[V, 3]``; no gradient goes there.
        weights: W_L, ``[V]``.
    """
    offset_mm = (vertices_m - mean_m.detach()) * MILLIMETRES
    flat = offset_mm.transpose(0, 1).flatten(1)
    rough = laplacian.of(flat) * weights[:, None]
    return mean_norm(rough.view(len(weights), -1, 3).transpose(0, 1))


@torch.no_grad()
def follow_mean(mean_m: Tensor, vertices_m: Tensor) -> None:
    """V_mu <- (1 - rate) V_mu + rate times the mean of a batch of meshes ``[N, V, 3]``, in place,
    without gradient.

    Source: appendix A.2, the update of the regularisation target; the rate is `MEAN_RATE`.
    """
    mean_m.lerp_(vertices_m.detach().mean(0), MEAN_RATE)
