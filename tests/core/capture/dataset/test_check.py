"""`pica capture check` finds what was broken, names it, and survives everything."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.small_capture import render_capture
from pica_core.capture.dataset.check import check_capture
from pica_core.capture.stage.synth import RenderOptions
from pica_core.cli.capture import CheckOptions, check
from pica_core.errors import CaptureError

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("capture") / "S1"
    options = RenderOptions(
        frames=5,
        cameras=2,
        size="64x64",
        texture_size=64,
        seed=5,
        tracked_vertices=900,
    )
    render_capture(options, out)
    return out


@pytest.fixture
def damaged(rendered: Path, tmp_path: Path) -> Path:
    shutil.copytree(rendered, tmp_path / "copy")
    return tmp_path / "copy"


def first_of(root: Path, pattern: str) -> Path:
    """The file of the first frame."""
    segment, name = (root / "frame_list.txt").read_text().split()[:2]
    return root / pattern.format(segment=segment, name=name)


def test_a_fresh_capture_is_clean(rendered: Path) -> None:
    result = check_capture(rendered)
    assert result["problems"] == []
    assert result["ok"]
    assert (result["frames"], result["cameras"], result["images"]) == (5, 2, 10)
    assert sum(result["split"].values()) == 5
    assert min(result["split"].values()) >= 1
    json.dumps(result)


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def set_nan(path: Path) -> None:
    values = np.frombuffer(path.read_bytes(), "<f4").copy()
    values[5] = np.nan
    path.write_bytes(values.tobytes())


def in_metres(path: Path) -> None:
    path.write_bytes((np.frombuffer(path.read_bytes(), "<f4") / 1000).astype("<f4").tobytes())


def turn_cameras(path: Path) -> None:
    """Let cameras look the other way: half a turn about their y axes."""
    lines = path.read_text().splitlines()
    for start in range(0, len(lines) - 8, 9):
        for row in (5, 7):
            numbers = [str(-float(word)) for word in lines[start + row].split()]
            lines[start + row] = " ".join(numbers)
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


@pytest.mark.parametrize(
    ("file", "damage", "what"),
    [
        ("images/{segment}/left/{name}.png", Path.unlink, "the file is missing"),
        ("images/{segment}/left/{name}.png", lambda path: cut(path, 900), "it ends early"),
        (
            "images/{segment}/front/{name}.png",
            lambda path: Image.new("RGB", (32, 64)).save(path),
            "the image is 32x64, 64x64 is needed",
        ),
        (
            "depth/{segment}/left/{name}.png",
            lambda path: Image.new("L", (64, 64), 7).save(path),
            "a 16-bit image is needed",
        ),
        ("depth/{segment}/left/{name}.png", Path.unlink, "the file is missing"),
        ("tracked_mesh/{segment}/{name}.bin", Path.unlink, "No such file"),
        ("tracked_mesh/{segment}/{name}.bin", set_nan, "not all finite"),
        ("tracked_mesh/{segment}/{name}.bin", in_metres, "are its units mm"),
        ("truth_mesh/{segment}/{name}.bin", set_nan, "not all finite"),
        ("tracked_mesh/{segment}/{name}_transform.txt", scale_rotation, "not a rotation"),
        (
            "unwrapped_uv_64/{segment}/average/{name}.png",
            lambda path: cut(path, 60),
            "ends early|incomplete",
        ),
        ("KRT", lambda path: cut(path, 200), "numbers of K"),
        ("KRT", turn_cameras, "camera front sees 0.0% of the mesh"),
        ("expressions.csv", replace("jawOpen", "jawAjar"), "not a table of frames"),
        (
            "expressions.csv",
            lambda path: cut(path, 1500),
            "row cannot be read|split|no frame is for",
        ),
        ("capture.json", lambda path: cut(path, 99), "not JSON"),
        ("topology.npz", lambda path: cut(path, 5000), "archive"),
        ("KRT", lambda path: (path.parent / "render.json").write_text("{}"), "not finished"),
        ("KRT", lambda path: (path.parent / "x.bin.part").write_text(""), "half-written"),
    ],
)
def test_damage_is_found_and_named(
    damaged: Path, file: str, damage: Callable[[Path], object], what: str
) -> None:
    damage(first_of(damaged, file))

    result = check_capture(damaged)

    assert not result["ok"]
    assert any(re.search(what, problem["what"]) for problem in result["problems"]), result
    assert all(problem["where"] for problem in result["problems"])


def test_a_segment_in_both_splits_is_a_leak(damaged: Path) -> None:
    path = damaged / "expressions.csv"
    lines = path.read_text().splitlines()
    segment = next(line.split(",")[0] for line in lines[1:] if ",test," in line)
    name = next(line.split(",")[0] for line in lines[1:] if ",train," in line)
    lines = [line.replace(f"{segment},", f"{name},").replace(",000000,", ",000007,")
             if line.startswith(segment) else line for line in lines]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    for folder in damaged.glob(f"*/{segment}"):
        for file in folder.rglob("000000*"):
            target = folder.parent / name / file.relative_to(folder).parent
            target.mkdir(parents=True, exist_ok=True)
            file.rename(target / file.name.replace("000000", "000007"))

    problems = check_capture(damaged)["problems"]

    assert {"where": name, "what": "the segment is in both splits"} in problems


def test_any_damage_at_all_ends_in_a_result(damaged: Path, rendered: Path) -> None:
    random = np.random.default_rng(0)
    files = sorted(path.relative_to(rendered) for path in rendered.rglob("*") if path.is_file())
    describing = [name for name in files if len(name.parts) == 1]
    for turn in range(40):
        name = (describing if turn % 2 else files)[int(random.integers(1 << 20)) % (
            len(describing) if turn % 2 else len(files))]  # fmt: skip
        good = (rendered / name).read_bytes()
        data = bytearray(good)
        kind = turn % 4
        if kind == 0:
            del data[int(random.integers(len(data))) :]
        else:
            for at in random.integers(len(data), size=1 + 20 * kind):
                data[at] = int(random.integers(256))
        (damaged / name).write_bytes(data)

        result = check_capture(damaged)

        assert isinstance(result["ok"], bool)
        assert all(set(problem) == {"where", "what"} for problem in result["problems"])
        (damaged / name).write_bytes(good)
    assert check_capture(damaged)["ok"]


def test_the_command_tells_people_and_programs(
    damaged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first_of(damaged, "images/{segment}/left/{name}.png").unlink()
    result = check(CheckOptions(capture=damaged))
    assert result["ok"] is False
    said = capsys.readouterr().err
    assert "the file is missing" in said
    assert "not ok, 5 frames" in said
    with pytest.raises(CaptureError, match="no such directory"):
        check(CheckOptions(capture=damaged / "nowhere"))
