"""Checkpoint to avatar file: what receiver and sender need, under the file's names."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree
from torch import Tensor

from pica_core.avatar.file import Avatar
from pica_core.avatar.linear import RANK
from pica_core.avatar.manifest import Manifest, ViewSpan
from pica_core.camera import dome_cameras
from pica_core.capture.stage.expressions import stream_training_expressions, tracked_expressions
from pica_core.capture.triangles import components
from pica_core.codec.profile import StreamProfile
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import AvatarModel
from pica_core.model.linear import LinearGeometry
from pica_core.model.pixel_decoder import XYZ_UNIT_M
from pica_core.train.data import TrainingData, rasterise_uv, view_direction
from pica_core.train.evaluate import ModelEvaluator, Picture, mean_mse
from pica_core.train.stream_learning import RenderMetric, learn_profile
from pica_core.train.train import Trainer
from pica_core.types import LATENT_SHAPE, NUM_LATENT, BoolArray, Float64Array, FloatArray, IntArray

MARGIN_M = 0.02
"""How far decoded positions may leave the box of the training meshes."""
UNSEEN_MARGIN_RATIO = 1 / 128
"""Seen texels nearer to an unseen one, of the map's width, lend nothing: few pixels, seen edge-on,
made them what they are (chosen by looking at six people)."""
NEIGHBOURS = 12
"""Texels whose mean an unseen one takes."""


def avatar_tensors(
    model: PixelCodecAvatar, vertex_uv: FloatArray, faces: IntArray
) -> dict[str, npt.NDArray[np.generic]]:
    """A model's weights as the avatar file's tensors, with UVs ``[V, 2]`` and triangles ``[F, 3]``.

    The unit of the xyz input is folded into the first xyz layer, so that the file's weights apply
    to metres.
    """
    pixel = model.pixel_decoder
    tensors: dict[str, Tensor] = {
        **model.geometry.named_tensors(),
        **model.expression.named_tensors(),
        **pixel.encoding.named_tensors(),
        **pixel.xyz.named_tensors("xyz"),
        **pixel.colour.named_tensors("pixel"),
    }
    if isinstance(model.geometry, LinearGeometry):
        # The file's vertices in the order of the sheet.
        order = model.geometry.order.cpu().numpy()
        place = np.argsort(order).astype(np.int32)
        vertex_uv, faces = vertex_uv[order], place[faces]
    else:
        tensors["geometry.mean"] = model.position_mean.permute(1, 2, 0)
    tensors["xyz.0.weight"] = tensors["xyz.0.weight"] / XYZ_UNIT_M
    layers = model.expression_encoder.layers.named_parameters()
    tensors |= {f"encoder.{name}": values for name, values in layers}
    arrays: dict[str, npt.NDArray[np.generic]] = {
        name: _array(values) for name, values in tensors.items()
    }
    if RANK in arrays:
        arrays[RANK] = arrays[RANK].astype(np.int32)
    arrays["mesh.vertex_uv"] = np.ascontiguousarray(vertex_uv, np.float32)
    arrays["mesh.faces"] = np.ascontiguousarray(faces, np.int32)
    return arrays


def make_avatar(
    model: PixelCodecAvatar,
    data: TrainingData,
    *,
    name: str,
    identity: str,
    licence: str,
    model_card: Mapping[str, str],
    start: FloatArray | None = None,
) -> Avatar:
    """The avatar of a trained model, with the mesh that it draws.

    Args:
        start: The model's `joint_map` before training. Texels whose last channel, which begins at
            random, is still the same were in no picture, and are filled by `fill_unseen`.
    """
    low_m, high_m = _bounds_m(data)
    manifest = Manifest(
        name=name,
        identity=identity,
        licence=licence,
        spec=model.spec,
        position_scale_m=model.position_scale_m,
        bounds_min_m=low_m,
        bounds_max_m=high_m,
        model_card=dict(model_card),
        view_span=_view_span(data),
    )
    topology = data.meshes.topology(model.topology)
    tensors = avatar_tensors(model, topology.vertex_uv, topology.faces)
    if start is not None and (trained := joint_map(model)) is not None:
        is_seen = trained[:, :, -1] != start[:, :, -1]
        tensors["uv_encoding"] = fill_unseen(trained, is_seen, data)
    return Avatar(manifest, tensors)


def joint_map(model: AvatarModel) -> FloatArray | None:
    """A copy of a model's joint map, if it has one; row 0 is v = 0, ``[T, T, C]``."""
    if not isinstance(model, PixelCodecAvatar):
        return None
    values = model.pixel_decoder.encoding.named_tensors().get("uv_encoding")
    return None if values is None else _array(values).copy()


