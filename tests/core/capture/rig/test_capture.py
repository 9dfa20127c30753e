"""From a rig's file to a capture that the reader takes."""

import io
import json
from pathlib import Path
from struct import pack
from zlib import crc32

import pytest
from PIL import Image

from helpers.rig_toy import toy_rig, write_glb
from pica_command.main import main
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.rig.source import open_image
from pica_core.errors import CaptureError

pytestmark = pytest.mark.render


def png(colour: tuple[int, int, int], mode: str = "RGB", kind: str = "PNG") -> bytes:
    out = io.BytesIO()
    Image.new(mode, (8, 8), colour if mode == "RGB" else 40_000).save(out, kind)
    return out.getvalue()


def claiming(width: int, height: int) -> bytes:
    """A small PNG that says it is of another size."""
    data = png((0, 0, 0))
    head = data[12:16] + pack(">II", width, height) + data[24:29]
    return data[:12] + head + pack(">I", crc32(head)) + data[33:]


@pytest.fixture(scope="module")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "toy.glb"
    return write_glb(path, toy_rig(), image=png((20, 200, 30)))


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
        (png((200, 10, 10), kind="EPS"), "cannot identify"),  # it would start Ghostscript
        (png((200, 10, 10), kind="BMP"), "cannot identify"),
        (png((0, 0, 0), "I;16"), "8-bit colour"),
        (claiming(9000, 30), "9000x30 pixels; sides up to 8192"),
        (claiming(30_000, 30_000), "900000000 pixels.*sides up to 8192"),
    ],
)
def test_an_image_of_the_wrong_kind_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(CaptureError, match=words):
        open_image("skin.png", data)


def test_a_rig_becomes_a_capture_and_the_command_says_what_was_mapped(
    capsys: pytest.CaptureFixture[str], glb: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, printed, _ = run(
        capsys, "--rig", str(glb), "--out", str(out), "--json", "--frames", "4", "--cameras", "1",
        "--size", "48x48", "--texture-size", "32",
    )  # fmt: skip

    assert code == 0
    result = json.loads(printed.splitlines()[-1])
    assert (result["frames"], result["images"], result["unit"]) == (4, 4, "m")
    assert (len(result["mapped"]), len(result["missing"])) == (7, 52 - 6)
    assert result["ignored"] == ["somethingElse"]
    capture = Capture.open(out)
    assert (capture.info["licence"], capture.identity) == ("nobody", "toy")
    frame = capture.frames[0]
    assert len(capture.true_vertices_m(frame)) == len(capture.topology.vertex_uv)
    depth_m, image = capture.depth_m(frame, "front"), capture.image(frame, "front")
    assert depth_m.max() == pytest.approx(0.95, abs=0.1)
    assert image[depth_m > 0].mean(0).argmax() == 1  # the image inside the file is green
