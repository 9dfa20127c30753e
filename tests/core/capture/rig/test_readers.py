"""Rigs as files: what is read, what it is called, and what is refused in which words."""

import base64
import copy
import json
from pathlib import Path

import numpy as np
import pytest

from helpers.rig_toy import glb_bytes, glb_parts, toy_rig, write_glb
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.head import make_rig
from pica_core.capture.rig.mesh import build_mesh
from pica_core.capture.rig.names import map_names, match_name, read_names
from pica_core.errors import CaptureError

pytestmark = pytest.mark.unit

RIG = toy_rig()


@pytest.fixture(scope="module")
def glb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_glb(tmp_path_factory.mktemp("glb") / "toy.glb", RIG)


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("eyeBlink_L", "eyeBlinkLeft"),
        ("Eye_Blink_Left", "eyeBlinkLeft"),
        ("head.eyeBlinkLeft", "eyeBlinkLeft"),
        ("EYEBLINKRIGHT", "eyeBlinkRight"),
        ("A14_Eye_Blink_Left", "eyeBlinkLeft"),
        ("L_mouthSmile", "mouthSmileLeft"),
        ("mouth-roll-lower", "mouthRollLower"),
        ("jaw_left", "jawLeft"),
        ("mouthLeft", "mouthLeft"),
        ("cheekPuff_R", "cheekPuff"),
        ("tongueOut", "tongueOut"),
        ("eyeBlink.L.001", "eyeBlinkLeft"),
        ("jaw_open_02", "jawOpen"),
        ("ARKit_eyeBlink_l", "eyeBlinkLeft"),
        ("rig:head_blendShape1.BS head-jawOpen", "jawOpen"),
        ("jawOpen_mouthClose", ""),
        ("viseme_aa", ""),
    ],
)
def test_names_are_understood_in_the_ways_that_people_write_them(name: str, meaning: str) -> None:
    assert match_name(name) == (((meaning, ""),) if meaning else ())


def test_halves_join_one_shape_serves_both_sides_and_doubles_are_ignored() -> None:
    names = map_names(
        ["browInnerUp_L", "browInnerUp_R", "mouthSmile", "eyeBlinkLeft", "eyeBlink_L", "odd"]
    )

    assert [d.source for d in names.drivers["browInnerUp"]] == ["browInnerUp_L", "browInnerUp_R"]
    assert names.drivers["mouthSmileLeft"][0].half == "Left"
    assert names.drivers["mouthSmileRight"][0].half == "Right"
    assert [d.source for d in names.drivers["eyeBlinkLeft"]] == ["eyeBlinkLeft"]
    assert names.ignored == ("eyeBlink_L", "odd")
    assert len(names.missing) == 52 - 4


def test_what_moves_decides_which_of_several_names_drives() -> None:
    nothing, face, teeth = np.zeros(9, np.bool_), np.arange(9) < 6, np.arange(9) >= 6
    moved = {
        "teeth_shapes.jawOpen": teeth,
        "head_shapes.jawOpen": face,
        "Fcl_MTH_A": face,
        "eyeBlink.L": nothing,
        "Fcl_EYE_Close_L": face,
        "mouthFunnel.001": face,
        "mouth_funnel": face,
        "upper_mouthLeft": face,
        "mouthLeft": face,
    }
    names = map_names(list(moved), moved=moved)
    driven = {arkit: [each.source for each in drivers] for arkit, drivers in names.drivers.items()}
    assert driven == {
        "jawOpen": ["teeth_shapes.jawOpen", "head_shapes.jawOpen"],
        "eyeBlinkLeft": ["Fcl_EYE_Close_L"],
        "mouthFunnel": ["mouthFunnel.001"],
        "mouthLeft": ["mouthLeft"],
    }
    assert names.ignored == ("Fcl_MTH_A", "eyeBlink.L", "mouth_funnel", "upper_mouthLeft")


