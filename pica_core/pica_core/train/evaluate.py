"""Held-out error by the paper's protocol, at the size of one table row per view.

MSE is on 0-255 values over the rasterised pixels of the decoded mesh, on frames that training never
saw, averaged over frames (paper, section 6). SSIM is the mean over frames of the same pixels.
Intervals are 95 % bootstrap intervals over frames.
"""

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from pica_core.camera import Camera
from pica_core.errors import CaptureError
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import AvatarModel
from pica_core.train.data import TrainingData, spaced, view_direction
from pica_core.train.pixels import MeshDrawer
from pica_core.train.raster import Rasteriser, Views
from pica_core.train.train import Trainer
from pica_core.types import Array, BoolArray, Float64Array, FloatArray, Int64Array

WHITE = 255.0
SSIM_SIGMA_PX = 1.5
SSIM_REACH_PX = 5
"""Gaussian window of 11 x 11 pixels (Wang et al., "Image Quality Assessment", 2004, section
III-B)."""
SSIM_CONSTANTS = ((0.01 * WHITE) ** 2, (0.03 * WHITE) ** 2)
RESAMPLES = 2000
"""Draws of the bootstrap: the ends of a 95 % interval are good to a few percent of its width."""


def mse(predicted: Array, observed: Array) -> float:
    """Mean squared difference over pixels and channels, ``[P, 3]`` both."""
    return float(np.square(predicted.astype(np.float64) - observed).mean())


def ssim(predicted: Array, observed: Array, covered: BoolArray) -> float:
    """Mean structural similarity of the covered pixels, channel by channel.

    Args:
        predicted: ``[H, W, 3]``; outside the covered pixels it should hold what `observed` holds,
            so that windows across the rim compare like with like.
        observed: ``[H, W, 3]``.
        covered: Which pixels count, ``[H, W]``; 1 where none does.
    """
    if not covered.any():
        return 1.0
    rows, columns = (np.flatnonzero(covered.any(axis)) for axis in (1, 0))
    box = tuple(
        slice(max(0, index[0] - SSIM_REACH_PX), index[-1] + SSIM_REACH_PX + 1)
        for index in (rows, columns)
    )
    a = predicted[box].astype(np.float64)
    b = observed[box].astype(np.float64)
    c1, c2 = SSIM_CONSTANTS
    mean_a, mean_b = _blur(a), _blur(b)
    variance_a = _blur(a * a) - mean_a**2
    variance_b = _blur(b * b) - mean_b**2
    covariance = _blur(a * b) - mean_a * mean_b
    similar = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    similar /= (mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2)
    return float(similar[covered[box]].mean())


def bootstrap_interval(values: npt.ArrayLike) -> tuple[float, float]:
    """The 95 % percentile interval of the mean of frames' values ``[T]``, over resamples of them
    with repetition.

    Frames are taken as independent; those of one take are not quite, so for them it is a little
    narrow.
    """
    array = np.asarray(values, np.float64)
    chosen = np.random.default_rng(0).integers(len(array), size=(RESAMPLES, len(array)))
    low, high = np.percentile(array[chosen].mean(1), [2.5, 97.5])
    return float(low), float(high)


def _blur(image: Float64Array) -> Float64Array:
    """Gaussian means; beyond the border the last pixel goes on."""
    return gaussian_filter(image, SSIM_SIGMA_PX, mode="nearest", radius=SSIM_REACH_PX, axes=(0, 1))


Source = Literal["encoder", "driver"]
SOURCES: tuple[Source, ...] = ("encoder", "driver")


class Picture(NamedTuple):
    """The P pixels of an image that a mesh covers, in reading order.

    Attributes:
        pixels: Flat indices, row * W + column, int64 ``[P]``.
        colours: 0-255, clamped, float32 ``[P, 3]``.
    """

    pixels: Int64Array
    colours: FloatArray

    def on(self, image: npt.NDArray[np.generic]) -> FloatArray:
        """The picture laid over an image, ``[H, W, 3]``."""
        laid: FloatArray = image.astype(np.float32)
        laid.reshape(-1, 3)[self.pixels] = self.colours
        return laid

    def covered(self, camera: Camera) -> BoolArray:
        """Which pixels of the image these are, ``[H, W]``."""
        mask = np.zeros(camera.height * camera.width, np.bool_)
        mask[self.pixels] = True
        return mask.reshape(camera.height, camera.width)


