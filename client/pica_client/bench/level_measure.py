"""How well an avatar's levels serve, measured on drawn pictures: the table that comes with it.

    errors = measure_levels(avatar)              # LevelErrors; minutes
    measured = with_errors(avatar, errors)       # the same avatar, with the table in it

Truth is the full level drawn with many samples a pixel and averaged. A level, and the full maps on
its mesh, are judged by one drawing at the size of the screen, as the product makes it, but without
smoothed edges: those belong to the display. Judged are the pixels that its drawing or the truth
covers, but for those that the truth covers in part: whether an edge pixel is in or out says nothing
of a level. So a level's lost detail counts, its blur, its sparkle and its silhouettes where they
are off by more than a pixel.

Expressions are moments of shipped performances; each is seen from the front, from a side, from
above and from below. Everything is fixed, so the same avatar gives the same table, on the same
driver to the bit.

The two sensitivities say what it costs to keep maps that are not of this moment: how the picture
changes with the view that an expression map was decoded for, and with the latent, at a head of
`SENSITIVITY_HEAD_PX`. Both are small-change figures: squared errors over squared steps, summed over
the moments before they are divided.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType

import moderngl
import numpy as np
import numpy.typing as npt

from pica_client.bench.render_error import masked_mse
from pica_client.decode.decoder import OnnxDecoder
from pica_client.render.renderer import Renderer, RenderOptions
from pica_client.render.scene import Placement, clip_from_head, view_direction
from pica_client.schedule.visibility import PlacedHead, look
from pica_client.sources import open_source
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.level_tensors import error_tensors
from pica_core.avatar.levels import NUM_DRAWINGS, SENSITIVITY_HEAD_PX, LevelErrors
from pica_core.camera import Camera, look_at
from pica_core.gl import create_context
from pica_core.types import BoolArray, FloatArray, Image

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
"""From a moment to the one that tells of the latent's motion: three frames."""
VIEWS = ((0.0, 0.0), (0.6, 0.05), (-0.25, 0.45), (0.2, -0.4))
"""Yaw and pitch of the camera about the head, radians."""
VIEW_STEP = 0.1
"""Radians of yaw between a view and the one whose expression map is shown in it."""
DISTANCE_M = 1.0
"""From the camera to the middle of the head."""
TRUTH_PX = 2048
"""Truth is drawn with the head about this high, within these numbers of samples a pixel and
direction."""
FEWEST_SAMPLES, MOST_SAMPLES = 2, 8
FRAME_FILL = 0.8
"""Of the image's height, by the head."""
HEAD = np.eye(4, dtype=np.float32)
_COVERED, _PART = 0.999, 0.001


@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    latent: FloatArray
    later: FloatArray
    """`STEP_S` after it."""


def measure_levels(
    avatar: Avatar, progress: Callable[[float], None] = lambda ratio: None
) -> LevelErrors:
    """Measure every level, and the full maps on every mesh, at all heights.

    Args:
        avatar: Checked avatar.
        progress: LayerSubscription how much is done, 0 to 1.

    Raises:
        GraphicsError: No GL context.
    """
    context = create_context()
    try:
        return _Judge(context, avatar).measure(progress)
    finally:
        context.release()


def with_errors(avatar: Avatar, errors: LevelErrors) -> Avatar:
    """The avatar with a table in place of the one that it may have."""
    tensors = dict(avatar.tensors)
    tensors.update(error_tensors(errors))
    return replace(avatar, tensors=MappingProxyType(tensors))


