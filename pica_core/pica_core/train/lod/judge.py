"""How levels look, judged as people look: eyes, mouth, the rest, and what pokes through.

Strong faces are drawn from two sides, about `HEAD_PX` high, by each level and by the full maps on
each level's mesh, and compared with the full level pixel by pixel. The file says nothing of
regions, so they are found by what moves: eyes are what eye movements move most, a mouth what mouth
movements do. A pixel pokes through if it shows another piece of the mesh (an eyeball, teeth) than
the full level shows within a pixel.
"""

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from pica_core.avatar.arkit import ARKIT_NAMES, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import JUDGED, NUM_DRAWINGS
from pica_core.camera import Camera
from pica_core.capture.dataset.dataset import Topology
from pica_core.capture.face_errors import poking
from pica_core.capture.stage.dome import NAMED_VIEWS, dome_cameras
from pica_core.capture.triangles import components, nearest
from pica_core.model.decoders import sample_map
from pica_core.reference.pixel import decode_pixels
from pica_core.train.lod.exits import FaceSet
from pica_core.train.lod.simplify import weld
from pica_core.train.raster import MeshDrawer, Rasteriser
from pica_core.types import Array, BoolArray, ByteArray, FloatArray, IntArray

SHOWN: tuple[dict[str, float], ...] = (
    {},
    {"eyeBlink": 1.0},
    {"jawOpen": 0.8},
    {"mouthSmile": 1.0, "eyeSquint": 0.7},
    {"mouthPucker": 1.0, "browInnerUp": 1.0},
    {"jawOpen": 0.3, "mouthFunnel": 0.8, "eyeWide": 1.0},
    {"eyeBlink": 0.5, "mouthPress": 0.8, "mouthRoll": 0.6},
    {"eyeLookDown": 0.8, "mouthLowerDown": 0.8, "mouthUpperUp": 0.6},
)
"""Faces that are judged: shapes by the beginnings of their names."""
VIEWS = ("front", "left")
IMAGE_SIZE = 384
"""Rows of a picture; heads are about 350 high."""
LEAST_SHARE = 0.3
"""A vertex belongs to eyes or mouth if it moves by so much of what the most moved one does."""

POKE_VIEWS = (*VIEWS, "right")
POKE_REACH_M = 0.006
"""How far around a pixel that pokes through vertices are taken to be at fault (chosen: the distance
of vertices of a collar)."""

SEEN_SIZE = 768
"""Rows of the pictures that tell which vertices can be seen."""
SEEN_RINGS = 2
"""How many neighbours further a vertex counts as seen: the next shape shows them."""


def shown_faces(avatar: Avatar) -> FaceSet:
    """The faces of `SHOWN`, each from both views."""
    arkit = np.zeros((len(SHOWN), NUM_ARKIT), np.float32)
    for row, shapes in zip(arkit, SHOWN, strict=True):
        for start, value in shapes.items():
            row[[name.startswith(start) for name in ARKIT_NAMES]] = value
    latents = _tensor(ExpressionEncoder(avatar).encode(arkit))
    towards = np.stack([camera.centre_m for camera in _cameras()])
    views = torch.from_numpy(towards / np.linalg.norm(towards, axis=1, keepdims=True)).float()
    return FaceSet(
        latents.repeat_interleave(len(VIEWS), 0), views.repeat(len(SHOWN), 1).contiguous()
    )


def looked_at(avatar: Avatar, vertices_of: Callable[[FaceSet], Array]) -> tuple[Array, ...]:
    """Which vertices are eyes, and which mouth, bool ``[V]`` each, by the full level's vertices of
    faces, ``[N, V, 3]``."""
    names = np.array(ARKIT_NAMES)
    latents = _tensor(ExpressionEncoder(avatar).encode(np.eye(NUM_ARKIT, dtype=np.float32)))
    rest = _tensor(ExpressionEncoder(avatar).encode(np.zeros((1, NUM_ARKIT), np.float32)))
    still = vertices_of(FaceSet(rest, torch.zeros(1, 3)))
    moved = np.linalg.norm(vertices_of(FaceSet(latents, torch.zeros(NUM_ARKIT, 3))) - still, axis=2)
    share = []
    for start in ("eye", "mouth"):
        by = moved[np.char.startswith(names, start)].max(0)
        share.append(by / max(float(by.max()), 1e-9))
    eyes, mouth = share
    return (eyes >= LEAST_SHARE) & (eyes > mouth), (mouth >= LEAST_SHARE) & (mouth >= eyes)


