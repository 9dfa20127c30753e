"""How well an avatar's levels serve, measured on drawn pictures: the table that comes with it.

Truth is the full level drawn with many samples a pixel and averaged. A level, and the full maps on
its mesh, are compared with it by one drawing at the size of the screen, as the product makes it but
without smoothed edges. What counts are the pixels that its drawing or the truth covers, but for
those that the truth covers in part: whether an edge pixel is in or out says nothing of a level. So
a level's lost detail counts, its blur, its sparkle and its silhouettes where they are off by more
than a pixel.

Expressions are moments of shipped performances; each is seen from the front, from a side, from
above and from below. Everything is fixed, so the same avatar gives the same table, on the same
driver to the bit.

The two sensitivities say what it costs to keep maps that are not of this moment: how the picture
changes with the view that an expression map was decoded for, and with the latent, at a head of
`SENSITIVITY_HEAD_PX`. Both are small-change figures: squared errors over squared steps, summed over
the moments before they are divided.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.drawing import HEAD, HeadRenderer, drawn_mse, masked_mse
from pica_client.render.scene import clip_from_head, view_direction
from pica_client.schedule.visibility import PlacedHead, look
from pica_client.sources import open_source
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.level_tensors import error_tensors
from pica_core.avatar.levels import NUM_DRAWINGS, SENSITIVITY_HEAD_PX, LevelErrors
from pica_core.camera import Camera, look_at
from pica_core.gl import create_context
from pica_core.types import FloatArray

HEAD_PX = (32.0, 64.0, 128.0, 256.0, 512.0, 1024.0)
"""Heights of the table: a face across a hall to one that fills the screen."""
MOMENTS = (
    ("performance:talk", 3.0),
    ("performance:talk", 8.5),
    ("performance:range_of_motion", 4.0),
    ("performance:range_of_motion", 11.0),
)
"""Source and second of each expression (chosen: two calm, two wide ones)."""
STEP_S = 0.1
"""Seconds from a moment to the one that tells of the latent's motion: three frames."""
VIEWS = ((0.0, 0.0), (0.6, 0.05), (-0.25, 0.45), (0.2, -0.4))
"""Yaw and pitch of the camera about the head, radians."""
VIEW_STEP = 0.1
"""Radians of yaw between a view and the one whose expression map is shown in it."""
DISTANCE_M = 1.0
"""Metres from the camera to the middle of the head."""
TRUTH_PX = 2048
"""Truth is drawn with the head about this high, within these numbers of samples a pixel and
direction."""
FEWEST_SAMPLES, MOST_SAMPLES = 2, 8
FRAME_FILL = 0.8
"""Part of the image's height that the head takes."""
_COVERED, _PART = 0.999, 0.001


def measure_levels(
    avatar: Avatar, progress: Callable[[float], None] = lambda ratio: None
) -> LevelErrors:
    """Measure every level, and the full maps on every mesh, at all heights.

    Args:
        progress: Called with the share that is done, 0 to 1.

    Raises:
        GraphicsError: No GL context.
    """
    context = create_context()
    try:
        return _Measurement(context, avatar).run(progress)
    finally:
        context.release()


def with_errors(avatar: Avatar, errors: LevelErrors) -> Avatar:
    """The avatar with a table in place of the one that it may have."""
    tensors = dict(avatar.tensors) | error_tensors(errors)
    return replace(avatar, tensors=MappingProxyType(tensors))


