"""The face model as a thing to be fitted."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.me.face import chart_uv, fit_face, landmark_places
from pica_core.capture.person.choices import NUM_MODES, read_model

pytestmark = pytest.mark.unit


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "size"), [(0, 1.0), (1, 1000.0), (2, 0.02)])
def test_a_face_is_found_in_its_landmarks_in_any_frame(seed: int, size: float) -> None:
    random = np.random.default_rng(seed)
    places = landmark_places()
    coefficients = random.normal(0, 0.8, NUM_MODES)
    turn = Rotation.random(random_state=seed).as_matrix()
    truth = places.at(coefficients)
    measured = size * truth @ turn.T + random.normal(size=3)
    face = fit_face(places, measured, np.ones(len(truth)))
    assert np.median(face.residual_m) < 0.0006
    np.testing.assert_allclose(face.pose.undo(face.pose.apply(truth)), truth, atol=1e-9)


def test_landmarks_lie_where_their_names_say() -> None:
    places = landmark_places().mean_m
    right_corner, left_corner, tip, chin = places[[33, 263, 4, 152]]
    assert right_corner[0] < -0.03 < 0.03 < left_corner[0]
    assert tip[2] > places[:, 2].max() - 0.004
    assert chin[1] < places[:, 1].min() + 0.01


def test_no_two_places_of_the_skin_share_a_texel() -> None:
    model = read_model()
    skin = model.mean.part == MATERIALS.index("skin")
    corners = chart_uv(model)[model.mean.uv_faces[skin]]
    assert corners.min() >= 0
    assert corners.max() <= 1
    middles = corners.mean(1)
    _, index = np.unique((1024 * middles).astype(int), axis=0, return_inverse=True)
    places = model.mean.rest_m[model.mean.faces[skin]].mean(1)
    order = np.argsort(index.ravel(), kind="stable")
    same = np.diff(index.ravel()[order]) == 0
    apart = np.linalg.norm(np.diff(places[order], axis=0), axis=1)[same]
    assert np.quantile(apart, 0.99) < 0.004