def test_a_table_goes_before_the_rules(tmp_path: Path) -> None:
    path = tmp_path / "names.json"
    table = json.dumps({"viseme_aa": "jawOpen", "jawOpen": None})
    path.write_text(table, encoding="utf-8-sig")  # as Notepad saves it

    names = map_names(["jawOpen", "viseme_aa"], read_names(path))

    assert names.mapped == ("viseme_aa",)
    assert names.ignored == ("jawOpen",)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('{"jawOpen": "jawAjar"}', "jawAjar"),
        ("[1]", "a JSON map"),
        ("{", "not JSON"),
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, table: str, words: str) -> None:
    path = tmp_path / "names.json"
    path.write_text(table)
    with pytest.raises(CaptureError, match=words):
        read_names(path)


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m"), (100.0, "cm"), (1000.0, "mm")])
@pytest.mark.parametrize("side", [1, -1])
def test_unit_and_heading_are_found(tmp_path: Path, scale: float, unit: str, side: int) -> None:
    rig = toy_rig()  # at a desk
    rig.quads["desk"] = len(rig.uv) + np.arange(4)[None]
    desk = [[-0.5, -0.2, 0.9], [0.5, -0.2, 0.9], [0.5, -0.2, 0.3], [-0.5, -0.2, 0.3]]
    rig.positions = np.concatenate([rig.positions, desk])
    rig.uv = np.concatenate([rig.uv, 3 + rig.uv[:4]])
    rig.shapes = {k: np.concatenate([delta, np.zeros((4, 3))]) for k, delta in rig.shapes.items()}
    turn = scale * np.array([side, 1, side])
    rig.positions = rig.positions * turn
    rig.shapes = {name: delta * turn for name, delta in rig.shapes.items()}

    source = read_rig(write_glb(tmp_path / "toy.glb", rig))
    mesh = build_mesh(source, map_names(list(source.shapes)))

    assert (mesh.frame.unit, mesh.frame.turned) == (unit, side < 0)
    assert mesh.motion_m[ARKIT_INDEX["jawOpen"], :, 1].min() == pytest.approx(-0.02, abs=1e-5)
    assert [round(eye.radius_m, 4) for eye in mesh.eyes] == [0.012, 0.012]
    assert [eye.side for eye in mesh.eyes] == [1.0, -1.0]
    assert not any(eye.turned for eye in mesh.eyes)
    np.testing.assert_allclose(
        np.mean([eye.centre_m for eye in mesh.eyes], axis=0), [0, 0.022, 0.074], atol=1e-6
    )


@pytest.mark.parametrize("form", ["padded.glb", "trailing.GLB", "bom.gltf", "capitals.GLTF"])
def test_a_file_is_read_as_old_and_careless_programs_write_it(tmp_path: Path, form: str) -> None:
    document, binary = glb_parts(RIG)
    data = glb_bytes(document, binary)
    if form == "padded.glb":  # with 0, not with spaces
        size = int.from_bytes(data[12:16], "little")
        text = data[20 : 20 + size].rstrip(b" ")
        text += bytes(4 - len(text) % 4)
        rest = len(text).to_bytes(4, "little") + b"JSON" + text + data[20 + size :]
        data = data[:8] + (12 + len(rest)).to_bytes(4, "little") + rest
    elif form == "trailing.GLB":
        data += bytes(4)
    else:
        uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
        document["buffers"][0]["uri"] = uri
        data = json.dumps(document).encode("utf-8-sig" if form == "bom.gltf" else "utf-8")
    (tmp_path / form).write_bytes(data)

    assert set(read_rig(tmp_path / form).shapes) == set(RIG.shapes)


