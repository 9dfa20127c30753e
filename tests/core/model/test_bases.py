"""Closed-form bases: exact where meshes are linear."""

import numpy as np
import pytest

from pica_core.avatar.linear import REGION, components_of, fit_bases, split_bases
from pica_core.errors import CaptureError
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

VERTICES, FRAMES, RANK = 600, 40, 6


@pytest.fixture
def meshes_m() -> FloatArray:
    """Meshes of six ways to move, the second half of the vertices at rest."""
    rng = np.random.default_rng(3)
    components = (
        2e-3 * rng.standard_normal((RANK, VERTICES, 3)) * 0.5 ** np.arange(RANK)[:, None, None]
    )
    components[:, VERTICES // 2 :] = 0
    weights = rng.standard_normal((FRAMES, RANK))
    rest = 0.1 * rng.standard_normal((VERTICES, 3))
    return (rest + np.tensordot(weights, components, axes=1)).astype(np.float32)


def error_mm(meshes_m: FloatArray, found_m: FloatArray) -> float:
    return float(np.linalg.norm(found_m - meshes_m, axis=-1).max() * 1e3)


def test_linear_meshes_are_found_exactly(meshes_m: FloatArray) -> None:
    bases = fit_bases(meshes_m[:30], 20, np.linspace(1, 16, VERTICES))
    assert len(bases.components_m) == RANK
    assert error_mm(meshes_m, bases.positions(bases.weights_of(meshes_m))) < 2e-4
    assert bases.weights_of(meshes_m[:30]).std(axis=0) == pytest.approx(np.ones(RANK), abs=0.01)


def test_selected_vertices_follow_the_same_weights(meshes_m: FloatArray) -> None:
    bases = fit_bases(meshes_m, RANK)
    chosen = np.array([5, 3, 500])
    weights = bases.weights_of(meshes_m)
    found_m = bases.select(chosen).positions(weights)
    assert error_mm(meshes_m[:, chosen], found_m) < 2e-4


def test_too_few_or_still_meshes_are_refused(meshes_m: FloatArray) -> None:
    with pytest.raises(CaptureError, match="7 training meshes; bases need 8"):
        fit_bases(meshes_m[:7], 4)
    with pytest.raises(CaptureError, match="all alike"):
        fit_bases(np.repeat(meshes_m[:1], 12, axis=0), 4)


def test_regions_stay_within_their_tolerance_and_rest_where_nothing_moves(
    meshes_m: FloatArray,
) -> None:
    bases = fit_bases(meshes_m, RANK)
    uv = np.stack([np.linspace(0, 1, VERTICES), np.zeros(VERTICES)], axis=1).astype(np.float32)
    parts = split_bases(bases, uv)
    assert len(parts.rank) == -(-VERTICES // REGION)
    assert parts.rank[1] <= RANK
    assert parts.rank[-1] == 0  # the last region lies in the half that is at rest
    assert sorted(parts.order) == list(range(VERTICES))
    tensors = {"linear.mix": parts.mix_m, "linear.basis": parts.basis, "linear.rank": parts.rank}
    whole_m = components_of(tensors, 1.0)[:, :VERTICES]
    lost_m = whole_m - bases.components_m[:, parts.order]
    assert np.sqrt(np.square(lost_m).sum(2).mean(1).sum()) < 3e-5
