"""Where a head is and how it is turned, from its landmarks.

The landmarks that do not move with the face are laid upon those of a head at rest by the rotation
of least squares (Kabsch, Acta Crystallographica 32, 1976). That head is the mean of what the
network says of five rendered heads in 120 known poses, both sides made alike
(docs/results/webcam.md). The network overstates depth; a factor mends it, found on the same heads.
"""

from typing import Final

import numpy as np

from pica_core.types import Float64Array, FloatArray

# Landmarks in the middle: height and depth; and pairs, right and left: half width, height, depth.
_MIDDLE: Final = {
    10: (0.678, 0.314),
    151: (0.431, 0.366),
    9: (0.190, 0.400),
    8: (0.042, 0.382),
    168: (-0.111, 0.379),
    6: (-0.252, 0.443),
    197: (-0.369, 0.517),
    195: (-0.474, 0.594),
    5: (-0.586, 0.674),
    4: (-0.720, 0.711),
}
_PAIRS: Final = {
    (109, 338): (0.319, 0.670, 0.288),
    (67, 297): (0.592, 0.627, 0.194),
    (54, 284): (1.002, 0.389, -0.152),
    (21, 251): (1.104, 0.203, -0.329),
    (103, 332): (0.839, 0.533, 0.032),
    (33, 263): (0.752, -0.177, 0.060),
    (133, 362): (0.288, -0.215, 0.144),
    (127, 356): (1.173, -0.246, -0.658),
    (234, 454): (1.168, -0.479, -0.724),
    (93, 323): (1.157, -0.719, -0.734),
    (162, 389): (1.154, 0.000, -0.512),
}
_INDICES = np.array([*_MIDDLE, *(right for right, _ in _PAIRS), *(left for _, left in _PAIRS)])
_HEAD = np.array(
    [
        *((0.0, *place) for place in _MIDDLE.values()),
        *((-x, y, z) for x, y, z in _PAIRS.values()),
        *((x, y, z) for x, y, z in _PAIRS.values()),
    ]
)
_HEAD -= _HEAD.mean(0)
DEPTH_FACTOR: Final = 0.8
UNIT_M: Final = 0.06
"""Length of 1 in the table above: the outer corners of adults' eyes are 90 mm apart."""
FOCAL_LENGTH: Final = 0.9
"""How long a usual webcam's is, in widths of its picture (chosen: it sees 58 degrees)."""


def head_pose(landmarks: FloatArray, width: int, height: int) -> tuple[FloatArray, FloatArray]:
    """Find the pose of a head.

    Args:
        landmarks: Columns, rows and depths in pixels, the picture not mirrored. float32 ``[478,
            3]``.
        width: Of the picture, pixels.
        height: Of the picture, pixels.

    Returns:
        Its rotation vector in radians, and its place before the camera in metres, both in the axes
        of a head that looks at the camera: +x the subject's left, +y up, +z towards the camera.
        float32 ``[3]`` each. The place supposes an adult's head and a usual camera.
    """
    points = landmarks[_INDICES] * [1.0, -1.0, -DEPTH_FACTOR]
    middle = points.mean(0)
    points = points - middle
    u, _, v = np.linalg.svd(_HEAD.T @ points)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    rotation = v.T @ mirror @ u.T
    unit_px = float(np.sqrt((points**2).sum() / (_HEAD**2).sum()))
    focal_px = FOCAL_LENGTH * width
    distance_m = focal_px * UNIT_M / max(unit_px, 1e-6)
    x, y = (middle[:2] - [width / 2, -height / 2]) * distance_m / focal_px
    return _rotation_vector(rotation), np.array([x, y, -distance_m], np.float32)


def _rotation_vector(matrix: Float64Array) -> FloatArray:
    """Axis times angle of a rotation by less than half a turn."""
    turned = np.array(
        [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    )
    sine, cosine = np.linalg.norm(turned) / 2, (np.trace(matrix) - 1) / 2
    scale = np.arctan2(sine, cosine) / max(2 * sine, 1e-9) if sine > 1e-9 else 0.5
    return np.asarray(turned * scale, np.float32)
