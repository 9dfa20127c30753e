"""The paper's baseline in torch: a mesh and a whole, view-dependent texture from one code.

Source: Lombardi et al., "Deep Appearance Models for Face Rendering" (2018), in the sizes that were
later published with a face capture data set; the decoder's layers are those of
`pica_core.reference`. The encoder:

    texture 1024    eight convolutions 4x4, stride 2, to 16, 16, 32, 32, 64, 64, 128, 128 channels;
                    fully connected 2048 -> 256
    mesh            fully connected 3V -> 256
    both            fully connected 512 -> 2z: mean and log-variance

A LeakyReLU (slope 0.2) follows every layer but the last ones.

Our choices: the latent is the grid of all our models, flattened to z = 256, so that streams and
trackers serve it too; vertices are the mean mesh plus the position scale times the output; the
texture begins as the capture's mean texture (the bias of its last layer has a value for every
texel); the light encoder takes a texture of 256 and leaves out the two convolutions that a larger
one needs; a smaller texture leaves out the decoder's last but one layers; layers with very many
inputs learn more slowly (`EqualizedLayer`), without which the baseline does not bear the others'
rates.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from pica_core.avatar.spec import LEAKY_SLOPE, VIEW_CHANNELS, AvatarSpec, ModelCost
from pica_core.model import interface
from pica_core.model.interface import ModelOptions
from pica_core.model.networks import Untied, resize_texture, sample_map
from pica_core.reference import FIRST_SIZE, VIEW_FEATURES, BaselineSpec, baseline_channels
from pica_core.types import NUM_LATENT

TEXTURE_SCALE = 0.25
"""Unit of the texture decoder's output, where 1.0 is white (chosen: about the deviation of a
texture's values, which is what published captures divide by)."""
HIDDEN = 256
"""Width of the encoder's two features."""
_ENCODERS: dict[str, tuple[int, tuple[int, ...]]] = {
    "paper": (1024, (16, 16, 32, 32, 64, 64, 128, 128)),
    "light": (256, (16, 32, 64, 64, 128, 128)),
}
USUAL_INPUTS = 288
"""Inputs of an output in the full model's decoders: 32 channels, 3x3 (see `EqualizedLayer`)."""
_GAIN = (2 / (1 + LEAKY_SLOPE**2)) ** 0.5


class EqualizedLayer(nn.Module):
    """A layer whose weights are held larger than they act, by the factor that its number of inputs
    exceeds `USUAL_INPUTS`.

    Adam moves every weight by about the learning rate, whatever its gradient, so a sum over 22,000
    vertex coordinates would move a hundred times as far as one over a convolution's window, and
    does not bear the rates that the full model's layers do. Held so, all layers move alike.

    Args:
        shape: Of the weights.
        inputs: How many inputs meet at an output.
        outputs: Biases; 0 for none.
        gain: Deviation of an output, for inputs of deviation 1.
    """

    def __init__(self, shape: tuple[int, ...], inputs: int, outputs: int, gain: float) -> None:
        super().__init__()
        self.scale = min(1.0, USUAL_INPUTS / inputs)
        self.held = nn.Parameter(torch.empty(shape))
        nn.init.normal_(self.held, std=gain / inputs**0.5 / self.scale)
        self.bias = nn.Parameter(torch.zeros(outputs)) if outputs else None

    @property
    def weight(self) -> Tensor:
        """The weights as they act."""
        return self.scale * self.held


class Connected(EqualizedLayer):
    """A fully connected layer, which scales what it is given: its weights are millions."""

    def __init__(self, inputs: int, outputs: int, gain: float = _GAIN) -> None:
        super().__init__((outputs, inputs), inputs, outputs, gain)

    def forward(self, values: Tensor) -> Tensor:
        """``[N, inputs]`` to ``[N, outputs]``."""
        return functional.linear(self.scale * values, self.held, self.bias)


class Halving(EqualizedLayer):
    """A convolution 4x4 of stride 2."""

    def __init__(self, c_in: int, c_out: int) -> None:
        super().__init__((c_out, c_in, 4, 4), 16 * c_in, c_out, _GAIN)

    def forward(self, values: Tensor) -> Tensor:
        """``[N, c_in, S, S]`` to ``[N, c_out, S / 2, S / 2]``."""
        return functional.conv2d(values, self.weight, self.bias, stride=2, padding=1)


class Doubling(EqualizedLayer):
    """A transposed convolution 4x4 of stride 2, without a bias of its own."""

    def __init__(self, c_in: int, c_out: int, gain: float = _GAIN) -> None:
        super().__init__((c_in, c_out, 4, 4), 4 * c_in, 0, gain)

    def forward(self, values: Tensor) -> Tensor:
        """``[N, c_in, S, S]`` to ``[N, c_out, 2 S, 2 S]``."""
        return functional.conv_transpose2d(values, self.weight, stride=2, padding=1)


