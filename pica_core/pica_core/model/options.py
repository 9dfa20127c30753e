"""How a model is made and begins, whatever the person and the sizes."""

from dataclasses import dataclass

from pica_core.model.pixel_decoder import FIRST_FREQUENCY


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelOptions:
    """What is built beside an `AvatarSpec`."""

    encoder: str = "light"
    """"paper" (161.7 G multiply-adds a frame) or "light"."""
    encoding_amplitude: float = 0.1
    """Half-width of the encodings' uniform start; 1 in the paper. Smaller leaves less noise in
    texels that few images saw."""
    first_frequency: float = FIRST_FREQUENCY
    """Scale of the first sine layers."""
    texture_contrast: float = 0.3
    """Begin m_uv with the mean texture, black and white at minus and plus this; 0 for a uniform
    start, as the paper."""
    texture_size: int = 512
    """Rows and columns of the baseline's texture; 1024 in the paper."""
