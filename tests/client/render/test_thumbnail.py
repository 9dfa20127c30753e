"""Small pictures of avatars."""

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.render.thumbnail import draw_thumbnail

pytestmark = pytest.mark.render


def test_a_thumbnail_shows_the_avatar() -> None:
    image = draw_thumbnail(make_toy_avatar(), (96, 128))
    assert image.shape == (128, 96, 3)
    middle, corner = image[50:70, 40:56].mean(axis=(0, 1)), image[:6, :6].mean(axis=(0, 1))
    assert np.abs(middle - corner).max() > 30
