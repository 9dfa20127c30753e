"""What counts as poking out, and how far regions are off."""

import numpy as np
import pytest

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.face_errors import poking, region_errors_mm

pytestmark = pytest.mark.unit

SKIN, EYE = 1 + MATERIALS.index("skin"), 1 + MATERIALS.index("eye")


def closed_eye() -> np.ndarray:
    truth = np.zeros((12, 12), np.uint8)
    truth[1:-1, 1:-1] = SKIN
    return truth


def test_an_eyeball_through_a_closed_lid_pokes_out() -> None:
    truth = closed_eye()
    shown = truth.copy()
    shown[5, 4:7] = EYE
    assert np.argwhere(poking(shown, truth)).tolist() == [[5, 4], [5, 5], [5, 6]]


def test_an_edge_that_is_off_by_a_pixel_does_not_and_by_two_does() -> None:
    truth = closed_eye()
    truth[5:, 1:-1] = EYE
    truth[-1] = 0
    for rows, expected in ((1, 0), (2, 10)):
        shown = truth.copy()
        shown[5 - rows : 5, 1:-1] = EYE
        assert poking(shown, truth).sum() == expected


def test_silhouettes_do_not_count_and_no_head_is_no_fault() -> None:
    truth = closed_eye()
    assert not poking(np.full_like(truth, SKIN), truth).any()
    assert not poking(np.zeros_like(truth), truth).any()
    assert not poking(truth, np.zeros_like(truth)).any()


def test_region_errors_are_means_over_their_own_vertices() -> None:
    truth = np.zeros((3, 3), np.float32)
    vertices = np.array([[0.003, 0, 0.004], [0, 0, 0], [0, 0.001, 0]], np.float32)
    masks = {"lids": np.array([1, 1, 0], bool), "lips": np.array([0, 0, 1], bool)}
    masks["teeth"] = np.zeros(3, bool)
    found = region_errors_mm(vertices, truth, masks)
    assert found == pytest.approx({"lids": 2.5, "lips": 1.0})