class _Judge:
    def __init__(self, context: moderngl.Context, avatar: Avatar) -> None:
        self._context = context
        self._avatar = avatar
        self._decoder = OnnxDecoder(avatar)
        encoder = ExpressionEncoder(avatar)
        self._moments = []
        for source, second in MOMENTS:
            player = open_source(source)
            latent, later = (
                encoder.encode(player.frame_at(at_s).arkit) for at_s in (second, second + STEP_S)
            )
            self._moments.append(_Moment(latent, later))

    def measure(self, progress: Callable[[float], None]) -> LevelErrors:
        levels = self._avatar.levels
        mse = np.zeros((len(levels), NUM_DRAWINGS, len(HEAD_PX)))
        num_steps = len(HEAD_PX) + 1
        for index, head_px in enumerate(HEAD_PX):
            mse[:, :, index] = self._errors_at(head_px)
            progress((index + 1) / num_steps)
        per_rad2, per_unit2 = self._sensitivities()
        progress(1.0)
        return LevelErrors(
            levels=levels,
            head_px=np.array(HEAD_PX, np.float32),
            mse=mse.astype(np.float32),
            view_mse_per_rad2=per_rad2,
            latent_mse_per_unit2=per_unit2,
        )

    def _errors_at(self, head_px: float) -> FloatArray:
        """MSE ``[L, 2]`` at one height, mean over moments and views."""
        samples = min(max(round(TRUTH_PX / head_px), FEWEST_SAMPLES), MOST_SAMPLES)
        size = 2 * math.ceil(head_px / FRAME_FILL / 2)
        screen, truth = self._renderer(size), self._renderer(size * samples)
        levels = self._avatar.levels
        errors = np.zeros((len(levels), NUM_DRAWINGS), np.float32)
        for yaw, pitch in VIEWS:
            camera = camera_for(self._avatar, head_px, size, yaw, pitch)
            direction = view_direction(HEAD, camera.centre_m)
            fine = camera.scaled(size * samples, size * samples)
            for moment in self._moments:
                full = self._decoder.decode(moment.latent, direction, levels[-1])
                truth.update_maps("head", full.position_map, full.expression_map)
                samples_of, coverage = self._draw(truth, fine)
                wanted = _averaged(samples_of, samples)
                share = _averaged(coverage[..., None], samples)[..., 0]
                for row, level in enumerate(levels):
                    own = self._decoder.decode(moment.latent, direction, level)
                    for column, maps in enumerate((own, full)):
                        screen.update_maps("head", maps.position_map, maps.expression_map)
                        image, covered = self._draw(screen, camera, level)
                        judged = (share >= _COVERED) | (covered & (share <= _PART))
                        errors[row, column] += masked_mse(image, wanted, judged)
        errors /= len(VIEWS) * len(self._moments)
        return errors

    def _sensitivities(self) -> tuple[float, float]:
        """MSE per squared radian of view, and per squared RMS unit of the latent."""
        head_px = SENSITIVITY_HEAD_PX
        size = 2 * math.ceil(head_px / FRAME_FILL / 2)
        renderer, level = self._renderer(size), self._avatar.levels[-1]

        def drawn(
            latent: FloatArray, direction: FloatArray, camera: Camera
        ) -> tuple[Image, BoolArray]:
            maps = self._decoder.decode(latent, direction, level)
            renderer.update_maps("head", maps.position_map, maps.expression_map)
            return self._draw(renderer, camera)

        turned = moved = steps = 0.0
        for yaw, pitch in VIEWS:
            camera = camera_for(self._avatar, head_px, size, yaw, pitch)
            direction = view_direction(HEAD, camera.centre_m)
            earlier = camera_for(self._avatar, head_px, size, yaw + VIEW_STEP, pitch)
            kept = view_direction(HEAD, earlier.centre_m)
            for moment in self._moments:
                now, covered = drawn(moment.latent, direction, camera)
                stale_view, _ = drawn(moment.latent, kept, camera)
                later, also = drawn(moment.later, direction, camera)
                turned += masked_mse(now, stale_view, covered)
                moved += masked_mse(now, later, covered | also)
                steps += float(np.square(moment.later - moment.latent).mean())
        count = len(VIEWS) * len(self._moments)
        return turned / (count * VIEW_STEP**2), moved / steps if steps > 0 else 0.0

    def _renderer(self, size: int) -> Renderer:
        renderer = Renderer(self._context, (size, size), RenderOptions(smooth_edges=False))
        renderer.add_avatar("head", self._avatar)
        return renderer

    def _draw(
        self, renderer: Renderer, camera: Camera, mesh_level: int | None = None
    ) -> tuple[Image, BoolArray]:
        placement = Placement(slot="head", world_from_head=HEAD, mesh_level=mesh_level)
        renderer.draw([placement], camera)
        return renderer.read_image(), renderer.read_surface()[2] >= 0


def camera_for(avatar: Avatar, head_px: float, size: int, yaw: float, pitch: float) -> Camera:
    """A camera that sees a head so many pixels high, as `visibility.look` counts them, in the
    middle of a square image."""
    low = np.array(avatar.manifest.bounds_min_m)
    high = np.array(avatar.manifest.bounds_max_m)
    middle = (low + high) / 2
    away = np.array(
        [
            math.sin(yaw) * math.cos(pitch),
            math.sin(pitch),
            math.cos(yaw) * math.cos(pitch),
        ]
    )
    camera = look_at(
        centre_m=middle + DISTANCE_M * away,
        target_m=middle,
        vertical_fov=0.5,
        width=size,
        height=size,
    )
    head = PlacedHead("head", clip_from_head(camera, HEAD), low.tolist(), high.tolist())
    scale = head_px / look([head], (size, size))["head"].head_px
    focal = np.diag([scale, scale, 1.0])
    centred = np.array([[1, 0, size / 2 * (1 - scale)], [0, 1, size / 2 * (1 - scale)], [0, 0, 1]])
    return replace(camera, intrinsics=centred @ focal @ camera.intrinsics)


def _averaged(image: npt.NDArray[np.generic], samples: int) -> FloatArray:
    """Blocks of samples ``[H * S, W * S, C]`` to pixels ``[H, W, C]``."""
    rows, columns, channels = image.shape
    blocks = image.reshape(rows // samples, samples, columns // samples, samples, channels)
    pixels: FloatArray = blocks.mean(axis=(1, 3), dtype=np.float32)
    return pixels
