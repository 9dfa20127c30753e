"""The losses of training, each a function of tensors and nothing else.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 5 "Joint Learning with a Dense Mesh
Decoder" and appendix A.2; their weights (image 2, depth 10, normal 1, mesh 0.1, smoothness 1,
KL 0.001) stand in `pica_core.train.config.LossConfig`. The paper writes norms and states no units.
Ours, so that no loss depends on the size of images, maps or meshes:

    image       mean square, colours from 0 to 1; hue counts more (`LossConfig.chroma`)
    depth       mean absolute error, millimetres
    normal      mean squared distance of unit vectors
    mesh        weighted mean squared distance, square millimetres
    smoothness  root mean squares, millimetres (`gradient_smoothness` here, `laplacian`)
    KL          mean over latent entries, nats

Every loss is made of one term for each image or mesh of the batch, and their mean: a batch cut in
two equal halves gives the mean of the halves' losses and gradients.
"""

import torch
from torch import Tensor

DEPTH_LIMIT_M = 0.010
"""Depth that is further off teaches nothing (paper 5): it is a hole, an outlier, or another
surface."""
MILLIMETRES = 1000.0
LUMA = (0.299, 0.587, 0.114)
_LEAST_SQUARE = 1e-12
"""Keeps the root of a mean square differentiable where everything is smooth, square mm."""


def equal_shares(
    image: Tensor,
    num_images: int,
    mask: Tensor | None = None,
    *,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Weights of pixels, ``[P]``, by which each image's pixels add up to 1 / N.

    Args:
        image: Which image each pixel is of, int64 ``[P]``.
        mask: Pixels that count, bool ``[P]``; all without it. An image without any adds up to 0.
    """
    counted = torch.ones_like(image, dtype=dtype) if mask is None else mask.to(dtype)
    counts = counted.new_zeros(num_images).index_add(0, image, counted)
    return counted / (num_images * counts.clamp_min(1))[image]


def image_loss(predicted: Tensor, observed: Tensor, share: Tensor, chroma: float = 0.0) -> Tensor:
    """Mean squared difference of colours ``[P, 3]``, where 1.0 is 255 of 8-bit sRGB.

    Args:
        share: From `equal_shares`, ``[P]``.
        chroma: How much more what is left of the difference counts when that of the luma (ITU-R
            BT.601) is taken off.
    """
    difference = predicted - observed
    luma = torch.matmul(difference, difference.new_tensor(LUMA))[:, None]
    squares = difference.square() + chroma * (difference - luma).square()
    return (squares.mean(1) * share).sum()


def depth_mask(predicted_m: Tensor, observed_m: Tensor, limit_m: float = DEPTH_LIMIT_M) -> Tensor:
    """Where depth is known and within the limit: the paper's W_D. bool ``[P]``.

    Args:
        predicted_m: Depth of the decoded mesh along the camera's axis, metres, ``[P]``.
        observed_m: Measured depth, metres, 0 where unknown, ``[P]``.
    """
    return (observed_m > 0) & ((predicted_m.detach() - observed_m).abs() < limit_m)


def depth_loss(predicted_m: Tensor, observed_m: Tensor, mask: Tensor, share: Tensor) -> Tensor:
    """Mean absolute depth error, millimetres, over P pixels of known depth.

    Pixels outside `mask` count as 0: the more of them, the weaker the loss. 0 where nothing is
    known.

    Args:
        mask: From `depth_mask`, ``[P]``.
        share: From `equal_shares` of the pixels with known depth, ``[P]``.
    """
    error = (predicted_m - observed_m).abs() * MILLIMETRES
    return (torch.where(mask, error, torch.zeros_like(error)) * share).sum()


def screen_normals(points: Tensor, right: Tensor, below: Tensor) -> Tensor:
    """Unit normals of a depth image by forward differences, towards the camera, ``[P, 3]``; the
    zero vector where the three points lie on a line.

    Args:
        points: Surface points of P pixels in camera axes (x right, y down, z forward), ``[P, 3]``.
        right: The same of each pixel's right neighbour, ``[P, 3]``.
        below: The same of the neighbour below, ``[P, 3]``.
    """
    normals = torch.linalg.cross(below - points, right - points)
    # Points are metres apart by fractions of a millimetre: keep the smallest useful area.
    unit: Tensor = normals / (normals.square().sum(1, keepdim=True) + 1e-24).sqrt()
    return unit


def normal_loss(predicted: Tensor, observed: Tensor, share: Tensor) -> Tensor:
    """Mean squared distance of unit normals ``[P, 3]``, 0 to 4.

    Args:
        share: From `equal_shares` of the pixels whose own depth and neighbours' depths pass
            `depth_mask`, ``[P]``.
    """
    return ((predicted - observed).square().sum(1) * share).sum()


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
