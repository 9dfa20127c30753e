"""The surface that covers the mouth of a tracked mesh."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from helpers.small_capture import small_head
from pica_core.capture.dataset.dataset import Topology
from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.tracked_topology import COVER, track_topology

pytestmark = [pytest.mark.unit, pytest.mark.slow]

OPEN = blend(jawOpen=0.7)


@pytest.fixture(scope="module")
def tracked() -> tuple[Topology, np.ndarray]:
    head = small_head(coarse=False)
    shapes = np.stack([head.vertices(each) for each in (blend(), OPEN, blend(eyeBlink=1.0))])
    return track_topology(head.topology, shapes, 3000)


def directed_edges(faces: np.ndarray) -> list[tuple[int, int]]:
    return [tuple(edge) for edge in faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()]


def test_the_cover_closes_the_border_of_the_lips(tracked: tuple[Topology, np.ndarray]) -> None:
    topology, index = tracked
    cover = topology.regions[COVER]
    assert cover.sum() > 20
    places = index[topology.faces]  # the cover's vertices are the lips' once more
    edges = Counter(directed_edges(places))
    assert max(edges.values()) == 1  # neighbours are turned alike
    lips = set(index[topology.regions["lips"]].tolist())
    alone = [edge for edge in edges if edge[::-1] not in edges and set(edge) <= lips]
    assert not alone


def test_an_open_mouth_shows_the_outer_side_of_its_cover(
    tracked: tuple[Topology, np.ndarray],
) -> None:
    topology, index = tracked
    vertices = small_head(coarse=False).vertices(OPEN)[index]
    faces = topology.faces[topology.regions[COVER][topology.faces].all(1)]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(normals, axis=1)
    assert area.sum() > 4e-4  # four square centimetres
    assert area[normals[:, 2] > 0].sum() > 0.97 * area.sum()


def test_the_cover_has_texels_of_its_own(tracked: tuple[Topology, np.ndarray]) -> None:
    topology, _ = tracked
    cover = topology.regions[COVER]
    texel = topology.vertex_uv * MAP_SIZE - 0.5
    np.testing.assert_allclose(texel[cover], np.rint(texel[cover]), atol=1e-3)
    assert len(np.unique(np.rint(texel[cover]), axis=0)) == cover.sum()
    low, high = texel[cover].min(0) - 1, texel[cover].max(0) + 1
    assert not ((texel[~cover] > low) & (texel[~cover] < high)).all(1).any()
    corners = topology.vertex_uv[topology.faces[cover[topology.faces].all(1)]]
    sides = corners[:, 1:] - corners[:, :1]
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    assert (area < 0).all() or (area > 0).all()  # no triangle folds over another
