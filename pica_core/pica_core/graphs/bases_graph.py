"""Bases as an ONNX graph: latent to a sheet of vertices by a few products of matrices.

Regions of about one rank are multiplied together, one batch for each `STEP` of ranks: a product of
its own for each of a hundred regions would cost more in calls than in arithmetic.
"""

from collections.abc import Mapping

import numpy as np

from pica_core.avatar.file import Avatar
from pica_core.avatar.linear import PREFIX, RANK, REGION, components_of
from pica_core.avatar.spec import POSITION_CHANNELS
from pica_core.graphs.graph_builder import GraphBuilder
from pica_core.latent import NUM_LATENT
from pica_core.types import Array

STEP = 4
"""Ranks are filled up to multiples of this with directions that are 0."""


def bases_graph(graph: GraphBuilder, avatar: Avatar, size: int, *, plain: bool) -> None:
    """Add the nodes that make ``position_map`` from ``latent``.

    Args:
        plain: Use one product with all vertices, regions put together again.
    """
    tensors, scale_m = avatar.tensors, avatar.manifest.position_scale_m
    flat = graph.add("Reshape", "latent", graph.sizes(1, NUM_LATENT))
    weight, bias = (graph.floats(tensors[f"{PREFIX}{part}"]) for part in ("weight", "bias"))
    weights = graph.add("Gemm", flat, weight, bias, transB=1)
    rows = avatar.position_rows(size)
    if size == avatar.spec.map_size and not plain:
        moved = _by_regions(graph, tensors, scale_m, weights)
        mean = tensors[f"{PREFIX}mean"]
    else:
        places = avatar.sheet_places(size)
        whole = components_of(tensors, scale_m, places)
        mean = tensors[f"{PREFIX}mean"].reshape(-1, POSITION_CHANNELS)[places]
        moved = graph.add("MatMul", weights, graph.floats(whole.reshape(len(whole), -1)))
    moved = graph.add("Reshape", moved, graph.sizes(rows, size, POSITION_CHANNELS))
    mean = mean.reshape(rows, size, POSITION_CHANNELS)
    graph.add("Add", moved, graph.floats(mean), output="position_map")


def _by_regions(
    graph: GraphBuilder, tensors: Mapping[str, Array], scale_m: float, weights: str
) -> str:
    rank, mix, basis = tensors[RANK], tensors[f"{PREFIX}mix"], tensors[f"{PREFIX}basis"]
    starts = np.cumsum(rank) - rank
    filled = -(-rank // STEP) * STEP
    pieces = []
    first = 0
    for last in [*(np.flatnonzero(np.diff(filled)) + 1).tolist(), len(filled)]:
        count, most = last - first, int(filled[first])
        columns = REGION * POSITION_CHANNELS
        if most:
            local = np.zeros((count, most, mix.shape[1]), np.float32)
            offsets = np.zeros((count, most, columns), np.float32)
            for row in range(count):
                part = slice(starts[first + row], starts[first + row] + rank[first + row])
                local[row, : rank[first + row]] = scale_m * mix[part]
                offsets[row, : rank[first + row]] = basis[part].reshape(-1, columns)
            value = graph.add("MatMul", weights, graph.floats(local.reshape(-1, mix.shape[1]).T))
            value = graph.add("Reshape", value, graph.sizes(count, 1, most))
            value = graph.add("MatMul", value, graph.floats(offsets))
            pieces.append(graph.add("Reshape", value, graph.sizes(1, count * columns)))
        else:
            pieces.append(graph.floats(np.zeros((1, count * columns))))
        first = last
    return graph.add("Concat", *pieces, axis=1)
