"""The mesh Laplacian of the smoothness loss, and the moving mean mesh that it compares with.

Source: Ma et al., "Pixel Codec Avatars" (CVPR 2021), appendix A.2 "Mesh Laplacian"; cotangent
weights as in Sorkine et al., "Laplacian Surface Editing" (2004):

    (L x)_i  =  x_i - sum_j w_ij x_j / sum_j w_ij        w_ij = (cot a_ij + cot b_ij) / 2

over the neighbours j of vertex i, with a and b the angles opposite to the edge. Rows are
normalised, so that L x is a length: how far a vertex lies from where its neighbours would put it.

Ours: cotangents are limited to +-`COTANGENT_LIMIT` and weights to at least `LEAST_WEIGHT`. A mesh
that was sampled from a tracked one has triangles of no area where the tracked one has no surface
(inside the mouth), and obtuse triangles have negative cotangents, whose rows may add up to nothing.
"""

import warnings

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.capture.dataset.dataset import Topology
from pica_core.train.losses import MILLIMETRES, mean_norm
from pica_core.types import Float64Array, FloatArray, Int64Array

COTANGENT_LIMIT = 50.0
"""Largest size of a cotangent (chosen: angles from 1 to 179 degrees go through)."""
LEAST_WEIGHT = 1e-6
"""Smallest weight of an edge: a row without any other averages its neighbours alike."""
ROUGH_WEIGHTS = {"hair": 1.25, "mouth": 1.25}
"""W_L by region of a topology (paper A.2)."""
PLAIN_WEIGHT = 0.25
"""W_L elsewhere (paper A.2)."""
MEAN_RATE = 1e-4
"""How fast the mean mesh follows a batch (paper A.2, lambda_mu)."""


def cotangent_weights(
    vertices_m: npt.ArrayLike, faces: npt.NDArray[np.integer]
) -> tuple[Int64Array, Float64Array]:
    """Directed edges of a mesh and their cotangent weights.

    Args:
        vertices_m: Of the neutral mesh, any length unit, ``[V, 3]``.
        faces: ``[F, 3]``.

    Returns:
        Edges (i, j) sorted, each once in either direction, int64 ``[E, 2]``, and weights w_ij of
        at least `LEAST_WEIGHT`, float64 ``[E]``.
    """
    points = np.asarray(vertices_m, np.float64)
    triangles = np.asarray(faces, np.int64)
    edges, halves = [], []
    for corner in range(3):
        apex, i, j = (triangles[:, (corner + k) % 3] for k in range(3))
        to_i, to_j = points[i] - points[apex], points[j] - points[apex]
        area = np.linalg.norm(np.cross(to_i, to_j), axis=1)
        cotangent = (to_i * to_j).sum(1) / np.maximum(area, 1e-300)
        half = np.clip(cotangent, -COTANGENT_LIMIT, COTANGENT_LIMIT) / 2
        edges += [np.stack([i, j], 1), np.stack([j, i], 1)]
        halves += [half, half]
    # An edge of two triangles comes twice in either direction; equal ones are added.
    unique, place = np.unique(np.concatenate(edges), axis=0, return_inverse=True)
    weights = np.bincount(place.reshape(-1), np.concatenate(halves), len(unique))
    return unique, np.maximum(weights, LEAST_WEIGHT)


def smoothness_weights(topology: Topology) -> FloatArray:
    """The diagonal of W_L. float32 ``[V]``."""
    return topology.by_region(ROUGH_WEIGHTS, PLAIN_WEIGHT).astype(np.float32)


class _SparseProduct(torch.autograd.Function):
    """A constant sparse matrix times a dense one; the gradient is the transposed product."""

    @staticmethod
    def forward(
        context: torch.autograd.function.FunctionCtx, matrix: Tensor, transposed: Tensor, x: Tensor
    ) -> Tensor:
        context.transposed = transposed  # type: ignore[attr-defined]
        return matrix @ x

    @staticmethod
    def backward(
        context: torch.autograd.function.FunctionCtx, gradient: Tensor
    ) -> tuple[None, None, Tensor]:
        transposed: Tensor = context.transposed  # type: ignore[attr-defined]
        return None, None, transposed @ gradient.contiguous()


class MeshLaplacian:
    """L as a sparse matrix on one device.

    Args:
        vertices_m: The coarse neutral mesh at the vertices of the mesh that is drawn, ``[V, 3]``.
        faces: ``[F, 3]``.
    """

    def __init__(
        self,
        vertices_m: npt.ArrayLike,
        faces: npt.NDArray[np.integer],
        *,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        edges, weights = cotangent_weights(vertices_m, faces)
        count = len(np.asarray(vertices_m))
        sums = np.bincount(edges[:, 0], weights, count)
        connected = np.flatnonzero(sums > 0)
        rows = np.concatenate([connected, edges[:, 0]])
        columns = np.concatenate([connected, edges[:, 1]])
        values = np.concatenate([np.ones(len(connected)), -weights / sums[edges[:, 0]]])

        def matrix(first: Int64Array, second: Int64Array) -> Tensor:
            entries = torch.from_numpy(np.stack([first, second]))
            coordinates = torch.sparse_coo_tensor(
                entries, torch.from_numpy(values).to(dtype), (count, count), check_invariants=False
            )
            with warnings.catch_warnings():  # "in beta state", once a process; 6 times faster here
                warnings.filterwarnings("ignore", "Sparse CSR", UserWarning)
                return coordinates.coalesce().to(device).to_sparse_csr()

        self._matrix = matrix(rows, columns)
        self._transposed = matrix(columns, rows)

    def apply(self, meshes: Tensor) -> Tensor:
        """L of each mesh: ``[N, V, 3]`` to ``[N, V, 3]``, in the unit of the input.

        A vertex without neighbours gives 0.
        """
        count, vertices, _ = meshes.shape
        flat = meshes.transpose(0, 1).reshape(vertices, 3 * count)
        product: Tensor = _SparseProduct.apply(  # type: ignore[no-untyped-call]
            self._matrix, self._transposed, flat
        )
        return product.view(vertices, count, 3).transpose(0, 1)


def laplacian_smoothness(
    laplacian: MeshLaplacian, vertices_m: Tensor, mean_m: Tensor, weights: Tensor
) -> Tensor:
    """Root mean square of W_L L (S(G) - V_mu) of each mesh, averaged over meshes, millimetres.

    Args:
        vertices_m: S(G), the decoded meshes, metres, ``[N, V, 3]``.
        mean_m: V_mu, metres, ``[V, 3]``; no gradient goes there.
        weights: W_L, ``[V]``.
    """
    offset_mm = (vertices_m - mean_m.detach()) * MILLIMETRES
    return mean_norm(laplacian.apply(offset_mm) * weights[:, None])


@torch.no_grad()
def follow_mean(mean_m: Tensor, vertices_m: Tensor) -> None:
    """V_mu <- (1 - rate) V_mu + rate times the mean of a batch of meshes ``[N, V, 3]``, in place,
    without gradient.

    Source: appendix A.2, the update of the regularisation target; the rate is `MEAN_RATE`.
    """
    mean_m.lerp_(vertices_m.detach().mean(0), MEAN_RATE)
