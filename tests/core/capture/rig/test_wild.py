"""One head in the forms in which rigs are found: all must give the same picture."""

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.rig_wild import FORMS, wild_rig, write_beside
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.stage.dome import dome_cameras
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.subject import RigSubject
from pica_core.errors import CaptureError
from pica_core.types import ByteArray

pytestmark = pytest.mark.render


def render(path: Path) -> ByteArray:
    subject = RigSubject(path, bake_size=256, self_shadow=False)
    subject.pose(blend(jawOpen=0.6, eyeBlinkLeft=1.0))
    view = subject.draw(dome_cameras(1, 96, 96)[0])
    subject.release()
    return view.image


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> ByteArray:
    return render(wild_rig().save(tmp_path_factory.mktemp("rig") / "plain.glb"))


@pytest.mark.parametrize("form", [*FORMS, "files_beside"])
def test_every_form_of_a_head_gives_the_same_picture(
    plain: ByteArray, tmp_path: Path, form: str
) -> None:
    if form == "files_beside":
        path = write_beside(tmp_path)
    else:
        rig = wild_rig()
        FORMS[form](rig)
        path = rig.save(tmp_path / "toy.glb")

    error = np.abs(render(path).astype(int) - plain).max(-1)

    # Quantisation and another order of packing move edges between blocks by a part of a pixel.
    assert error.mean() < 1.0
    assert (error > 24).mean() < 0.01


def test_a_mirrored_half_keeps_its_picture_when_its_islands_are_made_anew(
    plain: ByteArray, tmp_path: Path
) -> None:
    rig = wild_rig()
    at = rig.primitives[0]["attributes"]["TEXCOORD_0"]
    before = rig.arrays[at].copy()
    # Both halves on one place of the image, as many game heads have it.
    rig.move_uv(lambda uv: np.stack([np.abs(uv[:, 0] - 0.5) + 0.5, uv[:, 1]], 1))

    subject = RigSubject(rig.save(tmp_path / "half.glb"), bake_size=256, self_shadow=False)
    subject.pose(blend(jawOpen=0.6, eyeBlinkLeft=1.0))
    image = subject.draw(dome_cameras(1, 96, 96)[0]).image.astype(int)
    subject.release()

    assert subject.describe()["rig"]["triangles_with_new_coordinates"] > 1000
    assert not np.array_equal(before, rig.arrays[at])
    left = plain.astype(int)[:, 50:]
    error = np.abs(image[:, 50:] - left).max(-1)
    assert (error > 24).mean() < 0.03


def test_eyes_that_are_caps_of_spheres_are_found_by_their_material(tmp_path: Path) -> None:
    rig = wild_rig()
    positions = rig.arrays[rig.primitives[0]["attributes"]["POSITION"]]
    for primitive in rig.primitives[1:3]:
        faces = rig.arrays[primitive["indices"]].reshape(-1, 3)
        ahead = -positions[faces].mean(1)[:, 1]  # the file's -y is out of the face
        front = faces[ahead > 0.078]
        rig.arrays[primitive["indices"]] = front.reshape(-1, 1)

    subject = RigSubject(rig.save(tmp_path / "caps.glb"), bake_size=64, self_shadow=False)

    assert [round(eye.radius_m, 3) for eye in subject.head.mesh.eyes] == [0.012, 0.012]
    np.testing.assert_allclose(subject.head.mesh.eyes[0].centre_m, [0.032, 0.022, 0.074], atol=1e-4)


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("../secret.bin", "leaves the folder"),
        ("%2e%2e/secret.bin", "leaves the folder"),
        ("/etc/hostname", "leaves the folder"),
        ("https://example.org/a.bin", "no file beside it"),
        ("nothing.bin", "the file is missing"),
        ("data:application/octet-stream;base64,!!", "malformed"),
        (7, "malformed"),
    ],
)
def test_a_file_beside_a_gltf_stays_beside_it(tmp_path: Path, uri: object, words: str) -> None:
    (tmp_path / "secret.bin").write_bytes(b"x" * 99)
    folder = tmp_path / "rig"
    folder.mkdir()
    path = write_beside(folder)
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(document))

    with pytest.raises(CaptureError, match=words):
        read_rig(path)
