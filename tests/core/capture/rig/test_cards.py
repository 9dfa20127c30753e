"""Cards are cut along their picture."""

import numpy as np
import pytest

from pica_core.capture.rig.gltf import cut
from pica_core.capture.triangles import components, signed_areas
from pica_core.types import Float64Array, Int64Array, IntArray

pytestmark = pytest.mark.unit

COUNT = 6


def grid() -> tuple[Float64Array, IntArray]:
    """A square of `COUNT` x `COUNT` squares of two triangles each."""
    steps = np.linspace(0, 1, COUNT + 1)
    points = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    row = COUNT + 1
    first = (np.arange(COUNT)[:, None] * row + np.arange(COUNT)).reshape(-1, 1)
    faces = np.concatenate([first + np.array(more) for more in ((0, 1, row), (1, row + 1, row))])
    return points, faces.astype(np.int32)


@pytest.mark.parametrize("radius", [0.16, 0.31, 0.48])
def test_what_is_left_of_a_card_has_the_shape_and_one_piece_of_its_picture(radius: float) -> None:
    points, faces = grid()

    def opacity(chosen: Int64Array, inside: Float64Array) -> Float64Array:
        at = np.einsum("kc,ncd->nkd", inside, points[faces[chosen]])
        return 0.5 + radius - np.linalg.norm(at - 0.5, axis=-1)  # solid within a circle

    whole, at, weights, pieces = cut(faces, opacity, 0.5)

    assert np.allclose(weights.sum(1), 1)
    everywhere = np.concatenate([points, np.einsum("nc,ncd->nd", weights, points[at])])
    left = np.concatenate([faces[whole], pieces + len(points)])
    areas = signed_areas(everywhere, left)
    assert areas.min() >= 0
    assert areas.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    # Points of neighbours are the same, to the last bit: the card stays in one piece.
    _, welded = np.unique(everywhere, axis=0, return_inverse=True)
    joined = welded[left[areas > 1e-9]]
    assert len(set(components(joined, len(everywhere))[joined[:, 0]])) == 1


def test_a_card_that_is_clear_or_solid_is_not_cut() -> None:
    _, faces = grid()
    for value, is_kept in ((0.2, False), (0.8, True)):
        found = cut(faces, lambda chosen, at, v=value: np.full((len(chosen), len(at)), v), 0.5)
        assert found[0].all() == found[0].any() == is_kept
        assert not len(found[3])
