"""The losses of training, each a function of tensors and nothing else.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 5 "Joint Learning with a Dense Mesh
Decoder". Here: image, mesh and KL, with the paper's weights 2, 0.1 and 0.001. The paper does not
state its units; ours are in each docstring.
"""

from __future__ import annotations

from torch import Tensor


def image_loss(predicted: Tensor, observed: Tensor) -> Tensor:
    """Mean squared difference of colours, where 1.0 is 255 of 8-bit sRGB.

    Args:
        predicted: ``[P, 3]``.
        observed: ``[P, 3]``.
    """
    return (predicted - observed).square().mean()


def mesh_loss(predicted_m: Tensor, tracked_m: Tensor, weights: Tensor) -> Tensor:
    """Weighted mean squared distance of vertices, in square millimetres.

    Args:
        predicted_m: Vertices sampled from the decoded position maps, metres, ``[N, V, 3]``.
        tracked_m: Tracked vertices, metres, ``[N, V, 3]``.
        weights: Importance per vertex, at least 0, ``[V]``; 0 masks a vertex out.
    """
    distance = ((predicted_m - tracked_m) * 1000).square().sum(2)
    return (distance * weights).sum() / (weights.sum() * len(distance))


def kl_loss(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Divergence of N(mean, exp(log_variance)) from N(0, 1), averaged over latent entries, nats."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance).mean()
