"""Checkpoint to avatar file: what receiver and sender need, under the file's names."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree
from torch import Tensor

from pica_core.avatar.file import Avatar
from pica_core.avatar.linear import RANK
from pica_core.avatar.manifest import Manifest, ViewSpan
from pica_core.capture.triangles import components
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.model.interface import AvatarModel
from pica_core.model.linear import LinearGeometry
from pica_core.model.pixel_decoder import XYZ_UNIT_M
from pica_core.train.data import TrainingData, rasterise_uv, view_direction
from pica_core.train.evaluate import mean_mse
from pica_core.train.train import Trainer
from pica_core.types import BoolArray, FloatArray, IntArray

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


def _bounds_m(data: TrainingData) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
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
