"""Reading and writing avatar files: what goes in comes out, and nothing hostile comes in."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_core.avatar import file as avatar_file
from pica_core.avatar.file import Avatar, avatar_id, load_avatar, save_avatar
from pica_core.avatar.levels import STATIC_NAME
from pica_core.avatar.linear import linear_shapes
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(grid=8, spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20))
SPEC = asdict(TOY.spec)


@pytest.fixture(scope="module")
def toy_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("avatar") / "toy.pica"
    save_avatar(path, TOY)
    return path.read_bytes()


def split(data: bytes) -> tuple[dict[str, Any], bytes]:
    length = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def join(header: Any, body: bytes) -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + body


def with_manifest(data: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    header, body = split(data)
    manifest = json.loads(header["__metadata__"]["pica"])
    change(manifest)
    header["__metadata__"]["pica"] = json.dumps(manifest)
    return join(header, body)


def with_tensor(name: str, array: np.ndarray[Any, Any]) -> Avatar:
    return Avatar(TOY.manifest, {**TOY.tensors, name: array})


LEVELLED = with_toy_levels(TOY)
PARTS = np.arange(16, dtype=np.uint8) & 0x55
WITH_PARTS = Avatar(LEVELLED.manifest, {**LEVELLED.tensors, STATIC_NAME: PARTS})


@pytest.mark.parametrize("avatar", [TOY, LEVELLED, WITH_PARTS])
def test_a_saved_avatar_is_read_back_with_its_manifest_and_nearly_its_tensors(
    tmp_path: Path, avatar: Avatar
) -> None:
    save_avatar(tmp_path / "a.pica", avatar)
    loaded = load_avatar(tmp_path / "a.pica")
    assert loaded.manifest.to_json() == avatar.manifest.to_json()
    assert loaded.levels == avatar.levels
    assert set(loaded.tensors) == set(avatar.tensors)
    for name, array in avatar.tensors.items():
        spread = float(np.ptp(array.astype(np.float64)))
        # 8 bits over the channel's range is the coarsest storage: half a step, plus rounding.
        steps = 65535 if name in ("geometry.mean", "linear.mean", "mesh.vertex_uv") else 255
        is_exact = array.dtype.kind in "iu"
        assert np.abs(loaded.tensors[name] - array).max() <= 0.51 / steps * spread * (not is_exact)
    with pytest.raises(ValueError, match="read-only"):
        loaded.tensors["u_encoding"][0] = 0


def test_saving_the_same_avatar_again_gives_the_same_identity(tmp_path: Path) -> None:
    identities = set()
    for _ in range(8):  # what is left to chance shows by then
        save_avatar(tmp_path / "a.pica", TOY)
        identities.add(avatar_id(tmp_path / "a.pica"))
    assert identities == {avatar_id((tmp_path / "a.pica").read_bytes())}


def test_a_file_over_the_limit_is_refused_unread(
    tmp_path: Path, toy_bytes: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(avatar_file, "MAX_FILE_BYTES", 1000)
    (tmp_path / "big.pica").write_bytes(toy_bytes)
    with pytest.raises(AvatarFileError, match=r"big\.pica: file is larger than 1000 bytes"):
        load_avatar(tmp_path / "big.pica")


@pytest.mark.parametrize("keep", [0, 7, 8, 100, 5000, -1])
def test_a_file_that_is_cut_or_goes_on_is_refused(toy_bytes: bytes, keep: int) -> None:
    for data in (toy_bytes[:keep], toy_bytes + b"smuggled"):
        with pytest.raises(AvatarFileError):
            load_avatar(data)


def test_a_giant_header_length_is_refused_before_anything_is_allocated() -> None:
    with pytest.raises(AvatarFileError, match="header of 18446744073709551615 bytes"):
        load_avatar(b"\xff" * 64)


def test_a_safetensors_file_without_manifest_is_not_an_avatar() -> None:
    with pytest.raises(AvatarFileError, match="no 'pica' manifest"):
        load_avatar(safetensors.numpy.save({"a": np.zeros(3, np.float32)}))


@pytest.mark.parametrize(
    "text",
    [b"[" * 200_000, b'{"a": NaN}', b'{"a": 1, "a": 2}', b"[]", b"\xff\xfe", b"9" * 5000],
    ids=["deep", "constant", "duplicate", "list", "not-utf8", "long-number"],
)
def test_a_hostile_header_is_refused(text: bytes) -> None:
    with pytest.raises(AvatarFileError):
        load_avatar(len(text).to_bytes(8, "little") + text)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("schema_version", 2, "schema_version is 2; this program reads 1"),
        ("schema_version", True, "schema_version"),
        ("name", "", "name must be 1 to 200"),
        ("name", "x" * 201, "name must be 1 to 200"),
        ("name", "evil\x1b[2J", "printable"),
        ("position_scale_m", 1e9, "position_scale_m"),
        ("position_scale_m", "1", "position_scale_m"),
        ("bounds_min_m", [0.4, 0.4, 0.4], "bounds_min_m is not below"),
        ("bounds_max_m", [0.7, 0.2, 0.2], "a number from -0.45 to 0.45"),  # another's seat
        ("view_span", [5, 40, -20, 20], "view from the front"),
        ("view_span", [-40, 40, -20], "must be 4 numbers"),
        ("view_span", [-40, 400, -20, 20], "a number from -180 to 180"),
        ("model_card", {str(i): "x" for i in range(65)}, "at most 64"),
        ("model_card", {"a": "x" * 2001}, "model_card.a"),
        ("spec", {"block": "H2"}, "spec field 'axis_encoding_size' is missing"),
        ("spec", 3, "spec"),
        ("spec", {**SPEC, "uv_encoding_size": 10**9}, r"manifest\.spec: uv_encoding_size is"),
        ("spec", {**SPEC, "axis_encoding_size": True}, r"manifest\.spec: spec\.axis_encoding_size"),
        ("surprise", 1, "'surprise' is missing or unknown"),
    ],
)
def test_a_manifest_out_of_its_limits_is_refused(
    toy_bytes: bytes, field: str, value: Any, message: str
) -> None:
    changed = with_manifest(toy_bytes, lambda manifest: manifest.update({field: value}))
    with pytest.raises(AvatarFileError, match=message):
        load_avatar(changed)


def test_triangles_that_cover_a_face_many_times_are_refused(tmp_path: Path) -> None:
    across = np.tile(np.array([26, 60, 29], np.int32), (5000, 1))  # from cheek to cheek and chin
    layered = Avatar(TOY.manifest, {**TOY.tensors, "mesh.faces": across})
    with pytest.raises(AvatarFileError, match=r"level 256 cover .* the limit is 4"):
        save_avatar(tmp_path / "layered.pica", layered)


def test_bases_of_more_components_than_fit_into_memory_are_refused_unread() -> None:
    assert linear_shapes({"linear.mix": (8192, 64)}, 60_000)
    with pytest.raises(ValueError, match="25600000 components; at most 4000000"):
        linear_shapes({"linear.mix": (8192, 128)}, 200_000)


@pytest.mark.parametrize(
    "spec", [{"\x1b[2J" * 20_000: 1}, {"block": "\x1b[2J" * 20_000}, {"block": ["\x1b"] * 90_000}]
)
def test_what_a_spec_holds_is_told_in_a_short_printable_line(
    toy_bytes: bytes, spec: dict[str, Any]
) -> None:
    changed = with_manifest(toy_bytes, lambda manifest: manifest["spec"].update(spec))
    with pytest.raises(AvatarFileError) as told:
        load_avatar(changed)
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 300


@pytest.mark.parametrize("dtype", ["F64", "I64", "BOOL", "BF16", None])
def test_a_tensor_stored_in_another_type_is_refused(toy_bytes: bytes, dtype: str | None) -> None:
    header, body = split(toy_bytes)
    header["geometry.mean"]["dtype"] = dtype
    with pytest.raises(AvatarFileError, match=r"geometry\.mean is stored as"):
        load_avatar(join(header, body))


def test_overlapping_tensors_are_refused(toy_bytes: bytes) -> None:
    header, body = split(toy_bytes)
    header["u_encoding"]["data_offsets"] = header["v_encoding"]["data_offsets"]
    with pytest.raises(AvatarFileError, match="safetensors"):
        load_avatar(join(header, body))


@pytest.mark.parametrize(
    "table", [{}, {"uv_encoding": 3}, {"uv_encoding": {"scale": [1], "offset": [0]}}, [], "no"]
)
def test_a_quantised_tensor_without_its_scales_is_refused(toy_bytes: bytes, table: Any) -> None:
    header, body = split(toy_bytes)
    header["__metadata__"]["storage"] = json.dumps(table)
    with pytest.raises(AvatarFileError, match=r"storage\."):
        load_avatar(join(header, body))


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("mesh.vertex_uv", np.full((64, 2), 1.5, np.float32), "spans 1.5 to 1.5"),
        ("mesh.faces", np.full((9, 3), 64, np.int32), "allowed are 0 to 63"),
        ("mesh.faces", np.full((9, 3), -1, np.int32), "allowed are 0 to 63"),
        ("mesh.faces", np.zeros((9, 4), np.int32), r"mesh.faces has shape \[9, 4\]"),
        ("u_encoding", np.zeros((20, 2), np.float64), "float64; float32 is needed"),
        ("unheard_of", np.zeros(3, np.float32), "'unheard_of' is unknown"),
        *(
            ("pixel.1.weight", np.full((8, 8), bad, np.float32), r"pixel\.1\.weight .* not finite")
            for bad in (np.nan, np.inf, -np.inf, 1e30)
        ),
        ("encoder.0.weight", np.zeros((33, 52), np.float32), r"\[160, 52\] is needed"),
    ],
)
def test_a_tensor_that_does_not_fit_is_refused_before_it_is_written(
    tmp_path: Path, name: str, array: np.ndarray[Any, Any], message: str
) -> None:
    with pytest.raises(AvatarFileError, match=message):
        save_avatar(tmp_path / "bad.pica", with_tensor(name, array))
    assert not (tmp_path / "bad.pica").exists()


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "a.pica"
    with pytest.raises(AvatarFileError, match=r"nowhere/a\.pica: cannot be written: No such file"):
        save_avatar(path, make_toy_avatar())