class _Measurement:
    def __init__(self, context: moderngl.Context, avatar: Avatar) -> None:
        self._context, self._avatar = context, avatar
        self._decoder = OnnxDecoder(avatar)
        encoder = ExpressionEncoder(avatar)
        # The latent of each moment, and the one `STEP_S` after it.
        self._moments: list[tuple[FloatArray, FloatArray]] = []
        for source, second in MOMENTS:
            frame_at = open_source(source).frame_at
            now, later = (encoder.encode(frame_at(second + s).arkit) for s in (0.0, STEP_S))
            self._moments.append((now, later))

    def run(self, progress: Callable[[float], None]) -> LevelErrors:
        levels = self._avatar.levels
        mse = np.zeros((len(levels), NUM_DRAWINGS, len(HEAD_PX)), np.float32)
        for index, head_px in enumerate(HEAD_PX):
            mse[:, :, index] = self._errors_at(head_px)
            progress((index + 1) / (len(HEAD_PX) + 1))
        per_rad2, per_unit2 = self._sensitivities()
        progress(1.0)
        return LevelErrors(
            levels=levels,
            head_px=np.array(HEAD_PX, np.float32),
            mse=mse,
            view_mse_per_rad2=per_rad2,
            latent_mse_per_unit2=per_unit2,
        )

    def _errors_at(self, head_px: float) -> FloatArray:
        """MSE ``[L, 2]`` at one height, mean over moments and views."""
        samples = min(max(round(TRUTH_PX / head_px), FEWEST_SAMPLES), MOST_SAMPLES)
        size = _image_size(head_px)
        screen = HeadRenderer(self._context, self._avatar, size)
        truth = HeadRenderer(self._context, self._avatar, size * samples)
        levels = self._avatar.levels
        errors = np.zeros((len(levels), NUM_DRAWINGS), np.float32)
        for yaw, pitch in VIEWS:
            camera = camera_for(self._avatar, head_px, size, yaw, pitch)
            direction = view_direction(HEAD, camera.centre_m)
            fine = camera.scaled(size * samples, size * samples)
            for latent, _ in self._moments:
                full = self._decoder.decode(latent, direction, levels[-1])
                drawn = truth.draw(full, fine)
                wanted = averaged(drawn.image, samples)
                share = averaged(drawn.covered[..., None], samples)[..., 0]
                for row, level in enumerate(levels):
                    own = self._decoder.decode(latent, direction, level)
                    for column, maps in enumerate((own, full)):
                        image, covered = screen.draw(maps, camera, mesh_level=level)
                        counted = (share >= _COVERED) | (covered & (share <= _PART))
                        errors[row, column] += masked_mse(image, wanted, counted)
        errors /= len(VIEWS) * len(self._moments)
        return errors

    def _sensitivities(self) -> tuple[float, float]:
        """MSE per squared radian of view, and per squared RMS unit of the latent."""
        head_px = SENSITIVITY_HEAD_PX
        size = _image_size(head_px)
        renderer = HeadRenderer(self._context, self._avatar, size)
        turned = moved = steps = 0.0
        for yaw, pitch in VIEWS:
            camera = camera_for(self._avatar, head_px, size, yaw, pitch)
            earlier = camera_for(self._avatar, head_px, size, yaw + VIEW_STEP, pitch)
            direction, kept = (view_direction(HEAD, each.centre_m) for each in (camera, earlier))
            for latent, next_latent in self._moments:
                now, stale_view, later = (
                    renderer.draw(self._decoder.decode(shown, seen_from), camera)
                    for shown, seen_from in (
                        (latent, direction),
                        (latent, kept),
                        (next_latent, direction),
                    )
                )
                turned += masked_mse(now.image, stale_view.image, now.covered)
                moved += drawn_mse(now, later)
                steps += float(np.square(next_latent - latent).mean())
        count = len(VIEWS) * len(self._moments)
        return turned / (count * VIEW_STEP**2), moved / steps if steps > 0 else 0.0


def _image_size(head_px: float) -> int:
    """Rows and columns, even, of an image that a head fills to `FRAME_FILL`."""
    return 2 * math.ceil(head_px / FRAME_FILL / 2)


def camera_for(avatar: Avatar, head_px: float, size: int, yaw: float, pitch: float) -> Camera:
    """A camera that sees a head so many pixels high, as `visibility.look` counts them, in the
    middle of a square image."""
    low = np.array(avatar.manifest.bounds_min_m)
    high = np.array(avatar.manifest.bounds_max_m)
    middle = (low + high) / 2
    flat = math.cos(pitch)
    away = np.array([math.sin(yaw) * flat, math.sin(pitch), math.cos(yaw) * flat])
    camera = look_at(
        centre_m=middle + DISTANCE_M * away,
        target_m=middle,
        vertical_fov=0.5,
        width=size,
        height=size,
    )
    head = PlacedHead(clip_from_head(camera, HEAD), low.tolist(), high.tolist())
    scale = head_px / look([head], (size, size))[0].head_px
    focal = np.diag([scale, scale, 1.0])
    centred = np.array([[1, 0, size / 2 * (1 - scale)], [0, 1, size / 2 * (1 - scale)], [0, 0, 1]])
    return replace(camera, intrinsics=centred @ focal @ camera.intrinsics)


def averaged(image: npt.NDArray[np.generic], samples: int) -> FloatArray:
    """Blocks of samples ``[H * S, W * S, C]`` to pixels ``[H, W, C]``."""
    rows, columns, channels = image.shape
    blocks = image.reshape(rows // samples, samples, columns // samples, samples, channels)
    pixels: FloatArray = blocks.mean(axis=(1, 3), dtype=np.float32)
    return pixels
