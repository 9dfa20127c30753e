"""Pinhole cameras in the OpenCV convention, and the one bridge from there to GL clip space.

Camera axes: x right, y down, z forward. `rotation` and `translation_m` take head-frame (or world)
points to camera axes. Pixel centres lie at integer + 0.5; image row 0 is the top row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pica_core.errors import ShapeError
from pica_core.types import Float64Array, FloatArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Camera:
    """A calibrated pinhole camera without distortion.

    Attributes:
        name: Camera name, unique within a capture.
        intrinsics: Focal lengths and principal point in pixels. float64 ``[3, 3]``.
        rotation: World-to-camera rotation. float64 ``[3, 3]``.
        translation_m: World-to-camera translation in metres. float64 ``[3]``.
        width: Image columns, pixels.
        height: Image rows, pixels.
    """

    name: str
    intrinsics: Float64Array
    rotation: Float64Array
    translation_m: Float64Array
    width: int
    height: int

    @property
    def centre_m(self) -> Float64Array:
        """Camera centre in world coordinates, metres. float64 ``[3]``."""
        centre: Float64Array = -self.rotation.T @ self.translation_m
        return centre

    def project(self, points_m: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Project world points in metres, ``[..., 3]``.

        Returns:
            Pixel coordinates (x right, y down) float64 ``[..., 2]`` and depths in metres float64
            ``[...]``.
            Not checked: points behind the camera have negative depth and meaningless pixels.
        """
        points = np.asarray(points_m, np.float64)
        if points.shape[-1] != 3:
            raise ShapeError(f"points_m is {points.shape}; the last dimension must be 3")
        seen = points @ self.rotation.T + self.translation_m
        image = seen @ self.intrinsics.T
        return image[..., :2] / image[..., 2:], seen[..., 2]

    def clip_from_world(self, near_m: float = 0.02, far_m: float = 20.0) -> FloatArray:
        """The matrix from world metres to GL clip space, for columns. float32 ``[4, 4]``.

        GL's window rows count upwards, images' downwards; this matrix keeps +y up in clip space, so
        row 0 of what GL reads back is the *bottom* image row. Readers flip once.
        """
        k = self.intrinsics
        w, h = self.width, self.height
        projection = np.zeros((4, 4))
        projection[0] = [2 * k[0, 0] / w, 2 * k[0, 1] / w, 2 * k[0, 2] / w - 1, 0]
        projection[1] = [0, -2 * k[1, 1] / h, 1 - 2 * k[1, 2] / h, 0]
        depth = far_m - near_m
        projection[2] = [0, 0, (far_m + near_m) / depth, -2 * far_m * near_m / depth]
        projection[3] = [0, 0, 1, 0]
        view = np.eye(4)
        view[:3, :3] = self.rotation
        view[:3, 3] = self.translation_m
        return (projection @ view).astype(np.float32)

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera with another image size; the field of view stays if the aspect does."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=scale @ self.intrinsics, width=width, height=height)

    def in_head(self, head_to_world: npt.ArrayLike) -> Camera:
        """The camera in the axes of a head with this rotation and translation, metres ``[3, 4]``:
        what it sees of head-frame points."""
        pose = np.asarray(head_to_world, np.float64)
        return replace(
            self,
            rotation=self.rotation @ pose[:, :3],
            translation_m=self.rotation @ pose[:, 3] + self.translation_m,
        )


def look_at(
    *,
    name: str = "camera",
    centre_m: npt.ArrayLike,
    target_m: npt.ArrayLike,
    vertical_fov: float,
    width: int,
    height: int,
) -> Camera:
    """A camera at `centre_m` that looks at `target_m`; the world's y points up in its image.

    Args:
        centre_m: Camera centre, world metres.
        target_m: Point that lands in the image centre, world metres.
        vertical_fov: Full vertical field of view, radians.

    Raises:
        ValueError: `centre_m` equals `target_m`, or the camera looks straight up or down.
    """
    centre = np.asarray(centre_m, np.float64)
    forward = np.asarray(target_m, np.float64) - centre
    distance = float(np.linalg.norm(forward))
    right = np.cross(forward, (0.0, 1.0, 0.0))
    sideways = float(np.linalg.norm(right))
    if distance == 0 or sideways < 1e-9 * distance:
        raise ValueError(f"look_at from {centre} along {forward}: no direction is to the right")
    z = forward / distance
    x = right / sideways
    rotation = np.stack([x, np.cross(z, x), z])
    focal = 0.5 * height / np.tan(0.5 * vertical_fov)
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(
        name=name,
        intrinsics=intrinsics,
        rotation=rotation,
        translation_m=-rotation @ centre,
        width=width,
        height=height,
    )