class DeepAppearanceEncoder(interface.LatentEncoder):
    """Average texture and tracked vertices to the latent, "paper" or "light".

    Vertices are read from the position map that all models' encoders are given.
    """

    _uv: Tensor

    def __init__(self, name: str, prior: interface.FacePrior) -> None:
        super().__init__()
        self.texture_size, channels = _ENCODERS[name]
        self.register_buffer("_uv", interface.uv_buffer(prior.tracked_uv), persistent=False)
        steps: list[nn.Module] = []
        for c_in, c_out in pairwise((3, *channels)):
            steps += [Halving(c_in, c_out), nn.LeakyReLU(LEAKY_SLOPE)]
        self.texture = nn.Sequential(*steps)
        size = self.texture_size >> len(channels)
        self.texture_feature = Connected(channels[-1] * size * size, HIDDEN)
        self.mesh_feature = Connected(3 * len(prior.tracked_uv), HIDDEN)
        self.mean = Connected(2 * HIDDEN, NUM_LATENT, gain=1.0)
        self.log_variance = Connected(2 * HIDDEN, NUM_LATENT, gain=0.1)

    def forward(self, texture: Tensor, position_map: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the latent."""
        vertices = sample_map(position_map, self._uv).flatten(1)
        features = [
            self.texture_feature(self.texture(texture).flatten(1)),
            self.mesh_feature(vertices),
        ]
        joint = functional.leaky_relu(torch.cat(features, 1), LEAKY_SLOPE)
        return interface.grid_of_latent(self.mean(joint)), interface.grid_of_latent(
            self.log_variance(joint)
        )


class TextureDecoder(nn.Module):
    """Code and view features to offsets of a texture, by transposed convolutions with untied
    biases."""

    def __init__(self, spec: BaselineSpec) -> None:
        super().__init__()
        self._first = spec.num_latent
        self.grid = Connected(
            spec.num_latent + VIEW_FEATURES, spec.num_latent * FIRST_SIZE * FIRST_SIZE
        )
        self.layers: list[tuple[Doubling, Untied]] = []
        size = FIRST_SIZE
        for c_in, c_out in pairwise((spec.num_latent, *spec.channels)):
            size *= 2
            gain = 0.1 * _GAIN if size == spec.texture_size else _GAIN
            self.layers.append((Doubling(c_in, c_out, gain), Untied(c_out, size)))
        self.convolutions = nn.ModuleList(convolution for convolution, _ in self.layers)
        self.biases = nn.ModuleList(bias for _, bias in self.layers)

    def forward(self, features: Tensor) -> Tensor:
        """``[N, z + 8]`` to ``[N, 3, T, T]``."""
        values = functional.leaky_relu(self.grid(features), LEAKY_SLOPE)
        values = values.view(len(features), self._first, FIRST_SIZE, FIRST_SIZE)
        for index, (convolution, bias) in enumerate(self.layers):
            values = bias(convolution(values))
            if index + 1 < len(self.layers):
                values = functional.leaky_relu(values, LEAKY_SLOPE)
        return values


class DeepAppearanceModel(interface.AvatarModel):
    """Encoder and decoders of one person."""

    topology = "tracked"
    tracked_mean_m: Tensor

    def __init__(self, spec: AvatarSpec, prior: interface.FacePrior, options: ModelOptions) -> None:
        super().__init__()
        self.spec = spec
        self.baseline_spec = BaselineSpec(
            num_vertices=len(prior.tracked_uv), channels=baseline_channels(options.texture_size)
        )
        self.position_scale_m = prior.position_scale_m
        mean = torch.as_tensor(prior.tracked_mean_m, dtype=torch.float32)
        self.register_buffer("tracked_mean_m", mean.clone())
        self.encoder = DeepAppearanceEncoder(options.encoder, prior)
        code = self.baseline_spec.num_latent
        self.latent = Connected(code, code)
        self.mesh = Connected(code, 3 * self.baseline_spec.num_vertices, gain=0.1)
        self.view = Connected(VIEW_CHANNELS, VIEW_FEATURES)
        self.texture = TextureDecoder(self.baseline_spec)
        texture = torch.as_tensor(prior.texture_mean, dtype=torch.float32).permute(2, 0, 1)[None]
        resized = resize_texture(texture, options.texture_size)[0]
        self._texel_bias.data.copy_(resized / TEXTURE_SCALE)
        self.expression_encoder = interface.ExpressionEncoder()

    def decode_mesh(self, latent: Tensor) -> interface.DecodedMesh:
        """Vertices of the tracked topology; there is no map."""
        offsets = self.mesh(self._code(latent)).view(len(latent), -1, 3)
        vertices_m = self.tracked_mean_m + self.position_scale_m * offsets
        return interface.DecodedMesh(vertices_m, vertices_m, None)

    def appearance(self, latent: Tensor, view_direction: Tensor) -> Tensor:
        """Textures, sRGB with 1.0 for 255, ``[N, 3, T, T]``."""
        view = functional.leaky_relu(self.view(view_direction), LEAKY_SLOPE)
        texture: Tensor = self.texture(torch.cat([self._code(latent), view], 1))
        return TEXTURE_SCALE * texture

    def shade(self, appearance: Tensor, surface: interface.Surface) -> Tensor:
        """Colours by lookup in the texture."""
        return sample_map(appearance, surface.uv)

    @property
    def cost(self) -> ModelCost:
        """Decoder and texture; a pixel costs a lookup."""
        spec = self.baseline_spec
        return ModelCost(
            parameters=spec.num_parameters,
            per_object_multiply_adds=spec.multiply_adds,
            per_pixel_multiply_adds=0,
        )

    def parameter_groups(self) -> interface.ParameterGroups:
        """Groups as the interface names them; the bias of each texel counts as an encoding."""
        texels = self._texel_bias
        return {
            "shape": [
                *self.encoder.parameters(),
                *self.latent.parameters(),
                *self.mesh.parameters(),
            ],
            "appearance": [
                *self.view.parameters(),
                *(values for values in self.texture.parameters() if values is not texels),
            ],
            "pixel": [],
            "encoding": [texels],
        }

    def _code(self, latent: Tensor) -> Tensor:
        return functional.leaky_relu(self.latent(interface.flat_latent(latent)), LEAKY_SLOPE)

    @property
    def _texel_bias(self) -> nn.Parameter:
        return self.texture.layers[-1][1].weight
