"""Whatever is damaged in a capture is a CaptureError that names the file, when it is read."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pica_core.capture.dataset.check import check_capture
from pica_core.capture.dataset.files import read_vertices
from pica_core.errors import CaptureError

pytestmark = pytest.mark.render


@pytest.fixture
def damaged(rendered: Path, tmp_path: Path) -> Path:
    shutil.copytree(rendered, tmp_path / "copy")
    return tmp_path / "copy"


def first_of(root: Path, pattern: str) -> Path:
    """The file of the first frame."""
    segment, name = (root / "frame_list.txt").read_text().split()[:2]
    return root / pattern.format(segment=segment, name=name)


def problems_of(root: Path) -> list[str]:
    """What a check says is wrong with a capture."""
    try:
        problems: list[str] = check_capture(root)["problems"]
    except CaptureError as error:
        return [str(error)]
    return problems


def test_a_fresh_capture_is_whole(rendered: Path) -> None:
    assert problems_of(rendered) == []


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def set_nan(path: Path) -> None:
    values = np.frombuffer(path.read_bytes(), "<f4").copy()
    values[5] = np.nan
    path.write_bytes(values.tobytes())


def in_metres(path: Path) -> None:
    path.write_bytes((np.frombuffer(path.read_bytes(), "<f4") / 1000).astype("<f4").tobytes())


def mirror_cameras(path: Path) -> None:
    """Exchange left and right."""
    lines = path.read_text().splitlines()
    for start in range(0, len(lines) - 8, 9):
        lines[start + 5] = " ".join(str(-float(word)) for word in lines[start + 5].split())
    path.write_text("\n".join(lines))


def scale_rotation(path: Path) -> None:
    rows = [[float(word) for word in line.split()] for line in path.read_text().splitlines()]
    path.write_text("\n".join(" ".join(str(2 * value) for value in row) for row in rows))


def replace(old: str, new: str) -> Callable[[Path], None]:
    def work(path: Path) -> None:
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return work


def image(mode: str, width: int, kind: str = "PNG") -> Callable[[Path], None]:
    return lambda path: Image.new(mode, (width, 64)).save(path, kind)


@pytest.mark.parametrize(
    ("file", "damage", "what"),
    [
        ("images/{segment}/left/{name}.png", Path.unlink, "the file is missing"),
        ("images/{segment}/left/{name}.png", lambda path: cut(path, 900), "not a complete image"),
        ("images/{segment}/left/{name}.png", image("RGB", 64, "EPS"), "cannot identify"),
        ("images/{segment}/front/{name}.png", image("RGB", 32), "is 32x64, 64x64 is needed"),
        ("depth/{segment}/left/{name}.png", image("L", 64), "a 16-bit image is needed"),
        ("depth/{segment}/left/{name}.png", Path.unlink, "the file is missing"),
        ("tracked_mesh/{segment}/{name}.bin", Path.unlink, "No such file"),
        ("tracked_mesh/{segment}/{name}.bin", set_nan, "not all finite"),
        ("tracked_mesh/{segment}/{name}.bin", in_metres, "are its units mm"),
        ("truth_mesh/{segment}/{name}.bin", set_nan, "not all finite"),
        ("tracked_mesh/{segment}/{name}_transform.txt", scale_rotation, "no rotation"),
        (
            "unwrapped_uv_64/{segment}/average/{name}.png",
            lambda path: cut(path, 60),
            "not a complete image",
        ),
        ("KRT", lambda path: cut(path, 200), "numbers of K"),
        ("KRT", mirror_cameras, "R is no rotation"),
        ("expressions.csv", replace("jawOpen", "jawAjar"), "not a table of frames"),
        (
            "expressions.csv",
            lambda path: cut(path, 1500),
            "row cannot be read|split|no frame is for",
        ),
        ("capture.json", lambda path: cut(path, 99), "not JSON"),
        ("topology.npz", lambda path: cut(path, 5000), "archive"),
    ],
)
def test_damage_is_found_and_named(
    damaged: Path, file: str, damage: Callable[[Path], object], what: str
) -> None:
    damage(first_of(damaged, file))

    problems = problems_of(damaged)

    assert any(
        re.search(f"{Path(file).stem.split('{')[0]}.*: .*({what})", each) for each in problems
    )


def test_a_segment_in_both_splits_is_refused(damaged: Path) -> None:
    path = damaged / "expressions.csv"
    text = path.read_text()
    name = re.search(r"^(\w+),\d+,train", text, re.MULTILINE)[1]  # type: ignore[index]
    path.write_text(
        re.sub(r"^\w+,\d+,test", f"{name},000099,test", text, flags=re.MULTILINE, count=1)
    )

    assert problems_of(damaged) == [f"{path}: segment {name} is in both splits"]


def test_a_whole_body_has_the_size_of_one(tmp_path: Path) -> None:
    path = tmp_path / "body.bin"
    for height_m, is_read in ((2.44, True), (0.00244, False), (24.4, False)):
        np.array([[0, 0, 0], [0, 1e3 * height_m, 0]], "<f4").tofile(path)
        if is_read:
            assert read_vertices(path, 2)[1, 1] == pytest.approx(height_m)
        else:
            with pytest.raises(CaptureError, match="are its units mm"):
                read_vertices(path, 2)


def change_chart(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def work(root: Path) -> None:
        with np.load(root / "topology.npz") as arrays:
            values = dict(arrays)
        values["vertex_uv"] = change(values["vertex_uv"]).astype(np.float32)
        np.savez(root / "topology.npz", **values)

    return work


def change_meshes(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def work(root: Path) -> None:
        paths = sorted(root.glob("tracked_mesh/*/*.bin"))
        meshes = np.array([np.fromfile(path, "<f4").reshape(-1, 3) for path in paths])
        for path, mesh in zip(paths, change(meshes), strict=True):
            mesh.astype("<f4").tofile(path)

    return work


def pierce_depth(root: Path) -> None:
    for path in root.glob("depth/*/front/*.png"):
        depth = np.array(Image.open(path))
        depth[:, ::2] = 0
        Image.fromarray(depth).save(path)


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (change_chart(lambda uv: np.abs(uv - [0.5, 0])), "islands lie on each other"),
        (change_chart(lambda uv: 2 * uv), "of the triangles leave the square of the texture"),
        (change_meshes(lambda meshes: meshes[[0] * len(meshes)]), "jawOpen moves nothing"),
        (change_meshes(lambda meshes: meshes * [-1, 1, -1]), "mouth of .* hidden; does the head"),
        (pierce_depth, "mouth of .* from camera front: .* of it is empty"),
    ],
)
def test_pictures_that_show_no_face_are_a_problem(
    damaged: Path, damage: Callable[[Path], None], problem: str
) -> None:
    damage(damaged)
    assert re.search(problem, "\n".join(problems_of(damaged)))