class ModelEvaluator:
    """Draws a model's pictures of latents and of a capture's frames; the rasteriser, made for the
    topology that the model draws, stays its owner's."""

    def __init__(self, data: TrainingData, model: AvatarModel, rasteriser: Rasteriser) -> None:
        topology = data.meshes.topology(model.topology)
        self.data = data
        self.model = model
        self._device = next(model.parameters()).device
        self._drawer = MeshDrawer(rasteriser, topology, device=self._device)

    @torch.no_grad()
    def latent(self, frame: int, source: Source) -> Tensor:
        """The encoder's mean for a frame, or what a live sender would send, ``[1, 4, 8, 8]``."""
        if source == "driver":
            return self.model.expression_encoder(self.data.arkit[[frame]].to(self._device))
        texture = self.data.images.texture(frame, self.model.encoder.texture_size)
        given = [
            each[None].to(self._device) for each in (texture, self.data.meshes.position_map(frame))
        ]
        return self.model.encoder(*given)[0]

    @torch.no_grad()
    def vertices_m(self, latent: Tensor) -> FloatArray:
        """Decoded vertices of one latent, on the topology that the model draws, ``[V, 3]``."""
        return self.model.vertices(latent)[0].cpu().numpy()

    @torch.no_grad()
    def draw(
        self, latent: Tensor, camera: Camera, *, vertices_m: FloatArray | None = None
    ) -> Picture:
        """The picture of one latent through a camera in head axes.

        Args:
            latent: ``[1, 4, 8, 8]``.
            camera: In head axes.
            vertices_m: What `vertices_m` gives of this latent, if it is known already.
        """
        found_m = torch.from_numpy(self.vertices_m(latent) if vertices_m is None else vertices_m)
        direction = torch.from_numpy(view_direction(camera))[None].to(self._device)
        appearance = self.model.appearance(latent, direction)
        found_m = found_m[None].to(self._device)
        drawn = self._drawer.draw(found_m, Views.of([camera], found_m))
        colours = self.model.shade(appearance, drawn.surface)[drawn.is_drawn]
        shown = 255 * colours.clamp(0, 1).cpu().numpy()
        return Picture(drawn.pixels[drawn.is_drawn].cpu().numpy(), shown.astype(np.float32))


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewErrors:
    """What was measured in one view, a value for each frame that it has."""

    mse: list[float] = field(default_factory=list)
    ssim: list[float] = field(default_factory=list)

    def row(self) -> dict[str, Any]:
        """Means, with the interval of the first."""
        low, high = bootstrap_interval(self.mse)
        return {
            "mse": float(np.mean(self.mse)),
            "mse_low": low,
            "mse_high": high,
            "ssim": float(np.mean(self.ssim)),
            "frames": len(self.mse),
        }


def measure_views(
    evaluator: ModelEvaluator, frames: list[int], source: Source = "encoder"
) -> dict[str, ViewErrors]:
    """Draw frames from all evaluation views, and measure.

    Args:
        source: Whose latents: the model's own encoder's, as in the paper, or what a live sender
            makes of ARKit values.

    Returns:
        Errors by view, of those views that have an image of any of the frames.

    Raises:
        CaptureError: No view has one, or one cannot be read.
    """
    data = evaluator.data
    found = {view: ViewErrors() for view in data.images.evaluation_views}
    for frame in frames:
        latent = evaluator.latent(frame, source)
        for view, errors in found.items():
            if view not in data.images.cameras_of(frame):
                continue
            camera, image = data.images.camera(frame, view), data.images.image(frame, view)
            picture = evaluator.draw(latent, camera)
            if data.capture.has_masks:
                shown = data.images.mask(frame, view).reshape(-1)[picture.pixels]
                picture = Picture(picture.pixels[shown], picture.colours[shown])
                if not shown.any():
                    continue
            errors.mse.append(mse(picture.colours, image.reshape(-1, 3)[picture.pixels]))
            errors.ssim.append(ssim(picture.on(image), image, picture.covered(camera)))
    measured = {view: errors for view, errors in found.items() if errors.mse}
    if not measured:
        raise CaptureError(
            f"{data.capture.path}: no evaluation view has an image of the frames to measure on"
        )
    return measured


def evaluate(
    trainer: Trainer, *, max_frames: int = 25, sources: tuple[Source, ...] = SOURCES
) -> list[dict[str, Any]]:
    """Measure a run on evenly spaced held-out frames, from the capture's evaluation views.

    Args:
        sources: Whose latents to draw, "driver" only where the capture has expressions: "encoder"
            is the model's own encoder, "driver" the expression encoder, which a live sender runs.

    Returns:
        A row for each source and view: which run it is (identity, variant, block, seed, steps,
        seconds), what its model costs (parameters, macs, macs_per_pixel), `ViewErrors.row`, and the
        mean distances from the capture's best mesh (vertex_error_mm, lid_error_mm, lip_error_mm;
        None where it does not name the region).

    Raises:
        CaptureError: An image cannot be read.
    """
    data, model, config = trainer.data, trainer.model, trainer.config
    evaluator = ModelEvaluator(data, model, trainer.rasteriser)
    frames = spaced(data.test_frames, max_frames)
    topology, cost = data.meshes.topology(model.topology), model.cost
    about = {
        "identity": data.capture.identity,
        "variant": config.variant,
        "block": config.block if isinstance(model, PixelCodecAvatar) else None,
        "seed": config.seed,
        "steps": trainer.step,
        "seconds": round(trainer.seconds, 1),
        "parameters": cost.parameters,
        "macs": cost.per_object_multiply_adds,
        "macs_per_pixel": cost.per_pixel_multiply_adds,
    }
    rows: list[dict[str, Any]] = []
    for source in sources if data.capture.has_expressions else sources[:1]:
        off_mm = np.mean([_vertex_errors_mm(evaluator, source, frame) for frame in frames], axis=0)
        distances: dict[str, float | None] = {"vertex_error_mm": float(off_mm.mean())}
        for name in ("lid", "lip"):
            part = off_mm[topology.region(f"{name}s")]
            distances[f"{name}_error_mm"] = float(part.mean()) if len(part) else None
        for view, errors in measure_views(evaluator, frames, source).items():
            rows.append({**about, "source": source, "view": view, **errors.row(), **distances})
    return rows


def mean_mse(rows: list[dict[str, Any]], source: str = "encoder") -> float | None:
    """The mean over views of one source's MSE; None where it was not measured."""
    errors = [row["mse"] for row in rows if row["source"] == source]
    return float(np.mean(errors)) if errors else None


def _vertex_errors_mm(evaluator: ModelEvaluator, source: Source, frame: int) -> FloatArray:
    """How far each vertex of a frame is off, ``[V]``."""
    meshes, is_tracked = evaluator.data.meshes, evaluator.model.topology == "tracked"
    wanted = meshes.true_at_tracked(frame) if is_tracked else meshes.dense_m[frame]
    found = evaluator.vertices_m(evaluator.latent(frame, source))
    return 1000 * np.linalg.norm(found - wanted, axis=1)
