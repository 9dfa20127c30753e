"""What the texture of a static surface shows, in plain numpy: the judge of the one in GLSL."""

import numpy as np
import numpy.typing as npt

from pica_core.avatar.file import Avatar
from pica_core.reference.decoders import still_map
from pica_core.reference.pixel import decode_pixels
from pica_core.reference.sampling import sample_bilinear
from pica_core.types import Array


def still_colours(avatar: Avatar, xyz_m: npt.ArrayLike, uv: npt.ArrayLike) -> Array:
    """Colours of a face that does not move, seen from the front, RGB 0 to 1, ``[..., 3]``.

    Args:
        xyz_m: Places of the mesh at rest, head frame, metres. ``[..., 3]``.
        uv: Their texture coordinates. ``[..., 2]``.

    Raises:
        ValueError: The avatar has no still face.
    """
    still = still_map(avatar)
    if still is None:
        raise ValueError("the avatar has no tensor level.still")
    codes = sample_bilinear(still, uv)
    rgb: Array = np.clip(decode_pixels(avatar.spec, avatar.tensors, codes, xyz_m, uv), 0, 1)
    return rgb
