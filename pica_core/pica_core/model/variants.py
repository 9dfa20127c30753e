"""Build a model that can be trained from a row of `VARIANTS`."""

from dataclasses import replace

from pica_core.avatar.spec import AvatarSpec
from pica_core.avatar.variants import VARIANTS, Variant
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.baseline import DeepAppearanceModel
from pica_core.model.interface import AvatarModel, FacePrior
from pica_core.model.pixel_decoder import FIRST_FREQUENCY

__all__ = ["VARIANTS", "make_model"]


def make_model(
    variant: str,
    spec: AvatarSpec,
    prior: FacePrior,
    *,
    encoder: str = "light",
    encoding_amplitude: float = 1.0,
    first_frequency: float = FIRST_FREQUENCY,
    texture_contrast: float = 0.0,
    texture_size: int = 1024,
) -> AvatarModel:
    """Build a model.

    Args:
        variant: A key of `VARIANTS`.
        spec: Sizes of the full model; the row replaces its encoding and geometry.
        prior: What is known of the person.
        encoder: "paper" or "light".
        encoding_amplitude: Half-width of the learned encodings' uniform start.
        first_frequency: Scale of the first sine layers.
        texture_contrast: Contrast of the mean texture that m_uv begins with; 0 for a uniform start.
        texture_size: Side of the baseline's texture, texels.

    Raises:
        ValueError: An unknown variant or encoder.
    """
    if variant not in VARIANTS:
        raise ValueError(f"variant is {variant!r}; known are {', '.join(VARIANTS)}")
    row: Variant = VARIANTS[variant]
    spec = replace(spec, encoding=row.encoding, geometry=row.geometry)
    match row.network:
        case "pixel_codec":
            return PixelCodecAvatar(
                spec,
                prior,
                topology=row.topology,
                encoder=encoder,
                encoding_amplitude=encoding_amplitude,
                first_frequency=first_frequency,
                texture_contrast=texture_contrast,
            )
        case "deep_appearance":
            return DeepAppearanceModel(spec, prior, encoder=encoder, texture_size=texture_size)
