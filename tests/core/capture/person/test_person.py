"""People of the face model: what is chosen stands and comes back, hair and clothes lie outside."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest

from pica_command.main import main
from pica_core import cli
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.person.choices import (
    CLIP,
    NUM_MODES,
    Person,
    draw_person,
    read_model,
    read_person,
)
from pica_core.capture.person.hair import STYLES, cover, grow, raise_cap
from pica_core.capture.person.subject import CUTS, PersonSubject, close_lips, dress, dress_surface
from pica_core.capture.rig.features import LID_M, Limits, find_features
from pica_core.capture.rig.head import PoseGuard
from pica_core.capture.rig.mesh import RigMesh
from pica_core.capture.stage.expressions import blend
from pica_core.capture.triangles import front_view
from pica_core.errors import CaptureError
from pica_core.types import Float64Array

pytestmark = pytest.mark.render


def ball() -> tuple[Float64Array, Float64Array]:
    """A head of a ball on a pole: points and normals."""
    k = np.arange(6000) + 0.5
    y = 1 - 2 * k / 6000
    turn, ring = np.pi * (1 + 5**0.5) * k, np.sqrt(1 - y * y)
    unit = np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], 1)
    a, h = np.meshgrid(np.linspace(-np.pi, np.pi, 60), np.linspace(-0.2, -0.05, 30))
    pole = np.stack([0.05 * np.sin(a), h, 0.05 * np.cos(a) - 0.028], -1).reshape(-1, 3)
    points = np.concatenate([unit * (0.078, 0.115, 0.098) + (0, 0.03, 0), pole])
    outwards = pole * (1, 0, 1) + (0, 0, 0.028)
    return points, np.concatenate([unit, 20 * outwards])


def test_a_seed_makes_one_person_and_a_choice_stands() -> None:
    one, other = draw_person(4, age=61), draw_person(4, age=61)
    assert one == other
    assert one.age == 61
    assert one != draw_person(5, age=61)
    assert max(np.abs(draw_person(4, coefficients=9 * read_model().male).coefficients)) == CLIP


def test_a_seed_of_many_freckles_is_a_person_too() -> None:
    assert draw_person(20905).freckles == 1.0


def test_a_person_comes_back_from_its_file(tmp_path: Path) -> None:
    person = draw_person(7, sex="male", beard="stubble")
    path = tmp_path / "person.json"
    path.write_text(person.as_json())
    assert read_person(path) == person

    table = json.loads(person.as_json())
    table["coefficients"][:2] = [9.0, -9.0]
    path.write_text(json.dumps(table))
    assert read_person(path).coefficients[:2] == (CLIP, -CLIP)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hair": "mohawk"}, "hair is 'mohawk'; there are bald"),
        ({"age": 7}, "age is 7; 18 to 90 is allowed"),
        ({"colour": 1}, "'colour' is no property"),
        ({"coefficients": [0.0]}, "coefficients are 1; 100 are needed"),
        ({"coefficients": ["x"]}, "not a person"),
    ],
)
def test_a_file_that_is_no_person_is_refused(
    change: dict[str, object], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "person.json"
    path.write_text(json.dumps(json.loads(Person(seed=1).as_json()) | change))
    with pytest.raises(CaptureError, match=words):
        read_person(path)


def teeth_seen(mesh: RigMesh) -> int:
    """Cells of a front view in which teeth show."""
    part = np.append(mesh.part, 0)[front_view(mesh.rest_m, mesh.faces).face]
    return int(np.count_nonzero(part == MATERIALS.index("teeth")))


@pytest.mark.parametrize("name", STYLES)
def test_hair_lies_outside_of_head_and_clothes(name: str) -> None:
    points, normals = ball()
    style, nothing = STYLES[name], np.zeros(len(points), np.bool_)
    coverage = cover(points, ~nothing, nothing, style)
    raised = raise_cap(points, normals, coverage, style, 1)
    face = (points[:, 2] > 0.05) & (points[:, 1] < 0.08)

    assert ((raised - points) * normals).sum(1).min() > -1e-9
    assert np.abs(raised - points)[face].max() < 1e-9
    assert np.ptp(raised - points) > 0 or name == "bald"
    cloth = dress_surface(points, CUTS["tee"], 1).surface.points
    sheet = grow(raised, style, 1, np.concatenate([raised, cloth]))
    assert (sheet is not None) == bool(style.hang)
    if sheet is not None:
        # Nothing hangs before the face, below the hairline.
        points = sheet.surface.points
        x, y, z = points.T
        assert not ((z > 0.06) & (np.abs(x) < 0.05) & (y < 0.07)).any()
        low = points[y < 0]
        head = (low - (0, 0.03, 0)) / (0.078, 0.115, 0.098)
        assert np.linalg.norm(head, axis=1).min() > 0.97


def test_lids_meet_in_a_blink_whatever_else_they_do() -> None:
    person = draw_person(3)
    mesh = dress(read_model().mesh(person.coefficients), person)[0]
    features = find_features(mesh)
    limits, guard = Limits(mesh, features), PoseGuard(mesh, features)
    edge = features.regions["lids"] & (features.eye_gap_m < LID_M)

    def widest_gap_mm(arkit: Float64Array) -> float:
        """Between upper and lower lid, over the middle half of both eyes."""
        points, gaps = mesh.rest_m + np.tensordot(limits.apply(arkit), mesh.motion_m, 1), []
        guard.apply(points)
        for eye in mesh.eyes:
            for x in np.linspace(-0.4, 0.4, 5) * eye.radius_m + eye.centre_m[0]:
                here = edge & (np.abs(mesh.rest_m[:, 0] - x) < 0.0015)
                upper, lower = points[here & features.above_eye], points[here & ~features.above_eye]
                gaps.append(upper[:, 1].min() - lower[:, 1].max())
        return 1000 * float(max(gaps))

    assert widest_gap_mm(blend()) > 5.0
    assert widest_gap_mm(blend(eyeBlink=0.7)) > 1.0, "a slit is seen"
    for also in ({}, {"eyeSquint": 0.7}, {"eyeLookDown": 0.6}, {"mouthSmile": 0.8}):
        assert widest_gap_mm(blend(eyeBlink=1.0, **also)) < 0.0


def test_a_blink_closes_only_what_a_glance_down_has_left_open() -> None:
    mesh = read_model().mesh(np.zeros(NUM_MODES))
    limits, blink = Limits(mesh, find_features(mesh)), ARKIT_INDEX["eyeBlinkLeft"]
    assert limits.apply(blend(eyeBlink=1.0))[blink] == pytest.approx(1.0, abs=1e-5)
    assert 0.1 < limits.apply(blend(eyeBlink=1.0, eyeLookDown=1.0))[blink] < 0.9
    assert limits.apply(blend(eyeBlink=0.3, eyeLookDown=0.3))[blink] == pytest.approx(0.3)
    lips = ARKIT_INDEX["mouthClose"]  # which closes no further than the jaw is open
    assert limits.apply(blend(mouthClose=1.0, jawOpen=0.4))[lips] == pytest.approx(0.4)


def test_lips_that_an_identity_parts_meet_at_rest() -> None:
    # The lips of this one are the farthest apart of the people that ship.
    person = draw_person(17, sex="male")
    bare = read_model().mesh(person.coefficients)
    features = find_features(bare)
    closed = close_lips(bare, features)
    moved = closed.rest_m - bare.rest_m
    assert 0.0005 < np.abs(moved).max() < 0.003
    assert np.abs(moved[features.lips < -2.9]).max() < 0.001
    before, after = (teeth_seen(mesh) for mesh in (bare, closed))
    assert before > 40 > 5 > after


def test_a_person_becomes_a_capture_with_all_that_was_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = functools.partial(PersonSubject, coarse=True, self_shadow=False)
    monkeypatch.setattr(cli, "PersonSubject", quick)
    words = ["capture", "person", "--out", str(tmp_path / "out")]
    options = ["--frames", "4", "--cameras", "1", "--size", "48x48", "--texture-size", "64"]
    assert main([*words, *options, "--seed", "9", "--hair", "buzz", "--age", "50"]) == 0

    capture = Capture.open(tmp_path / "out")
    person = read_person(tmp_path / "out" / "person.json")
    assert (person.hair, person.age, person.seed) == ("buzz", 50, 9)
    assert capture.info["person"]["hair"] == "buzz"
    assert "MIT" in capture.info["licence"]
    assert capture.depth_m(capture.frames[0], "front").max() > 0
