"""The losses of each phase, from frames to weighted numbers (`LOSSES`).

geometry    mesh, KL, smoothness
joint       image, depth, normal, mesh, smoothness, KL
driver      code, mesh
live        image, of poses by the live encoder
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.linear import Bases
from pica_core.avatar.spec import TopologyName
from pica_core.camera import Camera
from pica_core.capture.stage.synth import Poses, read_picture, read_poses
from pica_core.model.interface import AvatarModel, DecodedMesh, ExpressionEncoder, flat_latent
from pica_core.model.linear import LinearGeometry
from pica_core.model.networks import hold_log_variance, reparameterise
from pica_core.train.config import TrainConfig
from pica_core.train.data import TrainingData, important_vertices, vertex_importance, view_direction
from pica_core.train.losses import (
    PLAIN_WEIGHT,
    ROUGH_WEIGHTS,
    Laplacian,
    depth_loss,
    depth_mask,
    equal_shares,
    follow_mean,
    gradient_smoothness,
    image_loss,
    kl_loss,
    laplacian_smoothness,
    mesh_laplacian,
    mesh_loss,
    normal_loss,
)
from pica_core.train.pixels import DrawnPixels, MeshDrawer
from pica_core.train.raster import Rasteriser, Views
from pica_core.types import LATENT_CHANNELS, LATENT_SIZE, FloatArray

IMAGE_WEIGHT, MESH_WEIGHT, KL_WEIGHT = 2.0, 0.1, 0.001
"""Weights of losses that all presets share (paper 5); those of depth, normal and smoothness, 10, 1
and 1 in the paper, are the preset's."""
GRADIENT_WEIGHT, LAPLACIAN_WEIGHT = 1.0, 0.1
"""Parts of smoothness (paper A.2, lambda_g and lambda_l)."""
GEOMETRY_BATCH = 2
"""Frames per step of the geometry phase: small batches and many steps learn fastest."""
DRIVER_BATCH, DRIVER_MESHES = 32, 8
"""Frames per step of the driver phase; the mesh of every eighth of them is decoded."""
LIVE_BATCH = 4
"""Pictures of poses per step, with half of `pixels_per_image` each."""
MASKED_REGION = "mouth"
"""Where a tracked mesh teaches nothing (paper 5, W_M)."""
MAX_PICTURES = 1024
"""Pictures of poses that are kept in memory."""
RIDGE, BEND_RIDGE = 1e-5, 1e-3
"""Strength of the live encoder's regression in squared tracker values, for them and for what bends
(chosen on two people, docs/results; a shape that is never shown stays without effect)."""
GEOMETRY = slice(None, None, LATENT_CHANNELS)
"""The first channel's entries in a flat latent: weights of bases."""
CHUNK = 64
"""Meshes that are projected at a time."""
DEVICE_SHARE = 0.4
"""Part of a GPU's free memory for what is read of the capture; the oldest goes first."""
Losses = dict[str, Tensor]
Place = tuple[int, str]
"""Frame and camera of an image."""


class Draw:
    """Everything random in a step, from the run's seed and the step's number."""

    def __init__(self, seed: int, step: int) -> None:
        self.rng = np.random.default_rng((seed, step))
        self.noise = torch.Generator().manual_seed(seed * 1_000_003 + step)


Batch = dict[str, Tensor]
"""What a step is given, by name: always the same names and shapes for one kind of step."""