def seen_vertices(shapes_m: Array, faces: Array) -> BoolArray:
    """Which vertices the stage's named views see, bool ``[V]``.

    The views reach beyond the viewer's orbit; backs of eyeballs and of teeth, and skin below hair
    or cloth, are seen from nowhere.

    Args:
        shapes_m: The mesh in several faces, metres, ``[K, V, 3]``.
        faces: int32 ``[F, 3]``.
    """
    seen = np.zeros(shapes_m.shape[1], bool)
    with Rasteriser(faces.astype(np.int32), len(seen)) as raster:
        for shape in shapes_m:
            for camera in dome_cameras(len(NAMED_VIEWS), SEEN_SIZE, SEEN_SIZE):
                ids = raster.triangle_ids(shape, camera)
                seen[faces[np.unique(ids[ids >= 0])]] = True
    for _ in range(SEEN_RINGS):
        seen[faces[seen[faces].any(1)]] = True
    return seen


class PokeFinder:
    """Says where a coarser mesh lets one piece of a mesh show through another, and which vertices
    are at fault.

    Args:
        shapes_m: The mesh at rest, then in other faces, metres, ``[K, V, 3]``.
        faces: Its triangles, int32 ``[F, 3]``.
    """

    def __init__(self, shapes_m: Array, faces: Array) -> None:
        self._shapes_m = np.ascontiguousarray(shapes_m, np.float32)
        self._faces, self._piece = faces, _pieces(shapes_m[0], faces)
        self._truth = list(self._draw(faces))

    def find(self, mesh: Array) -> tuple[float, BoolArray]:
        """Compare a mesh of the same vertices, int32 ``[F', 3]``, with the full one.

        Returns:
            The largest ratio of a head's pixels that poke through in a picture; and the vertices
            within `POKE_REACH_M` of such a pixel, of the piece that shows and of the one that
            should, bool ``[V]``.
        """
        most, near = 0.0, np.zeros(len(self._piece), bool)
        for (shape_m, ids), (_, true_ids) in zip(self._draw(mesh), self._truth, strict=True):
            shown = _pieces_of(self._piece, mesh, ids)
            truth = _pieces_of(self._piece, self._faces, true_ids)
            where = poking(shown, truth)
            if where.any():
                most = max(most, float(where.sum() / (truth > 0).sum()))
                pixel, apart_m = nearest(shape_m, shape_m[self._faces[true_ids[where]]].mean(1))
                at_fault = (self._piece == shown[where][pixel]) | (
                    self._piece == truth[where][pixel]
                )
                near |= at_fault & (apart_m <= POKE_REACH_M)
        return most, near

    def _draw(self, mesh: Array) -> Iterator[tuple[FloatArray, IntArray]]:
        with Rasteriser(mesh.astype(np.int32), len(self._piece)) as raster:
            for shape_m in self._shapes_m:
                for camera in _cameras(POKE_VIEWS):
                    yield shape_m, raster.triangle_ids(shape_m, camera)


