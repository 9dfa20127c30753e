"""Colours of a person's skin: from pictures to what the stage is given, and what they tell."""

from typing import Final

import numpy as np

from pica_core.capture.person.choices import SKIN_TONES
from pica_core.capture.rig.features import Features
from pica_core.types import BoolArray, ByteArray, Float64Array

STAGE_LIGHT: Final = np.array([1.62, 1.55, 1.49])
"""Mean light of the stage on a face (measured on drawn people)."""


def linear(srgb: Float64Array | ByteArray) -> Float64Array:
    """Linear colours of sRGB ones, 0 to 255."""
    value = np.asarray(srgb, np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def unlit(colour: Float64Array) -> Float64Array:
    """What the stage must be given to show a linear colour: its tone curve backwards."""
    y = np.minimum(colour, 0.98)
    # y = x (1 + 0.16 x) / (1 + 0.42 x)
    half = 0.5 * (1 - 0.42 * y) / 0.16
    x = -half + np.sqrt(half**2 + y / 0.16)
    return np.asarray(x / 0.92 / STAGE_LIGHT)


def stored(albedo: Float64Array) -> ByteArray:
    """Linear colours as a fitted head's texture holds them."""
    return np.rint(255 * np.clip(albedo, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def skin_colours(
    albedo: Float64Array, face: BoolArray, places: Float64Array, lips: Float64Array,
    features: Features,
) -> tuple[dict[str, tuple[float, ...]], float]:  # fmt: skip
    """Colours of skin, lips and brows by their names in `PAINT`, and the nearest tone, 1 to 6.

    Args:
        albedo: Of texels, linear. ``[T, 3]``.
        face: Those of the inner face that are seen. ``[T]``.
        places: Where they lie, head frame. ``[T, 3]``.
        lips: How deep in the lips, see `Features.lips`. ``[T]``.
    """
    x, y = np.abs(places[:, 0]), places[:, 1]
    cheek = face & (lips < -0.8) & (y < 0.005) & (y > -0.06)
    rest = cheek if cheek.sum() > 100 else face
    skin = np.median(albedo[rest], axis=0) if rest.any() else np.array(SKIN_TONES[1])
    look = {"skin_rgb": _as_colour(skin)}
    if (mouth := face & (lips > 0.3)).sum() > 50:
        look["lip_rgb"] = _as_colour(np.median(albedo[mouth], axis=0))
    brow = face & (np.abs(y - features.brow_y) < 0.008) & (x > 0.015) & (x < 0.05)
    if brow.sum() > 50:
        bright = albedo[brow].sum(1)
        dark = np.median(albedo[brow][bright <= np.quantile(bright, 0.25)], axis=0)
        look["brow_rgb"] = _as_colour(np.minimum(dark, 0.12))
    steps = np.linspace(1, 6, 51)
    tones = [np.interp(steps, np.arange(1, 7), np.array(SKIN_TONES)[:, k]) for k in range(3)]
    apart = np.linalg.norm(np.log(np.stack(tones, 1)) - np.log(np.maximum(skin, 1e-3)), axis=1)
    return look, float(steps[apart.argmin()])


def _as_colour(rgb: Float64Array) -> tuple[float, ...]:
    return tuple(np.round(np.clip(rgb, 0.005, 0.9), 4).tolist())


def nearest_name(table: dict[str, tuple[float, float, float]], rgb: Float64Array) -> str:
    """The name of the nearest colour of a table such as `choices.EYE_COLOURS`."""
    wanted = np.log(np.maximum(rgb, 1e-3))
    return min(table, key=lambda name: float(np.linalg.norm(np.log(table[name]) - wanted)))
