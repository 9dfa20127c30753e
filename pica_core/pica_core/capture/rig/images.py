"""Images of a rig: decoded, wrapped as their sampler says, and where they are transparent."""

import io

import numpy as np
from PIL import Image, UnidentifiedImageError

from pica_core.capture.dataset.files import IMAGE_FORMATS
from pica_core.capture.rig.gltf_file import missing_wheel
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, ByteArray, Float64Array

MAX_ALBEDO_SIDE = 8192
ALBEDO_MODES = ("RGB", "RGBA", "L", "LA", "P", "PA")
KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"


def open_image(where: str, data: bytes) -> ByteArray:
    """An image as sRGB with alpha, row 0 on top. uint8 ``[H, W, 4]``.

    PNG, JPEG, WebP, or KTX 2 with a Basis Universal payload.
    """
    if data.startswith(KTX2):
        return _open_ktx2(where, data)
    try:
        with Image.open(io.BytesIO(data), formats=IMAGE_FORMATS) as image:
            _check_side(where, image.width, image.height)
            if image.mode not in ALBEDO_MODES:
                raise CaptureError(
                    f"{where}: pixels are {image.mode}; an 8-bit colour image is needed"
                )
            return np.asarray(image.convert("RGBA"))
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:
        raise CaptureError(f"{where}: not a complete image ({error})") from error


def _check_side(where: str, width: int, height: int) -> None:
    if max(width, height) > MAX_ALBEDO_SIDE:
        raise CaptureError(
            f"{where}: {width}x{height} pixels; sides up to {MAX_ALBEDO_SIDE} are allowed"
        )


def _open_ktx2(where: str, data: bytes) -> ByteArray:
    try:
        import opengl_basisu
    except ImportError:
        raise missing_wheel(where, "KHR_texture_basisu") from None
    try:
        texture = opengl_basisu.open(data)
        _check_side(where, texture.width, texture.height)
        return np.asarray(texture.transcode("rgba8").data, np.uint8)
    except ValueError as error:
        raise CaptureError(f"{where}: not a complete KTX 2 image ({error})") from error


def wrapped(uv: Float64Array, wrap: tuple[str, str]) -> Float64Array:
    """Texture coordinates brought into [0, 1] as a sampler does. ``[..., 2]``."""
    rules = {
        "repeat": lambda t: t - np.floor(t),
        "mirror": lambda t: 1 - np.abs(np.mod(t, 2) - 1),
        "clamp": lambda t: np.clip(t, 0, 1),
    }
    return np.stack([rules[how](uv[..., axis]) for axis, how in enumerate(wrap)], -1)


def see_through(
    alpha: Float64Array, cutoff: float, corners: Float64Array, wrap: tuple[str, str]
) -> BoolArray:
    """Triangles of which less than half is as opaque as `cutoff`.

    Args:
        alpha: Opacity 0 to 1, row 0 on top. ``[H, W]``.
        cutoff: Opacity from which on a point is taken for solid.
        corners: Texture coordinates of each triangle, v downwards. ``[F, 3, 2]``.
        wrap: How the image goes on beyond its edges, across and down.
    """
    steps = (np.arange(6) + 0.5) / 6
    a, b = np.meshgrid(steps, steps)
    weights = np.stack([a, b, 1 - a - b], -1)[a + b < 1]
    uv = wrapped(np.einsum("sk,fkc->fsc", weights, corners), wrap)
    height, width = alpha.shape
    column = np.minimum(uv[..., 0] * width, width - 1).astype(np.int64)
    row = np.minimum(uv[..., 1] * height, height - 1).astype(np.int64)
    clear: BoolArray = (alpha[row, column] >= cutoff).mean(1) < 0.5
    return clear
