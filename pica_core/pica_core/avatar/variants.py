"""The models of the paper's tables, as rows: each is `FULL` with one part replaced.

    full       the Pixel Codec Avatar (section 3)
    linear     full with vertices by bases in closed form (ours)
    no_uv      the pixel decoder is not told where on the surface it is
    coarse     the tracked mesh is drawn, not the dense one
    uv_nope    (u, v) as they are, without an encoding
    nerf_pe    sines and cosines of (u, v), 40 values
    pe_2d      the joint map m_uv alone
    pe_1d      the per-axis tables m_u and m_v alone
    baseline   a mesh and a whole texture (Lombardi et al. 2018)

What the paper says of each, what it leaves open and what we chose: `docs/training.md`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import prod
from types import MappingProxyType
from typing import Literal

from pica_core.avatar.spec import AvatarSpec, decoder_layers, spec_tensor_shapes

TopologyName = Literal["dense", "tracked"]
Network = Literal["pixel_codec", "deep_appearance"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """What may differ between two rows."""

    network: Network = "pixel_codec"
    """Colours by a pixel decoder, or a whole texture."""
    encoding: str = "full"
    """What a pixel decoder is told about the surface point (`spec.ENCODINGS`)."""
    topology: TopologyName = "dense"
    """Which mesh of the capture is drawn."""
    geometry: str = "decoder"
    """Where vertices come from (`spec.GEOMETRIES`)."""


FULL = Variant()
VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "full": FULL,
        "linear": replace(FULL, geometry="bases"),
        "no_uv": replace(FULL, encoding="none"),
        "coarse": replace(FULL, topology="tracked"),
        "uv_nope": replace(FULL, encoding="uv"),
        "nerf_pe": replace(FULL, encoding="sinusoids"),
        "pe_2d": replace(FULL, encoding="joint"),
        "pe_1d": replace(FULL, encoding="axes"),
        "baseline": replace(FULL, network="deep_appearance", topology="tracked"),
    }
)
TABLE_1 = ("baseline", "full", "no_uv", "coarse", "linear")
"""Rows of the paper's Table 1, in its order, and ours."""
TABLE_2 = ("full", "nerf_pe", "uv_nope", "pe_2d", "pe_1d")
"""Rows of the paper's Table 2, in its order."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelCost:
    """What a model costs at run time. The latent's encoder is not part of it."""

    parameters: int
    """Trained numbers of everything that a receiver runs."""
    per_object_multiply_adds: int
    """Multiply-adds of one frame of one person; biases and activations are not counted."""
    per_pixel_multiply_adds: int
    """Multiply-adds of one pixel; lookups in maps and tables are not counted."""


def pixel_codec_cost(spec: AvatarSpec) -> ModelCost:
    """The cost of a Pixel Codec Avatar: both decoders, the encoding, the two sine networks."""
    layers = [layer for name in spec.decoders for layer in decoder_layers(spec, name)]
    shapes = {n: s for n, s in spec_tensor_shapes(spec).items() if not n.startswith("encoder.")}
    shapes.pop("geometry.mean", None)  # it is measured, not trained
    networks = [shape for name, shape in shapes.items() if name.startswith(("xyz.", "pixel."))]
    return ModelCost(
        parameters=sum(map(prod, shapes.values())),
        per_object_multiply_adds=sum(layer.multiply_adds for layer in layers),
        per_pixel_multiply_adds=sum(prod(shape) for shape in networks if len(shape) == 2),
    )