class Judge:
    """Compares drawings of an avatar with its full level.

    Args:
        avatar: Whose pixel decoder; its full level is the truth.
        regions: Eyes and mouth, bool ``[V]`` each.
        full_vertices_m: Of `shown_faces`, ``[N, V, 3]``.
        full_maps: Their expression maps, ``[N, C, S, S]``.
        still: The map that other maps are added to, ``[C, S, S]``.
    """

    def __init__(
        self,
        avatar: Avatar,
        regions: tuple[Array, ...],
        full_vertices_m: Array,
        full_maps: Tensor,
        still: Tensor,
    ) -> None:
        self._avatar, self._still = avatar, still
        self._vertices_m, self._maps = full_vertices_m, full_maps
        tensors = avatar.tensors
        faces = np.array(tensors["mesh.faces"])
        self._piece = _pieces(avatar.mean_vertices_m, faces)
        self._cameras = _cameras() * len(SHOWN)
        self._truth = list(self._draw(faces, full_vertices_m, full_maps))
        self._region = []
        for _, ids in self._truth:
            corner = faces[np.maximum(ids, 0), 0]
            is_part = [mask[corner] & (ids >= 0) for mask in regions]
            rest = (ids >= 0) & ~np.logical_or.reduce(is_part)
            self._region.append((*is_part, rest))
        self._shown = [_pieces_of(self._piece, faces, ids) for _, ids in self._truth]

    def compare(self, mesh: Array, vertices_m: Array | None, maps: Tensor | None) -> Array:
        """What a drawing leaves, as `JUDGED` names it: MSE 0-255 of eyes, mouth and the rest, and
        the ratio that pokes, ``[4]``.

        Args:
            mesh: Triangles, ``[F, 3]``.
            vertices_m: As `full_vertices_m`, right where the mesh uses them; None for those.
            maps: Changes of the still map, of any size; None for the full maps.
        """
        vertices_m = self._vertices_m if vertices_m is None else vertices_m
        maps = self._maps if maps is None else maps
        sums, counts = np.zeros((2, len(JUDGED)))
        for number, (image, ids) in enumerate(self._draw(mesh, vertices_m, maps)):
            truth, true_ids = self._truth[number]
            error = np.square(image - truth).mean(-1)
            both = (ids >= 0) & (true_ids >= 0)
            for part, mask in enumerate(self._region[number]):
                sums[part] += error[mask & both].sum()
                counts[part] += (mask & both).sum()
            pieces = _pieces_of(self._piece, mesh, ids)
            sums[-1] += poking(pieces, self._shown[number]).sum()
            counts[-1] += (true_ids >= 0).sum()
        return sums / np.maximum(counts, 1)

    def _draw(
        self, faces: Array, vertices_m: Array, maps: Tensor
    ) -> Iterator[tuple[FloatArray, IntArray]]:
        spec, tensors = self._avatar.spec, self._avatar.tensors
        mesh = Topology(vertex_uv=tensors["mesh.vertex_uv"], faces=faces, regions={})
        with Rasteriser.of(mesh) as raster:
            drawer = MeshDrawer(raster, mesh)
            for number, camera in enumerate(self._cameras):
                points = np.ascontiguousarray(vertices_m[number], np.float32)
                drawn = drawer.draw(torch.from_numpy(points)[None], [camera])
                _, uv, xyz_m = drawn.surface
                code = sample_map(maps[number][None], uv)[0]
                if maps is not self._maps:
                    code += sample_map(self._still[None], uv)[0]
                rgb = decode_pixels(spec, tensors, code.numpy(), xyz_m.numpy(), uv.numpy())
                image = np.zeros((camera.height, camera.width, 3), np.float32)
                image.reshape(-1, 3)[drawn.pixels.pixel] = 255 * np.clip(rgb, 0, 1)
                yield image, drawn.ids[0]


def judge_levels(
    judge: Judge, meshes: list[Array], own: list[tuple[Array | None, Tensor]]
) -> Array:
    """The table of an avatar, ``[L, 2, 4]``: by level, the full one last; by drawing, its
    own maps and the full ones; and as `JUDGED` names them. The full level leaves nothing."""
    table = np.zeros((len(meshes) + 1, NUM_DRAWINGS, len(JUDGED)), np.float32)
    for row, mesh, (vertices_m, maps) in zip(table, meshes, own, strict=False):
        row[0] = judge.compare(mesh, vertices_m, maps)
        row[1] = judge.compare(mesh, None, None)
    return table


def _cameras(views: tuple[str, ...] = VIEWS) -> list[Camera]:
    cameras = dome_cameras(5, IMAGE_SIZE, IMAGE_SIZE)
    return [camera for camera in cameras if camera.name in views]


def _pieces_of(piece: Array, faces: Array, ids: IntArray) -> ByteArray:
    """The piece of the triangle that each pixel shows, 0 where none is."""
    return np.where(ids < 0, 0, piece[faces[np.maximum(ids, 0), 0]]).astype(np.uint8)


def _tensor(latents: Array) -> Tensor:
    grid = torch.from_numpy(np.asarray(latents, np.float32))
    return grid.permute(0, 3, 1, 2).contiguous()


def _pieces(vertices_m: Array, faces: Array) -> Array:
    """Which connected piece each vertex is of, from 1, the largest ones; 255 of all others."""
    first = weld(vertices_m)
    label = components(first[faces], len(first))[first]
    names, count = np.unique(label, return_counts=True)
    number = np.full(len(vertices_m), 255)
    for place, name in enumerate(names[np.argsort(-count, kind="stable")][:254]):
        number[label == name] = place + 1
    return number
