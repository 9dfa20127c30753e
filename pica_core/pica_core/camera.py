"""Pinhole cameras in the OpenCV convention, and the one bridge from there to GL clip space.

Camera axes: x right, y down, z forward. `rotation` and `translation_m` take head-frame (or world)
points to camera axes. Pixel centres lie at integer + 0.5; image row 0 is the top row.

The dome is cameras on a section of a sphere around the front of a head. Five evaluation views bear
names (front, up, down, left, right; left is the camera on the subject's left). Two plans fill the
rest:

- ``mixed`` lenses: three more look at mouth, eyes and bust, and the others take turns at what they
  look at. Few cameras of few pixels then show small parts, too.
- ``one`` lens: all have the same lens and look at the head, as in the paper's dome of 40 cameras of
  50 mm. Where those stood is not published; ours fill the section evenly.
"""

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
        return -self.rotation.T @ self.translation_m

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

    def lift(self, pixels: npt.ArrayLike, depth_m: npt.ArrayLike) -> Float64Array:
        """World points that pixels ``[..., 2]`` show at depths ``[...]``, metres. ``[..., 3]``."""
        depth = np.asarray(depth_m, np.float64)[..., None]
        image = np.concatenate([np.asarray(pixels, np.float64), np.ones_like(depth)], -1)
        seen = image @ np.linalg.inv(self.intrinsics).T * depth
        return (seen - self.translation_m) @ self.rotation

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

    def scaled(self, width: int, height: int) -> "Camera":
        """The same camera with another image size; the field of view stays if the aspect does."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=scale @ self.intrinsics, width=width, height=height)

    def in_head(self, head_to_world: npt.ArrayLike) -> "Camera":
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


EVALUATION_VIEWS: dict[str, tuple[float, float]] = {
    "front": (0.0, 0.0),
    "up": (0.0, 32.0),
    "down": (0.0, -28.0),
    "left": (52.0, 4.0),
    "right": (-52.0, 4.0),
}
"""Azimuth towards the subject's left and elevation of the paper's five views, degrees."""
AIMS: dict[str, tuple[tuple[float, float, float], float]] = {
    "head": ((0.0, -0.008, 0.02), 0.35),
    "mouth": ((0.0, -0.045, 0.085), 0.12),
    "eyes": ((0.0, 0.03, 0.075), 0.13),
    "bust": ((0.0, -0.15, 0.0), 0.40),
}
"""What a camera can look at, head frame, and what the shorter side of its image covers there,
metres."""
DISTANCE_M = 1.0
NAMED_VIEWS: tuple[tuple[str, float, float, str], ...] = (
    *((name, *EVALUATION_VIEWS[name], "head") for name in ("front", "left", "right", "up", "down")),
    ("mouth", 0.0, -4.0, "mouth"),
    ("eyes", 0.0, 2.0, "eyes"),
    ("bust", 0.0, 12.0, "bust"),
)
"""Name, azimuth, elevation (degrees) and aim of the first cameras."""
LENSES = ("mixed", "one")
FILLING_AIMS = ("head", "bust", "head", "eyes", "head", "mouth")
"""Aims of the cameras after the named ones, in turn."""


def aimed_camera(
    name: str, azimuth: float, elevation: float, aim: str, *, width: int, height: int
) -> Camera:
    """Return a camera on the dome, at so many degrees, that one of `AIMS` fills."""
    a, e = np.radians(azimuth), np.radians(elevation)
    target, reach = np.array(AIMS[aim][0]), AIMS[aim][1]
    away = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    span = reach * height / min(width, height)
    return look_at(
        name=name,
        centre_m=target + DISTANCE_M * away,
        target_m=target,
        vertical_fov=2 * np.arctan(0.5 * span / DISTANCE_M),
        width=width,
        height=height,
    )


def dome_cameras(count: int, width: int, height: int, lenses: str = "mixed") -> tuple[Camera, ...]:
    """The first `count` cameras of the dome: the named views, then an even filling; `lenses` is one
    of `LENSES`."""
    one = lenses == "one"
    plan = list(NAMED_VIEWS[: len(EVALUATION_VIEWS)] if one else NAMED_VIEWS)
    golden = 0.618033988749895
    for index in range(max(count - len(plan), 0)):
        # Low-discrepancy filling of azimuth and elevation; more cameras leave the first ones where
        # they are.
        azimuth = -75.0 + 150.0 * ((0.5 + index * golden) % 1.0)
        elevation = -30.0 + 66.0 * ((0.25 + index * 0.7548776662466927) % 1.0)
        aim = "head" if one else FILLING_AIMS[index % len(FILLING_AIMS)]
        if aim in ("mouth", "eyes"):
            azimuth, elevation = 0.5 * azimuth, 0.5 * elevation
        plan.append((f"dome{index:02d}", azimuth, elevation, aim))
    return tuple(
        aimed_camera(name, azimuth, elevation, aim, width=width, height=height)
        for name, azimuth, elevation, aim in plan[:count]
    )
