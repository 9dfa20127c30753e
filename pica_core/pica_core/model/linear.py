"""Geometry by bases in torch: what the closed form found of a capture, as parts of a model.

Bases are not trained by descent. The first channel of the latent holds their weights, each by the
root of its deviation, so that what moves little takes little of the code; the encoder writes them
there by a matrix found by ridge regression from maps to weights, and the decoder reads them back.
The other channels are the trained encoder's, for the expression decoder.
"""

import numpy as np
import torch
from torch import Tensor, nn

from pica_core.avatar.linear import Bases, components_of
from pica_core.model.interface import LatentEncoder, LinearPrior, flat_latent
from pica_core.types import LATENT_SIZE, NUM_LATENT, FloatArray

CODE_SIZE = LATENT_SIZE * LATENT_SIZE
"""Bases that the latent's first channel has room for."""
CODE_SCALE = 2.0
"""Deviation of the first basis's entry of the latent."""
CODE_LOG_VARIANCE = -6.0
"""Noise on the weights in training: a deviation of 0.05, against a first entry's of 2."""


class LinearGeometry(nn.Module):
    """Latents to vertices. All its tensors are buffers that a checkpoint holds.

    Args:
        scale_m: Unit of the file's directions, the manifest's `position_scale_m`.
    """

    weight: Tensor
    mix: Tensor
    basis: Tensor
    mean: Tensor
    rank: Tensor
    order: Tensor
    tracked: Tensor
    tracked_mean: Tensor

    def __init__(self, prior: LinearPrior, scale_m: float) -> None:
        super().__init__()
        self.scale_m = scale_m
        scale = code_scale(prior)
        weight = np.zeros((len(scale), NUM_LATENT), np.float32)
        weight[np.arange(len(scale)), 4 * np.arange(len(scale))] = 1 / scale
        parts = prior.parts
        for name, values in {
            "weight": weight,
            "mix": (parts.mix_m / scale_m).astype(np.float16).astype(np.float32),
            "basis": parts.basis,
            "mean": parts.mean_m,
            "rank": parts.rank,
            "order": parts.order.astype(np.int64),
            "tracked": prior.tracked.components_m,
            "tracked_mean": prior.tracked.mean_m,
        }.items():
            self.register_buffer(name, torch.from_numpy(np.ascontiguousarray(values)))
        self._components: Tensor | None = None

    def forward(self, latent: Tensor) -> tuple[Tensor, Tensor]:
        """Latents ``[N, 4, 8, 8]`` to dense vertices ``[N, V, 3]`` and tracked ``[N, Vt, 3]``,
        without gradients: what is trained of a latent has no part in them."""
        weights = flat_latent(latent.detach()) @ self.weight.T
        dense = self._mean_m + torch.tensordot(weights, self._dense_components(), 1)
        return dense, self.tracked_mean + torch.tensordot(weights, self.tracked, 1)

    def bases(self, vertex_weights: FloatArray) -> Bases:
        """The same as bases of the dense mesh; an error of each vertex counts so much, ``[V]``."""
        return Bases(
            mean_m=self._mean_m.cpu().numpy(),
            components_m=self._dense_components().cpu().numpy(),
            vertex_weights=vertex_weights,
        )

    def named_tensors(self) -> dict[str, Tensor]:
        """The tensors under their names in the avatar file; vertices by places of the sheet."""
        names = ("weight", "mix", "basis", "mean", "rank")
        tensors = {f"linear.{name}": getattr(self, name) for name in names}
        tensors["linear.bias"] = self.weight.new_zeros(len(self.weight))
        return tensors

    @property
    def cost(self) -> tuple[int, int]:
        """Parameters, and multiply-adds of a frame."""
        parts = (self.weight, self.mix, self.basis)
        multiply_adds = sum(part.numel() for part in parts)
        return multiply_adds + self.mean.numel() + len(self.weight), multiply_adds

    @property
    def _mean_m(self) -> Tensor:
        sheet = self.mean.reshape(-1, 3)[: len(self.order)]
        return torch.zeros_like(sheet).index_copy_(0, self.order, sheet)

    def _dense_components(self) -> Tensor:
        """Regions put together again, in the capture's order of vertices, ``[K, V, 3]``."""
        if self._components is None or self._components.device != self.mix.device:
            tensors = {
                f"linear.{n}": getattr(self, n).cpu().numpy() for n in ("mix", "basis", "rank")
            }
            sheet = torch.from_numpy(components_of(tensors, self.scale_m)).to(self.mix.device)
            sheet = sheet[:, : len(self.order)]
            self._components = torch.zeros_like(sheet).index_copy_(1, self.order, sheet)
        return self._components

    def _load_from_state_dict(self, state: dict[str, Tensor], prefix: str, *rest: object) -> None:
        """Take buffers of any size: another machine may have cut the same capture otherwise."""
        for name, values in list(self._buffers.items()):
            found = state.get(prefix + name)
            if values is not None and found is not None and found.ndim == values.ndim:
                self._buffers[name] = values.new_empty(found.shape)
        self._components = None
        super()._load_from_state_dict(state, prefix, *rest)


class LinearEncoder(LatentEncoder):
    """An encoder whose first channel is the closed form's; a trained one makes the others."""

    texels: Tensor
    projection: Tensor

    def __init__(self, trained: LatentEncoder, prior: LinearPrior) -> None:
        super().__init__()
        self.trained = trained
        self.texture_size = trained.texture_size
        code = np.zeros((CODE_SIZE, prior.projection.shape[1]), np.float32)
        code[: len(prior.projection)] = code_scale(prior)[:, None] * prior.projection
        self.register_buffer("texels", torch.from_numpy(prior.texels.astype(np.int64)))
        self.register_buffer("projection", torch.from_numpy(code))

    def forward(self, texture: Tensor, position_map: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the latent."""
        mean, log_variance = self.trained(texture, position_map)
        read = position_map.flatten(2)[:, :, self.texels].flatten(1)
        code = (read @ self.projection.T).view(-1, 1, LATENT_SIZE, LATENT_SIZE)
        still = torch.full_like(code, CODE_LOG_VARIANCE)
        return (torch.cat([code, mean[:, 1:]], 1), torch.cat([still, log_variance[:, 1:]], 1))


def code_scale(prior: LinearPrior) -> FloatArray:
    """Deviation of each basis's entry of the latent, ``[K]``."""
    deviation_m = prior.deviation_m
    return (CODE_SCALE * np.sqrt(deviation_m / deviation_m.max())).astype(np.float32)
