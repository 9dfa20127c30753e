"""From a rig's file to a capture that the reader takes."""

import io
import json
from pathlib import Path

import pytest
from PIL import Image

from helpers.rig_toy import toy_rig, write_glb
from pica_command.main import main
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.source import open_image
from pica_core.capture.stage.dome import dome_cameras
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.subject import RigSubject
from pica_core.capture.stage.synth import RenderOptions, render_subject
from pica_core.errors import CaptureError

pytestmark = pytest.mark.render

OPTIONS = RenderOptions(
    frames=4, cameras=2, size="48x48", texture_size=64, seed=2, tracked_vertices=600
)


def png(colour: tuple[int, int, int], mode: str = "RGB") -> bytes:
    out = io.BytesIO()
    Image.new(mode, (8, 8), colour if mode == "RGB" else 40_000).save(out, "PNG")
    return out.getvalue()


@pytest.fixture(scope="module")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "toy.glb"
    return write_glb(path, toy_rig(), image=png((20, 200, 30)))


def subject(path: Path) -> RigSubject:
    return RigSubject(path, bake_size=256, self_shadow=False)


def test_a_rig_becomes_a_capture_that_the_reader_takes(glb: Path, tmp_path: Path) -> None:
    counts = render_subject(lambda: subject(glb), OPTIONS, tmp_path / "out")
    capture = Capture.open(tmp_path / "out")

    assert (counts["frames"], counts["images"]) == (4, 8)
    assert capture.info["rig"]["missing"][0] == "eyeLookDownLeft"
    assert capture.info["rig"]["ignored"] == ["somethingElse"]
    assert capture.info["licence"] == "nobody"
    frame = capture.frames[0]
    vertices = capture.true_vertices_m(frame)
    assert len(vertices) == len(capture.topology.vertex_uv)
    assert capture.depth_m(frame, "front").max() == pytest.approx(0.95, abs=0.1)


def test_an_image_inside_the_file_colours_the_skin(glb: Path) -> None:
    rig = subject(glb)
    rig.pose(blend())
    view = rig.draw(dome_cameras(1, 48, 48)[0])
    rig.release()

    assert view.image[view.mask == MATERIALS.index("skin") + 1].mean(0).argmax() == 1


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = main(["capture", "rig", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--size", "48"], "size is '48'"),
        (["--size", "9x9"], "size is 9x9"),
        (["--frames", "0"], "frames is 0"),
        (["--texture-size", "99999"], "texture_size is 99999"),
        (["--map", "nowhere.json"], "nowhere.json: the file is missing"),
    ],
)
def test_bad_wishes_are_told_before_anything_is_written(
    capsys: pytest.CaptureFixture[str], glb: Path, tmp_path: Path, options: list[str], words: str
) -> None:
    out = tmp_path / "out"
    code, _, errors = run(capsys, "--rig", str(glb), "--out", str(out), *options)

    assert code == 2
    assert words in " ".join(errors.split())
    assert not out.exists()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"no image", "not a complete image"),
        (png((200, 10, 10))[:45], "not a complete image"),
        (png((0, 0, 0), "I;16"), "8-bit colour"),
    ],
)
def test_an_image_of_the_wrong_kind_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(CaptureError, match=words):
        open_image("skin.png", data)


def test_the_command_says_what_was_mapped_missing_and_ignored(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rig = write_glb(tmp_path / "toy.glb", toy_rig())
    out = tmp_path / "out"
    code, printed, _ = run(
        capsys, "--rig", str(rig), "--out", str(out), "--json", "--frames", "4", "--cameras", "1",
        "--size", "32x32", "--texture-size", "32",
    )  # fmt: skip

    assert code == 0
    result = json.loads(printed.splitlines()[-1])
    assert len(result["mapped"]) == 7
    assert len(result["missing"]) == 52 - 6
    assert result["ignored"] == ["somethingElse"]
    assert result["unit"] == "m"
    assert (out / "capture.json").is_file()
