"""The losses of each phase, from frames to weighted numbers (`LOSSES`).

geometry    mesh, KL, smoothness
joint       image, depth, normal, mesh, smoothness, KL
driver      code, mesh
live        image, of poses by the live encoder
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

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
    smoothness_weights,
)
from pica_core.train.raster import DrawnPixels, MeshDrawer, Rasteriser
from pica_core.types import LATENT_CHANNELS, Array, FloatArray, Image, Int64Array

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
Place = tuple[int, str]
"""Frame and camera of an image."""


class Draw:
    """Everything random in a step, from the run's seed and the step's number."""

    def __init__(self, seed: int, step: int) -> None:
        self._seed = seed, step
        self.rng = np.random.default_rng(self._seed)
        self.noise = torch.Generator().manual_seed(seed * 1_000_003 + step)

    def of_images(self, count: int) -> list[np.random.Generator]:
        """A generator for the choice of pixels in each image."""
        return [np.random.default_rng([*self._seed, number]) for number in range(count)]


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
        topology = data.meshes.topology(model.topology)
        important_faces = important_vertices(topology)[topology.faces].all(1)
        face_weights = np.where(important_faces, config.region_weight, 1.0).astype(np.float32)
        self.drawer = MeshDrawer(rasteriser, topology, face_weights, device)
        self._vertex_weights = self._mesh_weights().to(device)
        neutral_m = data.meshes.neutral_m(model.topology, data.arkit)
        self.mean_m = torch.tensor(neutral_m, device=device)
        self._laplacian: Tensor | None = None
        if config.smooth:
            self._laplacian = mesh_laplacian(neutral_m, topology.faces, self.mean_m)
            self._rough = torch.from_numpy(smoothness_weights(topology)).to(device)
        self._codes: tuple[dict[int, Tensor], Tensor] | None = None
        self._poses: Poses | None = None
        folder = data.capture.path
        if isinstance(getattr(model, "geometry", None), LinearGeometry):
            self._poses = read_poses(folder, len(data.capture.topology.vertex_uv))
        self._picture = lru_cache(MAX_PICTURES)(lambda number: read_picture(folder, number))

    @property
    def has_pictures_of_poses(self) -> bool:
        """Whether `live` has something to learn from."""
        return self._poses is not None and bool(self._poses.cameras)

    def encode(self, frames: list[int]) -> tuple[Tensor, Tensor]:
        """The encoder's mean and log-variance of frames, ``[N, 4, 8, 8]`` each."""
        size = self.model.encoder.texture_size
        textures = self.data.images.textures(frames, size).to(self.device)
        maps = self.data.meshes.position_maps(frames).to(self.device)
        mean, log_variance = self.model.encoder(textures, maps)
        return mean, hold_log_variance(log_variance)

    def geometry(self, draw: Draw) -> dict[str, Tensor]:
        """Losses of a step without images."""
        frames = self._draw(GEOMETRY_BATCH, draw)
        latent, kl = self._latent(frames, draw)
        mesh = self.model.decode_mesh(latent)
        return {"mesh": self._mesh(mesh, frames), **self._priors(mesh, kl)}

    def joint(self, draw: Draw) -> dict[str, Tensor]:
        """Losses of a step with images (paper 5)."""
        images = self._draw_images(draw)
        rngs = draw.of_images(len(images))
        frames = [frame for frame, _ in images]
        cameras = [self.data.images.camera(frame, name) for frame, name in images]
        latent, kl = self._latent(frames, draw)
        mesh = self.model.decode_mesh(latent)
        wants_normals = self.config.normal > 0 and self._wants_depth
        drawn, colours = self._shaded(latent, mesh, cameras, rngs, normals=wants_normals)
        pictures = [self.data.images.image(frame, name) for frame, name in images]
        losses = {"image": self._image(colours, pictures, drawn)}
        losses |= self._depth(images, drawn)
        losses["mesh"] = self._mesh(mesh, frames)
        losses |= self._priors(mesh, kl)
        return losses

    def live(self, draw: Draw) -> dict[str, Tensor]:
        """Losses of the live encoder and the decoders on pictures of poses; geometry stays."""
        assert self._poses is not None
        poses = draw.rng.integers(len(self._poses.arkit), size=LIVE_BATCH).tolist()
        rngs = draw.of_images(LIVE_BATCH)
        cameras = [self.data.capture.camera(self._poses.cameras[pose]) for pose in poses]
        pictures = [self._picture(pose) for pose in poses]
        arkit = torch.from_numpy(self._poses.arkit[poses]).to(self.device)
        latent = self.model.expression_encoder(arkit)
        latent = torch.cat([latent[:, :1].detach(), latent[:, 1:]], 1)
        mesh = self.model.decode_mesh(latent)
        drawn, colours = self._shaded(latent, mesh, cameras, rngs, share=2)
        return {"live": self._image(colours, pictures, drawn)}

    def expect(self, draw: Draw) -> None:
        """Have the images decoded that a joint step with this draw will need."""
        self.data.images.expect(self._draw_images(draw), depth=self._wants_depth)

    def _draw_images(self, draw: Draw) -> list[Place]:
        """The images of a joint batch."""
        frames = self._draw(self.config.joint_batch, draw)
        places = draw.rng.random(len(frames)).tolist()
        images = []
        for frame, place in zip(frames, places, strict=True):
            names = self.data.images.cameras_of(frame)
            images.append((frame, names[int(place * len(names))]))
        return images

    def driver(self, draw: Draw) -> dict[str, Tensor]:
        """Losses of the live encoder, on the codes of the model's own."""
        codes, spread = self._model_codes()
        frames = self._draw(DRIVER_BATCH, draw)
        latent = self.model.expression_encoder(self.data.arkit[frames].to(self.device))
        wanted = torch.stack([codes[frame] for frame in frames])
        few = slice(None, None, DRIVER_MESHES)
        mesh = self.model.decode_mesh(latent[few])
        return {
            "code": ((latent - wanted) / spread).square().mean(),
            "mesh": self._mesh(mesh, frames[few]),
        }

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
        self,
        latent: Tensor,
        mesh: DecodedMesh,
        cameras: list[Camera],
        rngs: list[np.random.Generator],
        *,
        normals: bool = False,
        share: int = 1,
    ) -> tuple[DrawnPixels, Tensor]:
        """Pixels of meshes through cameras, a generator's choice in each image: 1 / `share` of the
        usual number; and the model's colours of them."""
        view = torch.from_numpy(np.stack([view_direction(camera) for camera in cameras]))
        appearance = self.model.appearance(latent, view.to(self.device))
        drawn = self.drawer.draw(
            mesh.vertices_m,
            cameras,
            rngs,
            pixels_per_image=self.config.pixels_per_image // share,
            normals=normals,
        )
        return drawn, self.model.shade(appearance, drawn.surface)

    def _image(self, colours: Tensor, pictures: list[Image], drawn: DrawnPixels) -> Tensor:
        """The image loss against one picture for each image of a batch."""
        observed = self._at(pictures, drawn.pixels).to(torch.float32) / 255
        share = equal_shares(drawn.surface.image, len(pictures))
        return IMAGE_WEIGHT * image_loss(colours, observed, share, self.config.chroma)

    def _at(self, images: Sequence[Array], pixels: Int64Array) -> Tensor:
        """What images ``[H, W, ...]`` hold at pixels that are counted over all, ``[P, ...]``."""
        flat = np.stack(images).reshape(-1, *images[0].shape[2:])
        return torch.from_numpy(flat[pixels]).to(self.device)

    def _draw(self, count: int, draw: Draw) -> list[int]:
        """The frames of a batch."""
        return self.data.draw(count, self.config.frame_balance, draw.rng)

    def _latent(self, frames: list[int], draw: Draw) -> tuple[Tensor, Tensor]:
        mean, log_variance = self.encode(frames)
        drawn = torch.randn(mean.shape, generator=draw.noise)
        sample = reparameterise(mean, log_variance, drawn.to(self.device))
        return sample, kl_loss(mean, log_variance)

    def _mesh_weights(self) -> Tensor:
        """Importance of vertices in the mesh loss."""
        config, data = self.config, self.data
        topology = data.meshes.topology(self.model.topology)
        weights = vertex_importance(topology, config.region_weight, config.lid_weight)
        if data.meshes.source == "tracked":
            tracked = data.meshes.topology("tracked")
            weights = tracked.by_region({MASKED_REGION: 0.0}, 1.0).astype(np.float32)
        return torch.from_numpy(weights)

    def _mesh(self, mesh: DecodedMesh, frames: list[int]) -> Tensor:
        meshes = self.data.meshes
        is_dense = meshes.source == "truth" and self.model.topology == "dense"
        predicted = mesh.vertices_m if is_dense else mesh.tracked_m
        name: TopologyName = "dense" if is_dense else "tracked"
        wanted = torch.from_numpy(np.stack([meshes.best(frame, name) for frame in frames]))
        loss = mesh_loss(predicted, wanted.to(self.device), self._vertex_weights)
        return MESH_WEIGHT * loss

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

    def _depth(self, images: list[Place], drawn: DrawnPixels) -> dict[str, Tensor]:
        weights = self.config
        if not self._wants_depth:
            return {}
        depths_m = [self.data.images.depth_m(frame, name) for frame, name in images]
        observed_m = self._at(depths_m, drawn.depth_pixels)
        mask = depth_mask(drawn.depth_m, observed_m)
        losses = {}
        if weights.depth:
            share = equal_shares(drawn.depth_image, len(images), observed_m > 0)
            loss = depth_loss(drawn.depth_m, observed_m, mask, share)
            losses["depth"] = weights.depth * loss
        if weights.normal:
            known = mask[drawn.centre] & mask[drawn.right] & mask[drawn.below]
            share = equal_shares(drawn.depth_image[drawn.centre], len(images), known)
            predicted, observed = drawn.normals(drawn.depth_m), drawn.normals(observed_m)
            losses["normal"] = weights.normal * normal_loss(predicted, observed, share)
        return losses

    def _model_codes(self) -> tuple[dict[int, Tensor], Tensor]:
        """The encoder's mean of each training frame, and the overall deviation of all."""
        if self._codes is None:
            frames = self.data.train_frames
            with torch.no_grad():
                means = [self.encode(frames[i : i + 16])[0] for i in range(0, len(frames), 16)]
            codes = torch.cat(means)
            by_frame = dict(zip(frames, codes, strict=True))
            self._codes = by_frame, codes.std().clamp_min(1e-6)
        return self._codes


LOSSES: dict[str, Callable[[Objectives, Draw], dict[str, Tensor]]] = {
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