def _array(values: Tensor) -> FloatArray:
    return np.ascontiguousarray(values.detach().cpu().numpy(), np.float32)


def _bounds_m(
    data: TrainingData,
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """A box around all training meshes, head frame, metres."""
    train = data.meshes.dense_m[data.train_frames]
    low, high = (train.min((0, 1)) - MARGIN_M).tolist(), (train.max((0, 1)) + MARGIN_M).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _view_span(data: TrainingData) -> ViewSpan:
    """The directions that cameras saw the head from in training, but for the outermost hundredth,
    and at least a degree to each side of the front."""
    images = data.images
    x, y, z = np.array(
        [
            view_direction(images.camera(frame, name))
            for frame in data.train_frames
            for name in images.cameras_of(frame)
        ]
    ).T
    angles = np.degrees([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
    low, high = np.percentile(angles, [1, 99], axis=1).round(1)
    low, high = np.minimum(low, -1.0), np.maximum(high, 1.0)
    return ViewSpan(float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def fill_unseen(values: FloatArray, is_seen: BoolArray, data: TrainingData) -> FloatArray:
    """Give the texels that no picture showed to training the mean of seen ones near them.

    They keep their random start, and would be drawn torn and grey from sides where no camera was.
    Near is meant on the mean mesh, within the same regions and the same island of the UV layout.

    Args:
        values: Row 0 is v = 0, ``[T, T, C]``.
        is_seen: Which texels training saw, ``[T, T]``.

    Returns:
        A new map, ``[T, T, C]``. Seen texels, texels outside of the UV layout and parts of it of
        which training saw too little are as they were.
    """
    topology = data.capture.topology
    raster = rasterise_uv(topology.vertex_uv, topology.faces, len(values))
    points_m = (data.meshes.dense_mean_m[raster.corners] * raster.weights[:, :, None]).sum(1)
    island = components(topology.faces, len(topology.vertex_uv))
    marks = np.stack([island, *topology.regions.values()], 1)
    part = np.unique(marks, axis=0, return_inverse=True)[1].reshape(-1)[raster.corners[:, 0]]
    is_hole = raster.covered & ~is_seen
    margin = UNSEEN_MARGIN_RATIO * len(values)
    lends = (distance_transform_edt(~is_hole) > margin)[raster.covered]
    needs = is_hole[raster.covered]
    inside = values[raster.covered]
    filled = inside.copy()
    for each in np.unique(part[needs]):
        lenders = np.flatnonzero((part == each) & lends)
        holes = np.flatnonzero((part == each) & needs)
        if len(lenders) >= NEIGHBOURS:
            _, near = KDTree(points_m[lenders]).query(points_m[holes], NEIGHBOURS)
            filled[holes] = inside[lenders[near]].mean(1)
    result: FloatArray = values.copy()
    result[raster.covered] = filled
    return result


EVALUATION_FILE = "evaluation.json"


def model_card(trainer: Trainer, run: Path) -> dict[str, str]:
    """Entries in words, for `pica avatar info` and readers of the file; nothing of errors where
    the run's folder has no evaluation."""
    model, data = trainer.config, trainer.data
    camera = data.capture.cameras[0]
    seconds = f", {trainer.seconds / 60:.0f} minutes" if trainer.seconds >= 60 else ""
    card = {
        "capture": str(data.capture.info["source"]),
        "frames": f"{len(data.train_frames)} to train on, {len(data.test_frames)} held out, "
        f"{len(data.capture.cameras)} cameras of {camera.width} x {camera.height}",
        "training": f"{trainer.step} of {trainer.total_steps} steps, seed {trainer.config.seed}"
        + seconds,
        "variant": model.variant,
        "block": model.block,
        "encoder": model.encoder,
    }
    path = run / EVALUATION_FILE
    if not path.exists():
        return card
    rows = json.loads(path.read_text())
    views = [f"{row['view']} {row['mse']:.1f}" for row in rows if row["source"] == "encoder"]
    card["held_out_mse"] = f"{mean_mse(rows):.1f} (0-255, rasterised pixels): {', '.join(views)}"
    card["vertex_error"] = f"{rows[0]['vertex_error_mm']:.2f} mm on average"
    if (driven := mean_mse(rows, "driver")) is not None:
        card["held_out_mse_live"] = f"{driven:.1f}, sent from ARKit values"
    return card


BACKGROUND = 0.25
"""Colour around the head, 0 to 1: between skin and hair, so that both show against it."""
METRIC_REACH = 0.5
"""How far a direction is followed, in standard deviations of the codes along it: as far as
differences between frames go."""
LEAST_REACH = 0.05
"""Below, pixels that change owner by chance drown what the direction does."""
METRIC_FACES = 12
"""Faces that the metric is averaged over (chosen, as what follows)."""
METRIC_DIRECTIONS = 64
"""Principal directions of the codes that it speaks of."""
METRIC_VIEWS = ("front", "left")
"""Names of the stage's evaluation views that the pictures are drawn from."""
METRIC_SIZE = 192
"""Rows and columns of the pictures."""


def make_stream_profile(painter: ModelEvaluator) -> StreamProfile:
    """Learn the stream of a trained avatar from codes as a live sender makes them."""
    with torch.no_grad():
        shown = stream_training_expressions(), tracked_expressions()
        arkit = torch.from_numpy(np.concatenate(shown))
        latents = painter.model.expression_encoder(arkit).permute(0, 2, 3, 1).numpy()
        codes = latents.reshape(-1, NUM_LATENT).astype(np.float64)
        metric = _measure_metric(painter, codes)
    return learn_profile(codes, metric)


def _measure_metric(painter: ModelEvaluator, codes: Float64Array) -> RenderMetric:
    """How much a change of the latent changes the picture.

    The model draws a face, then draws it again with the latent moved a little along one direction
    after the other; the differences are the columns of a Jacobian, and their inner products,
    averaged over faces and views, the metric. Silhouettes count: what moves against the background
    changes pixels too.
    """
    by_name = {camera.name: camera for camera in dome_cameras(5, METRIC_SIZE, METRIC_SIZE)}
    plain = np.full((METRIC_SIZE, METRIC_SIZE, 3), BACKGROUND * 255, np.float32)

    def draw(code: Float64Array) -> list[Picture]:
        grid = torch.from_numpy(code.astype(np.float32)).view(1, *LATENT_SHAPE).permute(0, 3, 1, 2)
        vertices_m = painter.vertices_m(grid)
        return [painter.draw(grid, by_name[name], vertices_m=vertices_m) for name in METRIC_VIEWS]

    def paint(code: Float64Array) -> Tensor:
        """Pictures of a latent ``[256]`` behind each other, 0-255."""
        pictures = [picture.on(plain).reshape(-1) for picture in draw(code)]
        return torch.from_numpy(np.concatenate(pictures))

    rng = np.random.default_rng(0)
    variance, axes = np.linalg.eigh(np.cov(codes.T, bias=True))
    largest = np.argsort(variance)[::-1][:METRIC_DIRECTIONS]
    directions = axes.T[largest]
    reach = np.maximum(METRIC_REACH * np.sqrt(np.maximum(variance[largest], 0)), LEAST_REACH)
    gram = np.zeros((len(directions), len(directions)))
    for code in codes[rng.choice(len(codes), METRIC_FACES, replace=False)]:
        covered = sum(len(picture.pixels) for picture in draw(code))
        slopes = torch.stack(
            [
                (paint(code + step) - paint(code - step)) / (2 * length)
                for step, length in zip(reach[:, None] * directions, reach.tolist(), strict=True)
            ]
        )
        gram += (slopes @ slopes.T).numpy().astype(np.float64) / (3 * covered)
    return RenderMetric(directions, gram / METRIC_FACES)
