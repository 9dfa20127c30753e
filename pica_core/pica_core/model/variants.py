"""Build a model that can be trained from a row of `VARIANTS`."""

from dataclasses import replace

from pica_core.avatar.spec import AvatarSpec
from pica_core.avatar.variants import VARIANTS, Variant
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.baseline import DeepAppearanceModel
from pica_core.model.interface import AvatarModel, FacePrior, ModelOptions


def make_model(
    variant: str,
    spec: AvatarSpec,
    prior: FacePrior,
    options: ModelOptions,
) -> AvatarModel:
    """Build a model of `VARIANTS`.

    Args:
        spec: Sizes of the full model; the row replaces its encoding and geometry.

    Raises:
        ValueError: An unknown variant or encoder.
    """
    if variant not in VARIANTS:
        raise ValueError(f"variant is {variant!r}; known are {', '.join(VARIANTS)}")
    row: Variant = VARIANTS[variant]
    spec = replace(spec, encoding=row.encoding, geometry=row.geometry)
    match row.network:
        case "pixel_codec":
            return PixelCodecAvatar(spec, prior, options, topology=row.topology)
        case "deep_appearance":
            return DeepAppearanceModel(spec, prior, options)
