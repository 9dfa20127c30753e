"""The Pixel Codec Avatar: latent to position map, expression map and pixel colours.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), section 3.

Our choices: the position map is the mean map plus `position_scale_m` times the decoder's output
(positions normalised by mean and deviation, as face captures are published), and the block of
the decoders is a setting.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.spec import (
    VARIANTS,
    AvatarSpec,
    ModelCost,
    TopologyName,
    Variant,
    pixel_codec_cost,
)
from pica_core.model import interface
from pica_core.model.baseline import DeepAppearanceModel
from pica_core.model.interface import AvatarModel, FacePrior, ModelOptions
from pica_core.model.linear import LinearEncoder, LinearGeometry
from pica_core.model.networks import ENCODERS, MapDecoder, Untied, sample_map, tile_view_direction
from pica_core.model.pixel_decoder import PixelDecoder, SurfaceEncoding


class PixelCodecAvatar(interface.AvatarModel):
    """Encoder, decoders and pixel decoder of one person, to draw the mesh of one topology."""

    position_mean: Tensor
    _drawn_uv: Tensor
    _tracked_uv: Tensor

    def __init__(
        self,
        spec: AvatarSpec,
        prior: interface.FacePrior,
        options: ModelOptions,
        *,
        topology: TopologyName = "dense",
    ) -> None:
        super().__init__()
        self.spec = spec
        self.topology = topology
        self.position_scale_m = prior.position_scale_m
        drawn, mean_map = {
            "dense": (prior.dense_uv, prior.position_mean),
            "tracked": (prior.tracked_uv, prior.tracked_position_mean),
        }[topology]
        mean = torch.as_tensor(mean_map, dtype=torch.float32).permute(2, 0, 1)
        self.register_buffer("position_mean", mean.contiguous())
        self.register_buffer("_drawn_uv", interface.uv_buffer(drawn), persistent=False)
        self.register_buffer("_tracked_uv", interface.uv_buffer(prior.tracked_uv), persistent=False)
        self._draws_tracked = drawn is prior.tracked_uv
        self.encoder: interface.LatentEncoder = ENCODERS[options.encoder]()
        self.geometry: MapDecoder | LinearGeometry
        if spec.geometry == "bases":
            assert prior.linear is not None  # the maker of the prior asks the variant
            self.encoder = LinearEncoder(self.encoder, prior.linear)
            self.geometry = LinearGeometry(prior.linear, prior.position_scale_m)
        else:
            self.geometry = MapDecoder(spec, "geometry")
        self.expression = MapDecoder(spec, "expression")
        self.pixel_decoder = PixelDecoder(spec, encoding_amplitude=options.encoding_amplitude)
        if options.texture_contrast:
            texture = torch.as_tensor(prior.texture_mean, dtype=torch.float32).permute(2, 0, 1)
            xyz_m = sample_map(self.position_mean[None], self._drawn_uv)[0]
            uv = torch.from_numpy(np.ascontiguousarray(drawn, np.float32))
            self.pixel_decoder.start_from(texture, options.texture_contrast, xyz_m, uv)
        self.expression_encoder = interface.ExpressionEncoder()

    def decode_mesh(self, latent: Tensor) -> interface.DecodedMesh:
        """The position map of each latent and what the vertices find in it, or the vertices that
        its bases make."""
        if isinstance(self.geometry, LinearGeometry):
            dense_m, tracked_m = self.geometry(latent)
            return interface.DecodedMesh(dense_m, tracked_m, None)
        position_map = self.position_mean + self.position_scale_m * self.geometry(latent)
        drawn_m = tracked_m = sample_map(position_map, self._drawn_uv)
        if not self._draws_tracked:
            tracked_m = sample_map(position_map, self._tracked_uv)
        return interface.DecodedMesh(drawn_m, tracked_m, position_map)

    def appearance(self, latent: Tensor, view_direction: Tensor) -> Tensor:
        """Expression maps, ``[N, 4, 256, 256]``."""
        grid = torch.cat([latent, tile_view_direction(view_direction)], 1)
        return self.expression(grid)

    def shade(self, appearance: Tensor, surface: interface.Surface) -> Tensor:
        """Colours by the pixel decoder, from expression maps."""
        codes = sample_map(appearance, surface.uv).permute(2, 0, 1).flatten(1).T
        xyz_m, uv = surface.xyz_m.detach().flatten(0, 1), surface.uv.flatten(0, 1)
        colours: Tensor = self.pixel_decoder(codes, xyz_m, uv)
        return colours.view(surface.xyz_m.shape)

    @property
    def cost(self) -> ModelCost:
        """What decoders or bases, surface encoding and the two sine networks cost."""
        cost = pixel_codec_cost(self.spec)
        if isinstance(self.geometry, LinearGeometry):
            parameters, multiply_adds = self.geometry.cost
            cost = replace(
                cost,
                parameters=cost.parameters + parameters,
                per_object_multiply_adds=cost.per_object_multiply_adds + multiply_adds,
            )
        return cost

    def parameter_groups(self) -> interface.ParameterGroups:
        """Groups as the interface names them."""
        pixel = self.pixel_decoder
        return {
            "shape": [*self.encoder.parameters(), *self.geometry.parameters()],
            "appearance": list(self.expression.parameters()),
            "pixel": [*pixel.xyz.parameters(), *pixel.colour.parameters()],
            "encoding": list(pixel.encoding.parameters()),
        }


def make_model(
    variant: str, spec: AvatarSpec, prior: FacePrior, options: ModelOptions
) -> AvatarModel:
    """Build a model of `VARIANTS`.

    Args:
        spec: Sizes of the full model; the row replaces its encoding and geometry.
    """
    row: Variant = VARIANTS[variant]
    spec = replace(spec, encoding=row.encoding, geometry=row.geometry)
    model: AvatarModel
    match row.network:
        case "pixel_codec":
            model = PixelCodecAvatar(spec, prior, options, topology=row.topology)
        case "deep_appearance":
            model = DeepAppearanceModel(spec, prior, options)
    lay_channels_last(model)
    return model


def lay_channels_last(model: AvatarModel) -> None:
    """Store what convolutions and single texels are weighted with channels last, in memory alone:
    features follow, and decoders take a fifth less time (measured, CPU and GPU)."""
    for module in model.modules():
        for weight in module.parameters(recurse=False):
            if isinstance(module, Untied):
                weight.data = weight.data.permute(1, 2, 0).contiguous().permute(2, 0, 1)
            elif weight.ndim == 4 and not isinstance(module, SurfaceEncoding):
                weight.data = weight.data.to(memory_format=torch.channels_last)
