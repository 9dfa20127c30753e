"""The losses of each phase, from frames to weighted numbers.

geometry    mesh, KL, smoothness
joint       image, depth, normal, mesh, smoothness, KL
driver      code, mesh
live        image, of poses by the live encoder
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor
from torch.profiler import record_function

from pica_core.camera import Camera
from pica_core.capture.stage.synth import read_picture, read_poses
from pica_core.capture.stage.tracked_topology import COVER
from pica_core.model.encoder import hold_log_variance, reparameterise
from pica_core.model.interface import AvatarModel, DecodedMesh, flat_latent
from pica_core.model.linear import LinearGeometry
from pica_core.train.config import TrainConfig
from pica_core.train.data.images import view_direction
from pica_core.train.data.meshes import important_vertices, vertex_importance
from pica_core.train.data.training import TrainingData
from pica_core.train.drawing import DrawnPixels, MeshDrawer, PixelList
from pica_core.train.laplacian import (
    MeshLaplacian,
    follow_mean,
    laplacian_smoothness,
    smoothness_weights,
)
from pica_core.train.live import GEOMETRY, regress, regress_geometry
from pica_core.train.losses import (
    depth_loss,
    depth_mask,
    equal_shares,
    gradient_smoothness,
    image_loss,
    kl_loss,
    mesh_loss,
    normal_loss,
)
from pica_core.train.rasterise import Rasteriser
from pica_core.types import Array, Image

DRIVER_MESHES = 8
"""A step of the driver phase decodes the mesh of every eighth frame of its batch."""
GRADIENT_WEIGHT, LAPLACIAN_WEIGHT = 1.0, 0.1
"""Parts of smoothness (paper A.2, lambda_g and lambda_l)."""
MASKED_REGION = "mouth"
"""Where a tracked mesh teaches nothing (paper 5, W_M)."""
MAX_PICTURES = 1024
"""Pictures of poses that are kept in memory."""
Place = tuple[int, str]
"""Frame and camera of an image."""


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
        self.data = data
        self.config = config
        self.model = model
        self.device = device
        self.notes: list[str] = []
        losses = config.losses
        if not data.capture.has_expressions:
            self.notes.append("the capture has no expressions: no driver phase")
        if not data.meshes.use(config.mesh_source):
            self.notes.append("the capture has no exact meshes: the tracked ones teach the mesh")
        self._wants_depth = bool(losses.depth or losses.normal)
        if self._wants_depth and not data.capture.has_depth:
            self._wants_depth = False
            self.notes.append("the capture has no depth: depth and normal losses are off")
        topology = data.meshes.topology(model.topology)
        important_faces = important_vertices(topology)[topology.faces].all(1)
        face_weights = np.where(important_faces, losses.region_weight, 1.0).astype(np.float32)
        self.drawer = MeshDrawer(rasteriser, topology, face_weights, device)
        self._vertex_weights = self._mesh_weights().to(device)
        neutral_m = data.meshes.neutral_m(model.topology, data.arkit)
        self.mean_m = torch.tensor(neutral_m, device=device)
        self._laplacian: MeshLaplacian | None = None
        if losses.smooth:
            self._laplacian = MeshLaplacian(neutral_m, topology.faces, device=device)
            self._rough = torch.from_numpy(smoothness_weights(topology)).to(device)
        self._codes: tuple[dict[int, Tensor], Tensor] | None = None
        self._poses = None
        if isinstance(getattr(model, "geometry", None), LinearGeometry):
            self._poses = read_poses(data.capture.path, len(data.capture.topology.vertex_uv))
        folder = data.capture.path
        self._picture = lru_cache(MAX_PICTURES)(lambda number: read_picture(folder, number))

    @property
    def has_pictures_of_poses(self) -> bool:
        """Whether `live` has something to learn from."""
        return self._poses is not None and bool(self._poses.cameras)

    def forget_codes(self) -> None:
        """The model changed: encode the training frames again when they are needed."""
        self._codes = None

    def encode(self, frames: list[int]) -> tuple[Tensor, Tensor]:
        """The encoder's mean and log-variance of frames, ``[N, 4, 8, 8]`` each."""
        size = self.model.encoder.texture_size
        textures = self.data.images.textures(frames, size).to(self.device)
        maps = self.data.meshes.position_maps(frames).to(self.device)
        mean, log_variance = self.model.encoder(textures, maps)
        return mean, hold_log_variance(log_variance)

    def geometry(self, rng: np.random.Generator, noise: torch.Generator) -> dict[str, Tensor]:
        """Losses of a step without images."""
        frames = self._draw(self.config.schedule.geometry_batch, rng)
        with record_function("encode"):
            latent, kl = self._latent(frames, noise)
        with record_function("decode"):
            mesh = self.model.decode_mesh(latent)
        with record_function("loss"):
            return {"mesh": self._mesh(mesh, frames), **self._priors(mesh, kl)}

    def joint(
        self, rng: np.random.Generator, noise: torch.Generator, pixel_seed: list[int]
    ) -> dict[str, Tensor]:
        """Losses of a step with images.

        Args:
            rng: Draws frames and cameras, the same in all processes.
            noise: Draws latents, the same in all processes.
            pixel_seed: Seed of the choice of pixels; the image's number in the batch is added.
        """
        images = self._draw_images(rng)
        rngs = [np.random.default_rng([*pixel_seed, n]) for n in range(len(images))]
        with record_function("data"):
            images = [self._readable(image, rng_) for image, rng_ in zip(images, rngs, strict=True)]
        frames = [frame for frame, _ in images]
        cameras = [self.data.images.camera(frame, name) for frame, name in images]
        with record_function("encode"):
            latent, kl = self._latent(frames, noise)
        with record_function("decode"):
            mesh = self.model.decode_mesh(latent)
        wants_normals = self.config.losses.normal > 0 and self._wants_depth
        drawn, colours = self._shaded(
            latent,
            mesh,
            cameras,
            rngs,
            normals=wants_normals,
        )
        with record_function("data"):
            pictures = [self.data.images.image(frame, name) for frame, name in images]
        with record_function("loss"):
            losses = {"image": self._image(colours, pictures, drawn)}
            losses |= self._depth(images, drawn)
            losses["mesh"] = self._mesh(mesh, frames)
            losses |= self._priors(mesh, kl)
        return losses

    def live(self, rng: np.random.Generator, pixel_seed: list[int]) -> dict[str, Tensor]:
        """Losses of the live encoder and the decoders on pictures of poses; geometry stays.

        Args: as for `joint`.
        """
        assert self._poses is not None
        count = self.config.schedule.live_batch
        poses = rng.integers(len(self._poses.arkit), size=count).tolist()
        rngs = [np.random.default_rng([*pixel_seed, n]) for n in range(count)]
        cameras = [self.data.capture.camera(self._poses.cameras[pose]) for pose in poses]
        with record_function("data"):
            pictures = [self._picture(pose) for pose in poses]
        with record_function("decode"):
            arkit = torch.from_numpy(self._poses.arkit[poses]).to(self.device)
            latent = self.model.expression_encoder(arkit)
            latent = torch.cat([latent[:, :1].detach(), latent[:, 1:]], 1)
            mesh = self.model.decode_mesh(latent)
        drawn, colours = self._shaded(latent, mesh, cameras, rngs, share=2)
        with record_function("loss"):
            return {"live": self._image(colours, pictures, drawn)}

    def expect(self, rng: np.random.Generator) -> None:
        """Have the images decoded that a joint step with this `rng` will need."""
        self.data.images.expect(self._draw_images(rng), depth=self._wants_depth)

    def _draw_images(self, rng: np.random.Generator) -> list[Place]:
        """The images of a joint batch."""
        frames = self._draw(self.config.schedule.joint_batch, rng)
        places = rng.random(len(frames)).tolist()
        images = []
        for frame, place in zip(frames, places, strict=True):
            names = self.data.images.cameras_of(frame)
            images.append((frame, names[int(place * len(names))]))
        return images

    def _readable(self, image: Place, rng: np.random.Generator) -> Place:
        """The image, or one of another camera if it cannot be read: the same whatever was tried in
        earlier steps, of which a resumed run knows nothing."""
        frame, name = image
        if self.data.images.readable(frame, name) is None:
            others = [other for other in self.data.images.cameras_of(frame) if other != name]
            name, _ = self.data.images.first_readable(frame, rng.permutation(others).tolist())
        return frame, name

    def driver(self, rng: np.random.Generator) -> dict[str, Tensor]:
        """Losses of the live encoder, on the codes of the model's own."""
        codes, spread = self._model_codes()
        frames = self._draw(self.config.schedule.driver_batch, rng)
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
        with record_function("decode"):
            appearance = self.model.appearance(latent, view.to(self.device))
        with record_function("raster"):
            drawn = self.drawer.draw(
                mesh.vertices_m,
                cameras,
                rngs,
                pixels_per_image=self.config.schedule.pixels_per_image // share,
                normals=normals,
            )
        with record_function("pixel"):
            return drawn, self.model.shade(appearance, drawn.surface, detach_xyz=True)

    def _image(self, colours: Tensor, pictures: list[Image], drawn: DrawnPixels) -> Tensor:
        """The image loss against one picture for each image of a batch."""
        weights = self.config.losses
        observed = self._at(pictures, drawn.pixels).to(torch.float32) / 255
        share = equal_shares(drawn.surface.image, len(pictures))
        return weights.image * image_loss(colours, observed, share, weights.chroma)

    def _at(self, images: Sequence[Array], pixels: PixelList) -> Tensor:
        """What images ``[H, W, ...]`` hold at pixels, ``[P, ...]``."""
        parts = [
            image.reshape(-1, *image.shape[2:])[pixels.pixel[pixels.image == index]]
            for index, image in enumerate(images)
        ]
        return torch.from_numpy(np.concatenate(parts)).to(self.device)

    def _draw(self, count: int, rng: np.random.Generator) -> list[int]:
        """The frames of a batch."""
        return self.data.draw(count, self.config.schedule.frame_balance, rng)

    def _latent(self, frames: list[int], noise: torch.Generator) -> tuple[Tensor, Tensor]:
        mean, log_variance = self.encode(frames)
        drawn = torch.randn(mean.shape, generator=noise)
        sample = reparameterise(mean, log_variance, drawn.to(self.device))
        return sample, kl_loss(mean, log_variance)

    def _mesh_weights(self) -> Tensor:
        """Importance of vertices in the mesh loss."""
        losses, data = self.config.losses, self.data
        topology = data.meshes.topology(self.model.topology)
        weights = vertex_importance(topology, losses.region_weight, losses.lid_weight)
        if data.meshes.source == "tracked":
            covered = {COVER: 1.0} if self.model.topology == "tracked" else {}
            tracked = data.meshes.topology("tracked")
            weights = tracked.by_region({MASKED_REGION: 0.0, **covered}, 1.0).astype(np.float32)
        return torch.from_numpy(weights)

    def _mesh(self, mesh: DecodedMesh, frames: list[int]) -> Tensor:
        if self.data.meshes.source == "truth" and self.model.topology == "dense":
            predicted, wanted = mesh.vertices_m, self.data.meshes.dense(frames)
        else:
            predicted, wanted = mesh.tracked_m, self.data.meshes.tracked(frames)
        loss = mesh_loss(predicted, wanted.to(self.device), self._vertex_weights)
        return self.config.losses.mesh * loss

    def _priors(self, mesh: DecodedMesh, kl: Tensor) -> dict[str, Tensor]:
        """KL, and smoothness; V_mu takes its step."""
        weights = self.config.losses
        losses = {"kl": weights.kl * kl}
        if self._laplacian is None:
            return losses
        smooth = torch.zeros((), device=self.device)
        if mesh.position_map_m is not None:
            smooth = smooth + GRADIENT_WEIGHT * gradient_smoothness(mesh.position_map_m)
        smooth = smooth + LAPLACIAN_WEIGHT * laplacian_smoothness(
            self._laplacian, mesh.vertices_m, self.mean_m, self._rough
        )
        follow_mean(self.mean_m, mesh.vertices_m.detach().mean(0, keepdim=True))
        losses["smooth"] = weights.smooth * smooth
        return losses

    def _depth(self, images: list[Place], drawn: DrawnPixels) -> dict[str, Tensor]:
        weights = self.config.losses
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