class Objectives:
    """Losses of one model on one capture.

    Args:
        rasteriser: Made for the mesh that the model draws; it stays its owner's.

    Attributes:
        drawer: Draws the model's mesh.
        mean_m: V_mu of the smoothness loss, ``[V, 3]``; part of a checkpoint.
        notes: What had to be switched off, in words.
    """

    def __init__(
        self,
        data: TrainingData,
        config: TrainConfig,
        model: AvatarModel,
        rasteriser: Rasteriser,
        device: torch.device,
    ) -> None:
        self.data, self.config, self.model, self.device = data, config, model, device
        self.notes: list[str] = []
        if not data.capture.has_expressions:
            self.notes.append("the capture has no expressions: no driver phase")
        if not data.meshes.use(config.mesh_source):
            self.notes.append("the capture has no exact meshes: the tracked ones teach the mesh")
        self._wants_depth = bool(config.depth or config.normal)
        if self._wants_depth and not data.capture.has_depth:
            self._wants_depth = False
            self.notes.append("the capture has no depth: depth and normal losses are off")
        if config.normal and config.pixels_per_image:
            self.notes.append("some pixels are drawn, and normals need all: the normal loss is off")
        self._has_dense_loss = data.meshes.source == "truth" and model.topology == "dense"
        topology = data.meshes.topology(model.topology)
        important_faces = important_vertices(topology)[topology.faces].all(1)
        face_weights = np.where(important_faces, config.region_weight, 1.0).astype(np.float32)
        self.drawer = MeshDrawer(rasteriser, topology, face_weights, device)
        self._vertex_weights = self._mesh_weights().to(device)
        neutral_m = data.meshes.neutral_m(model.topology, data.arkit)
        self.mean_m = torch.tensor(neutral_m, device=device)
        self._laplacian: Laplacian | None = None
        if config.smooth:
            self._laplacian = mesh_laplacian(neutral_m, topology.faces, self.mean_m)
            rough = topology.by_region(ROUGH_WEIGHTS, PLAIN_WEIGHT).astype(np.float32)
            self._rough = torch.from_numpy(rough).to(device)
        self._codes: tuple[dict[int, Tensor], Tensor] | None = None
        self._poses: Poses | None = None
        self._on_device: dict[tuple[str, Any], Tensor] = {}
        self._most_on_device = 0
        if device.type != "cpu":
            pixels = max(camera.width * camera.height for camera in data.capture.cameras)
            largest = 4 * max(pixels, 3 * model.encoder.texture_size**2)
            self._most_on_device = int(DEVICE_SHARE * torch.cuda.mem_get_info(device)[0]) // largest
        folder = data.capture.path
        if isinstance(getattr(model, "geometry", None), LinearGeometry):
            self._poses = read_poses(folder, len(data.capture.topology.vertex_uv))
        self._picture = lru_cache(MAX_PICTURES)(lambda number: read_picture(folder, number))

    @property
    def has_pictures_of_poses(self) -> bool:
        """Whether `live` has something to learn from."""
        return self._poses is not None and bool(self._poses.cameras)

    def prepare(self, kind: str, draw: Draw) -> Batch:
        """What a step of a kind, one of `LOSSES`, is given; nothing in it depends on weights but in
        a driver step."""
        match kind:
            case "geometry":
                return self._of_frames(self._draw(GEOMETRY_BATCH, draw), draw)
            case "joint":
                return self._of_images(self._draw_images(draw), draw)
            case "live":
                return self._of_poses(draw)
            case _:
                return self._of_codes(self._draw(DRIVER_BATCH, draw))

    def expect(self, draw: Draw) -> None:
        """Have the images decoded that a joint step with this draw will need."""
        self.data.images.expect(self._draw_images(draw), depth=self._wants_depth)

    def encode(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """The encoder's mean and log-variance of frames, ``[N, 4, 8, 8]`` each."""
        mean, log_variance = self.model.encoder(batch["textures"], batch["maps"])
        return mean, hold_log_variance(log_variance)

    def geometry(self, batch: Batch) -> Losses:
        """Losses of a step without images."""
        latent, kl = self._latent(batch)
        mesh = self.model.decode_mesh(latent)
        return {"mesh": self._mesh(mesh, batch), **self._priors(mesh, kl)}

    def joint(self, batch: Batch) -> Losses:
        """Losses of a step with images (paper 5)."""
        latent, kl = self._latent(batch)
        mesh = self.model.decode_mesh(latent)
        drawn, colours = self._shaded(latent, mesh, batch)
        losses = {"image": self._image(colours, batch, drawn)}
        losses |= self._depth(batch, drawn)
        losses["mesh"] = self._mesh(mesh, batch)
        losses |= self._priors(mesh, kl)
        return losses

    def live(self, batch: Batch) -> Losses:
        """Losses of the live encoder and the decoders on pictures of poses; geometry stays."""
        latent = self.model.expression_encoder(batch["arkit"])
        latent = torch.cat([latent[:, :1].detach(), latent[:, 1:]], 1)
        mesh = self.model.decode_mesh(latent)
        drawn, colours = self._shaded(latent, mesh, batch, share=2)
        return {"live": self._image(colours, batch, drawn)}

    def driver(self, batch: Batch) -> Losses:
        """Losses of the live encoder, on the codes of the model's own."""
        latent = self.model.expression_encoder(batch["arkit"])
        mesh = self.model.decode_mesh(latent[::DRIVER_MESHES])
        off = (latent - batch["codes"]) / batch["spread"]
        return {"code": off.square().mean(), "mesh": self._mesh(mesh, batch)}

    def _of_frames(self, frames: list[int], draw: Draw) -> Batch:
        noise = torch.randn(
            len(frames), LATENT_CHANNELS, LATENT_SIZE, LATENT_SIZE, generator=draw.noise
        )
        return {**self._given(frames), "mesh": self._meshes(frames), "noise": noise}

    def _given(self, frames: list[int]) -> Batch:
        """What the encoder is given of frames."""
        size = self.model.encoder.texture_size
        images, meshes = self.data.images, self.data.meshes
        return {
            "textures": self._held(lambda f: images.texture(f, size), "texture", frames),
            "maps": self._held(meshes.position_map, "map", frames),
        }

    def _of_images(self, places: list[Place], draw: Draw) -> Batch:
        images, frames = self.data.images, [frame for frame, _ in places]
        batch = self._of_frames(frames, draw)
        batch["pictures"] = self._held(lambda place: images.image(*place), "image", places)
        if self._wants_depth:
            batch["depths"] = self._held(lambda place: images.depth_m(*place), "depth", places)
        if self.data.capture.has_masks:
            batch["masks"] = self._held(lambda place: images.mask(*place), "mask", places)
        cameras = [images.camera(*place) for place in places]
        return batch | self._seen(cameras, draw)

    def _of_poses(self, draw: Draw) -> Batch:
        assert self._poses is not None
        poses = draw.rng.integers(len(self._poses.arkit), size=LIVE_BATCH).tolist()
        cameras = [self.data.capture.camera(self._poses.cameras[pose]) for pose in poses]
        return {
            "arkit": torch.from_numpy(self._poses.arkit[poses]),
            "pictures": self._held(self._picture, "pose", poses),
            **self._seen(cameras, draw),
        }

    def _of_codes(self, frames: list[int]) -> Batch:
        codes, spread = self._model_codes()
        return {
            "arkit": self.data.arkit[frames],
            "codes": torch.stack([codes[frame] for frame in frames]),
            "spread": spread,
            "mesh": self._meshes(frames[::DRIVER_MESHES]),
        }

    def _seen(self, cameras: list[Camera], draw: Draw) -> Batch:
        """Cameras, and what chooses pixels of their images."""
        views = Views.of(cameras)._asdict()
        batch = {name: values for name, values in views.items() if isinstance(values, Tensor)}
        batch["directions"] = torch.from_numpy(np.stack([view_direction(c) for c in cameras]))
        if self.config.pixels_per_image:
            size = cameras[0].width * cameras[0].height
            batch["shift"] = torch.from_numpy(draw.rng.integers(size, size=len(cameras)))
        return batch

    def _meshes(self, frames: list[int]) -> Tensor:
        """The meshes that the mesh loss compares with."""
        name: TopologyName = "dense" if self._has_dense_loss else "tracked"
        return self._held(lambda frame: self.data.meshes.best(frame, name), name, frames)

    def _held(self, read: Callable[[Any], Any], what: str, keys: Sequence[Any]) -> Tensor:
        """What is read of each key, as one tensor, kept on a GPU if that is where the model is."""
        if self.device.type == "cpu":
            return torch.stack([torch.as_tensor(read(key)) for key in keys])
        for key in keys:
            if (what, key) not in self._on_device:
                if len(self._on_device) >= self._most_on_device:
                    self._on_device.pop(next(iter(self._on_device)))
                self._on_device[what, key] = torch.as_tensor(read(key)).to(self.device)
        return torch.stack([self._on_device[what, key] for key in keys])

    def _draw_images(self, draw: Draw) -> list[Place]:
        """The images of a joint batch."""
        frames = self._draw(self.config.joint_batch, draw)
        places = draw.rng.random(len(frames)).tolist()
        images = []
        for frame, place in zip(frames, places, strict=True):
            names = self.data.images.cameras_of(frame)
            images.append((frame, names[int(place * len(names))]))
        return images

    def start_driver(self) -> None:
        """Begin the live encoder as the ridge regression from expressions, and what of them bends,
        to the model's codes; geometry from poses beside the frames, where the capture has some."""
        codes, _ = self._model_codes()
        frames = self.data.train_frames
        wanted = flat_latent(torch.stack([codes[frame] for frame in frames])).cpu()
        matrix, offset = regress(self.data.arkit[frames], wanted)
        geometry = getattr(self.model, "geometry", None)
        if self._poses is not None and isinstance(geometry, LinearGeometry):
            bases = geometry.bases(vertex_importance(self.data.capture.topology))
            weight = geometry.weight.cpu().numpy()
            matrix[GEOMETRY], offset[GEOMETRY] = regress_geometry(self._poses, bases, weight)
        self.model.expression_encoder.start_from(matrix.float(), offset.float())

    def _shaded(
        self, latent: Tensor, mesh: DecodedMesh, batch: Batch, *, share: int = 1
    ) -> tuple[DrawnPixels, Tensor]:
        """Pixels of meshes through a batch's cameras, 1 / `share` of the usual number, and the
        model's colours of them."""
        appearance = self.model.appearance(latent, batch["directions"])
        height, width = batch["pictures"].shape[1:3]
        tensors = (batch[name] for name in ("rotation", "translation_m", "inverse", "clip"))
        rotation, translation_m, inverse, clip = tensors
        views = Views(rotation, translation_m, inverse, clip, width, height)
        drawn = self.drawer.draw(
            mesh.vertices_m,
            views,
            count=self.config.pixels_per_image // share,
            shift=batch.get("shift"),
        )
        return drawn, self.model.shade(appearance, drawn.surface)

    def _image(self, colours: Tensor, batch: Batch, drawn: DrawnPixels) -> Tensor:
        """The image loss against one picture for each image of a batch, where it is not masked."""
        observed = drawn.of(batch["pictures"]).to(torch.float32) / 255
        is_shown = drawn.is_drawn
        if "masks" in batch:
            is_shown = is_shown & drawn.of(batch["masks"])
        share = equal_shares(is_shown)
        return IMAGE_WEIGHT * image_loss(colours, observed, share, self.config.chroma)

    def _draw(self, count: int, draw: Draw) -> list[int]:
        """The frames of a batch."""
        return self.data.draw(count, self.config.frame_balance, draw.rng)

    def _latent(self, batch: Batch) -> tuple[Tensor, Tensor]:
        mean, log_variance = self.encode(batch)
        return reparameterise(mean, log_variance, batch["noise"]), kl_loss(mean, log_variance)

    def _mesh_weights(self) -> Tensor:
        """Importance of vertices in the mesh loss."""
        config, data = self.config, self.data
        topology = data.meshes.topology(self.model.topology)
        weights = vertex_importance(topology, config.region_weight, config.lid_weight)
        if data.meshes.source == "tracked":
            tracked = data.meshes.topology("tracked")
            weights = tracked.by_region({MASKED_REGION: 0.0}, 1.0).astype(np.float32)
        return torch.from_numpy(weights)

    def _mesh(self, mesh: DecodedMesh, batch: Batch) -> Tensor:
        predicted = mesh.vertices_m if self._has_dense_loss else mesh.tracked_m
        return MESH_WEIGHT * mesh_loss(predicted, batch["mesh"], self._vertex_weights)

    def _priors(self, mesh: DecodedMesh, kl: Tensor) -> dict[str, Tensor]:
        """KL, and smoothness; V_mu takes its step."""
        losses = {"kl": KL_WEIGHT * kl}
        if self._laplacian is None:
            return losses
        smooth = torch.zeros((), device=self.device)
        if mesh.position_map_m is not None:
            smooth = smooth + GRADIENT_WEIGHT * gradient_smoothness(mesh.position_map_m)
        smooth = smooth + LAPLACIAN_WEIGHT * laplacian_smoothness(
            self._laplacian, mesh.vertices_m, self.mean_m, self._rough
        )
        follow_mean(self.mean_m, mesh.vertices_m.detach().mean(0, keepdim=True))
        losses["smooth"] = self.config.smooth * smooth
        return losses

    def _depth(self, batch: Batch, drawn: DrawnPixels) -> Losses:
        weights = self.config
        if not self._wants_depth:
            return {}
        observed_m = torch.where(drawn.is_drawn, drawn.of(batch["depths"]), 0)
        mask = depth_mask(drawn.depth_m, observed_m)
        losses = {}
        if weights.depth:
            share = equal_shares(observed_m > 0)
            loss = depth_loss(drawn.depth_m, observed_m, mask, share)
            losses["depth"] = weights.depth * loss
        if weights.normal and not weights.pixels_per_image:
            right, below = drawn.beside(mask)
            share = equal_shares(mask & right & below)
            predicted, observed = drawn.normals(drawn.depth_m), drawn.normals(observed_m)
            losses["normal"] = weights.normal * normal_loss(predicted, observed, share)
        return losses

    def _model_codes(self) -> tuple[dict[int, Tensor], Tensor]:
        """The encoder's mean of each training frame, and the overall deviation of all."""
        if self._codes is None:
            frames = self.data.train_frames
            with torch.no_grad():
                parts = [frames[i : i + 16] for i in range(0, len(frames), 16)]
                codes = torch.cat([self.encode(self._given(part))[0] for part in parts])
            by_frame = dict(zip(frames, codes, strict=True))
            self._codes = by_frame, codes.std().clamp_min(1e-6)
        return self._codes


LOSSES: dict[str, Callable[[Objectives, Batch], Losses]] = {
    "geometry": Objectives.geometry,
    "joint": Objectives.joint,
    "live": Objectives.live,
    "driver": Objectives.driver,
}


def regress(arkit: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Matrix ``[D, 52 + B]`` and offset ``[D]`` from lifted expressions, of ``[N, 52]``, to values
    ``[N, D]``, float64."""
    given, wanted = ExpressionEncoder.lifted(arkit.double()), wanted.double()
    mean, rest = given.mean(0), wanted.mean(0)
    offsets = given - mean
    ridge = torch.full_like(mean, BEND_RIDGE)
    ridge[:NUM_ARKIT] = RIDGE
    products = offsets.T @ offsets + len(arkit) * torch.diag(ridge)
    matrix = torch.linalg.solve(products, offsets.T @ (wanted - rest)).T
    return matrix, rest - matrix @ mean


def regress_geometry(poses: Poses, bases: Bases, weight: FloatArray) -> tuple[Tensor, Tensor]:
    """`regress` from posed meshes to all entries of the latent's first channel, ``[64, 52 + B]``.

    Args:
        poses: Their vertices in the order of the bases'.
        bases: Of an avatar.
        weight: From latents to their weights, the file's ``linear.weight``.
    """
    parts = [
        bases.weights_of(poses.vertices_m[start : start + CHUNK])
        for start in range(0, len(poses.arkit), CHUNK)
    ]
    codes = np.concatenate(parts) @ np.linalg.pinv(weight[:, GEOMETRY]).T
    return regress(torch.from_numpy(poses.arkit), torch.from_numpy(codes))