def test_a_truncated_glb_is_refused_wherever_it_ends(glb: Path, tmp_path: Path) -> None:
    data = glb.read_bytes()
    path = tmp_path / "short.glb"
    for keep in (0, 11, 19, 21, 400, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:keep])
        with pytest.raises(CaptureError, match=r"short\.glb"):
            read_rig(path)
    path.write_bytes(b"glTF" + data[4:8] + b"\xff\xff\xff\x7f" + data[12:])
    with pytest.raises(CaptureError, match="its header says 2147483647"):
        read_rig(path)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("meshes", 0, "extras"), {}, "no such list of names"),
        (("accessors", 0, "count"), 10**9, "1 to"),
        (("accessors", 0, "count"), -1, "'count' is -1"),
        (("accessors", 0, "type"), "VEC9", "VEC9"),
        (("accessors", 0, "byteOffset"), 10**12, "malformed.*ValueError"),
        (("bufferViews", 0, "byteLength"), 10**12, "ends at byte"),
        (("bufferViews", 0, "byteStride"), 10**6, "malformed.*ValueError"),
        (("buffers", 0, "uri"), "other.bin", "other.bin: the file is missing"),
        (("meshes", 0, "primitives", 0, "indices"), 99, "accessors 99 does not exist"),
        (("meshes", 0, "primitives", 0, "attributes"), {}, "POSITION"),
        (("meshes", 0, "primitives", 0, "material"), 77, "materials 77"),
        (("nodes", 0, "rotation"), [0, 0], "malformed.*ValueError"),
        (("nodes", 0, "children"), [0], "several parents"),
        (("extensionsRequired",), ["KHR_draco_mesh_compression"], "'KHR_draco_mesh_compression'"),
        (("extensionsRequired",), ["EXT_meshopt_compression"], "'EXT_meshopt_compression'"),
        (("extensionsRequired",), ["ADOBE_materials_thin"], "export without it"),
        (("accessors",), "none", "malformed.*TypeError"),
        (("extras",), [0] * 1_000_001, "values; at most 1,000,000"),
    ],
)
def test_a_hostile_glb_is_refused(
    tmp_path: Path, place: tuple[str | int, ...], value: object, words: str
) -> None:
    document, binary = glb_parts(RIG)
    document = copy.deepcopy(document)
    at: object = document
    for key in place[:-1]:
        at = at[key]  # type: ignore[index]
    at[place[-1]] = value  # type: ignore[index]
    path = tmp_path / "hostile.glb"
    path.write_bytes(glb_bytes(document, binary))

    with pytest.raises(CaptureError, match=words):
        read_rig(path)


def test_a_small_glb_that_unfolds_without_end_is_refused(tmp_path: Path) -> None:
    document, binary = glb_parts(RIG)
    (primitive,) = document["meshes"][0]["primitives"][:1]
    empty = {"componentType": 5125, "count": 3_000_000, "type": "SCALAR"}
    extras, skinned = document["meshes"][0]["extras"], {"mesh": 0, "skin": 0}
    for changes, words in (
        ({"nodes": [{}] * 10_001}, "more than 10,000 nodes"),
        ({"nodes": [skinned], "skins": [{"joints": [0] * 2_001}]}, "2,001 joints; up to 2,000"),
        ({"meshes": [{"primitives": [primitive | {"mode": 0}] * 2_001}]}, "2,000 primitives"),
        (
            {
                "accessors": [*document["accessors"], empty],
                "meshes": [{"primitives": [primitive | {"indices": -1}] * 2, "extras": extras}],
            },
            "2000000 faces; at most 1000000",
        ),
    ):
        changed = {**copy.deepcopy(document), **copy.deepcopy(changes)}
        nodes = range(len(changed["nodes"]))
        changed["scenes"] = [{"nodes": list(nodes)}]
        for mesh in changed["meshes"]:
            for part in mesh["primitives"]:
                part["indices"] %= len(changed["accessors"])
        path = tmp_path / "small.glb"
        path.write_bytes(glb_bytes(changed, binary))
        with pytest.raises(CaptureError, match=words):
            read_rig(path)


@pytest.mark.parametrize("name", ["neutral.obj", "head.fbx", "head.glb"])
def test_a_file_of_another_format_is_refused_by_the_formats_that_are_read(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    path.write_text("mtllib head.mtl\no head\nv 0 0 0\n")
    with pytest.raises(CaptureError, match=r"not a glTF 2.0 file \(.glb, .vrm or .gltf\)"):
        read_rig(path)


@pytest.mark.parametrize(
    ("what", "value", "words"),
    [
        ("shape", np.nan, "vertex 3 of shape 'jawOpen' is not finite"),
        ("shape", 3e38, "shape 'jawOpen' moves a vertex by 3e"),
        ("shape", 1e12, "shape 'jawOpen' moves a vertex by"),
        ("position", 1e12, "m large; up to 4 m are read"),
        ("index", 60_000, "indices up to 60000"),
        ("shapes", None, "no blendshapes"),
        ("material", None, "no shape with a known name moves what is drawn"),
    ],
)
def test_an_impossible_rig_is_refused(tmp_path: Path, what: str, value: float, words: str) -> None:
    rig = toy_rig()
    match what:
        case "shape":
            rig.shapes["jawOpen"][3, 1] = value
        case "position":
            rig.positions[0, 1] = value
        case "index":
            rig.quads["skin"][0, 0] = value
        case "shapes":
            rig.shapes.clear()
        case "material":
            rig.quads["EyeOcclusion"] = rig.quads.pop("skin")
    with pytest.raises(CaptureError, match=words):
        make_rig(read_rig(write_glb(tmp_path / "bad.glb", rig)))
