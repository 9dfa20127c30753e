"""Photos of drawn people give heads that are like them."""

import numpy as np
import pytest
from PIL import Image

from helpers.face_networks import face_networks
from helpers.likeness import likeness_order
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.camera import aimed_camera
from pica_core.capture.me.photos import fit_landmarks, photo_of
from pica_core.capture.me.pictured import Fitted, head_of_photos, unlike_skin
from pica_core.capture.person.choices import HAIR_COLOURS, SKIN_TONES, draw_person
from pica_core.capture.person.subject import PersonSubject, paint

pytestmark = pytest.mark.render

AZIMUTHS, SIDE = (0, 25, -25, 45, -45), 640


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "hair"), [(303, "bald"), (306, "short")])
def test_a_head_of_photos_is_most_like_its_person_among_fifty(
    seed: int, hair: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bald man with grey brows; black brows and cropped hair. Charts are of half the size."""
    monkeypatch.setattr("pica_core.capture.me.scanned.TEXTURE_SIZE", 512)
    monkeypatch.setattr("pica_core.capture.me.pictured.OUTLINE_TEXELS", 7)
    monkeypatch.setattr("pica_core.capture.me.pictured.DETAIL_TEXELS", 3.0)
    person = draw_person(seed)
    subject = PersonSubject(person, bake_size=512, self_shadow=False, coarse=True)
    subject.pose(np.zeros(NUM_ARKIT))
    cameras = [
        aimed_camera("", azimuth, 0.0, "head", width=SIDE, height=SIDE) for azimuth in AZIMUTHS
    ]
    photos = [
        photo_of("", Image.fromarray(subject.draw(each).image), 28.0, None, face_networks(), "")
        for each in cameras
    ]
    subject.release()
    found, _ = fit_landmarks(photos, None)
    fitted = Fitted(photos=photos, solution=found, off_px=0.0, is_sized=False)
    head = head_of_photos(fitted, {}, "photos")
    assert likeness_order(head)[0] == seed
    assert head.person.hair == hair
    brow = np.array(paint(person)["brow_rgb"])
    assert np.abs(np.log(np.array(head.look["brow_rgb"]) / brow)).max() < 0.35


def test_brighter_skin_is_skin_and_no_hair_is_like_it() -> None:
    """Shine on a bald head, and hair of all colours on light skin."""
    for tone in np.array(SKIN_TONES):
        assert unlike_skin(1.4 * tone, tone) < 0.01
    for name, colour in HAIR_COLOURS.items():
        assert unlike_skin(np.array(colour), np.array(SKIN_TONES[1])) > 0.25, name
