"""Side by side for two eyes: the left one's picture in the left half, the right one's in the right.
Pure.

Both cameras look the same way, half an eye distance to the left and to the right of the one in the
middle, with their pictures shifted so that what lies as far away as the seats is at the same place
in both: it appears at the depth of the screen, and nothing is turned inwards (which would shift
pixels up and down between the eyes).
"""

from dataclasses import replace

import numpy as np

from pica_core.camera import Camera

EYE_DISTANCE_M = 0.063
"""Between the pupils of an adult, on average."""
MAX_EYE_DISTANCE_M = 0.2


def stereo_cameras(
    camera: Camera, eye_distance_m: float, screen_distance_m: float
) -> tuple[Camera, Camera]:
    """The cameras of the left and of the right eye.

    Args:
        camera: Between the eyes; of one eye's picture.
        eye_distance_m: Between the eyes, metres; 0 gives the same camera twice.
        screen_distance_m: How far before the camera things appear at the depth of the screen.

    Raises:
        ValueError: A distance is out of range.
    """
    if not 0 <= eye_distance_m <= MAX_EYE_DISTANCE_M:
        raise ValueError(
            f"eye distance is {eye_distance_m:g} m; 0 to {MAX_EYE_DISTANCE_M:g} is allowed"
        )
    if not (np.isfinite(screen_distance_m) and screen_distance_m > 0):
        raise ValueError(f"screen distance is {screen_distance_m:g} m; it must be above 0")
    return (
        _moved(camera, -eye_distance_m / 2, screen_distance_m),
        _moved(camera, eye_distance_m / 2, screen_distance_m),
    )


def _moved(camera: Camera, right_m: float, screen_distance_m: float) -> Camera:
    """A camera that has moved to its right, its picture shifted back."""
    centre = camera.centre_m + right_m * camera.rotation[0]
    intrinsics = camera.intrinsics.copy()
    intrinsics[0, 2] += intrinsics[0, 0] * right_m / screen_distance_m
    return replace(camera, intrinsics=intrinsics, translation_m=-np.matmul(camera.rotation, centre))
