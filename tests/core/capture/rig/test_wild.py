"""One head in the forms in which rigs are found: all must give the same picture."""

import io
import json
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from helpers.rig_toy import document_of, glb_bytes, packed, toy_rig
from pica_core.camera import dome_cameras
from pica_core.capture.rig.gltf import read_rig
from pica_core.capture.rig.source import GltfFile
from pica_core.capture.stage.expressions import blend
from pica_core.capture.stage.subject import RigSubject
from pica_core.errors import CaptureError
from pica_core.types import Array, ByteArray

pytestmark = pytest.mark.render

BLOCKS = 8


def picture() -> Array:
    """Random blocks of 4 x 4 pixels; the outermost go on for four blocks. ``[H, W, 3]``."""
    random = np.random.default_rng(5)
    blocks = random.integers(60, 220, (BLOCKS, BLOCKS, 3), np.uint8)
    blocks = np.pad(blocks, ((4, 4), (4, 4), (0, 0)), mode="edge")
    return blocks.repeat(4, 0).repeat(4, 1)


def png(pixels: Array) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


@dataclass
class WildRig:
    """A document whose accessors are arrays; `save` makes the rest."""

    document: dict[str, Any]
    arrays: list[Array]
    image: bytes
    normalized: set[int] = field(default_factory=set)
    sparse: set[int] = field(default_factory=set)

    @property
    def primitives(self) -> list[dict[str, Any]]:
        return [p for mesh in self.document["meshes"] for p in mesh["primitives"]]

    def add(self, values: Array) -> int:
        self.arrays.append(values)
        return len(self.arrays) - 1

    def info(self) -> dict[str, Any]:
        pbr = self.document["materials"][0]["pbrMetallicRoughness"]
        found: dict[str, Any] = pbr["baseColorTexture"]
        return found

    def needs(self, *extensions: str) -> None:
        self.document["extensionsRequired"] = list(extensions)

    def move_uv(self, move: Callable[[Array], Array]) -> None:
        at = self.primitives[0]["attributes"]["TEXCOORD_0"]
        self.arrays[at] = move(self.arrays[at].astype(np.float64)).astype("<f4")

    def save(self, path: Path) -> Path:
        packing = {"normalized": self.normalized, "sparse": self.sparse}
        path.write_bytes(glb_bytes(*packed(self.document, self.arrays, self.image, **packing)))
        return path


def wild_rig() -> WildRig:
    """The toy head with a picture on its skin."""
    image = png(picture())
    return WildRig(*document_of(toy_rig(), image), image)


def repeated(rig: WildRig) -> None:
    rig.move_uv(lambda uv: uv - np.array([1, -3]))


def transformed(rig: WildRig) -> None:
    rig.needs("KHR_texture_transform")
    move = {"offset": [0.25, 0.5], "rotation": 0.5, "scale": [2.0, 0.5]}
    rig.info()["extensions"] = {"KHR_texture_transform": move}
    c, s = np.cos(0.5), np.sin(0.5)
    rig.move_uv(lambda uv: (uv - [0.25, 0.5]) @ np.array([[c, s], [-s, c]]) / [2.0, 0.5])


def second_uv(rig: WildRig) -> None:
    own = rig.primitives[0]["attributes"]["TEXCOORD_0"]
    other = rig.add(rig.arrays[own][::-1].copy())
    for primitive in rig.primitives:
        primitive["attributes"] |= {"TEXCOORD_0": other, "TEXCOORD_1": own}
    rig.info()["texCoord"] = 1


def quantized(rig: WildRig) -> None:
    rig.needs("KHR_mesh_quantization")
    step = 0.15 / 32767
    for index, values in enumerate(rig.arrays):
        if values.shape[1] == 3:
            rig.arrays[index] = np.rint(values / step).astype("<i2")
    at = rig.primitives[0]["attributes"]["TEXCOORD_0"]
    rig.arrays[at] = np.rint(np.mod(rig.arrays[at], 1.0) * 65535).astype("<u2")
    rig.normalized.add(at)
    rig.document["nodes"][0]["scale"] = [step] * 3


def jointed(rig: WildRig) -> None:
    """Each vertex hangs on two joints; where these stand is what their inverse matrices undo."""
    node = rig.document["nodes"][0]
    upright = {key: node.pop(key) for key in ("rotation", "scale") if key in node}
    count = len(rig.arrays[rig.primitives[0]["attributes"]["POSITION"]])
    joints = np.tile(np.array([[0, 1, 0, 0]], "u1"), (count, 1))
    share = np.linspace(0.1, 0.9, count)[:, None]
    zero = np.zeros((count, 2))
    weights = np.concatenate([share, 1 - share, zero], 1).astype("<f4")
    more = {"JOINTS_0": rig.add(joints), "WEIGHTS_0": rig.add(weights)}
    for primitive in rig.primitives:
        primitive["attributes"] |= more
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[1, :3, 3] = -3.0, 2.0, 1.0
    rig.document["nodes"] += [
        {**upright, "children": [2]}, {"translation": [3.0, -2.0, -1.0]},
    ]  # fmt: skip
    node["skin"] = 0
    rig.document["scenes"] = [{"nodes": [0, 1]}]
    matrices = rig.add(inverse.swapaxes(1, 2).reshape(2, 16).astype("<f4"))
    rig.document["skins"] = [{"joints": [1, 2], "inverseBindMatrices": matrices}]


def tinted(rig: WildRig) -> None:
    """A brighter picture, which a factor and colours of vertices darken."""
    bright = np.rint(picture() * (0.9 * 0.8) ** (-1 / 2.2))
    rig.image = png(bright.astype(np.uint8))
    skin = rig.primitives[0]
    material = rig.document["materials"][skin["material"]]
    material["pbrMetallicRoughness"]["baseColorFactor"] = [0.9, 0.9, 0.9, 1.0]
    count = len(rig.arrays[skin["attributes"]["POSITION"]])
    skin["attributes"] = skin["attributes"] | {"COLOR_0": rig.add(np.full((count, 4), 0.8, "<f4"))}


def named_by_targets(rig: WildRig) -> None:
    names = rig.document["meshes"][0].pop("extras")["targetNames"]
    for primitive in rig.primitives:
        for name, target in zip(names, primitive.get("targets", []), strict=True):
            target["extras"] = {"name": name}


def open_at_rest(rig: WildRig) -> None:
    """A shape that is set in the file, and undone in its vertices."""
    at = rig.primitives[0]["attributes"]["POSITION"]
    shape = np.zeros_like(rig.arrays[at])
    shape[:, 2] = np.linspace(0, 0.02, len(shape))
    rig.arrays[at] = rig.arrays[at] - shape
    index = rig.add(shape)
    for primitive in rig.primitives:
        primitive["targets"] = [*primitive["targets"], {"POSITION": index}]
    mesh = rig.document["meshes"][0]
    for primitive in rig.primitives:  # another one of the same name comes before it
        primitive["targets"] = [{"POSITION": rig.add(0 * shape)}, *primitive["targets"]]
    mesh["extras"]["targetNames"] = ["odd", *mesh["extras"]["targetNames"], "odd"]
    mesh["weights"] = [0.0] * (len(rig.primitives[0]["targets"]) - 1) + [1.0]


def open_by_its_node(rig: WildRig) -> None:
    open_at_rest(rig)
    rig.document["nodes"][0]["weights"] = rig.document["meshes"][0].pop("weights")


def sparse(rig: WildRig) -> None:
    rig.sparse = {t["POSITION"] for t in rig.primitives[0]["targets"]}


def without_indices(rig: WildRig) -> None:
    for primitive in rig.primitives:
        at = rig.arrays[primitive.pop("indices")][:, 0]
        primitive["targets"] = [dict(target) for target in primitive["targets"]]
        for attributes in (primitive["attributes"], *primitive["targets"]):
            attributes |= {k: rig.add(rig.arrays[v][at]) for k, v in attributes.items()}


def glasses(rig: WildRig) -> None:
    """A lens before the face, and a tear film over an eye: both are seen through."""
    at = rig.primitives[0]["attributes"]
    corners = np.array([[-0.06, -0.13, 0], [0.06, -0.13, 0], [0.06, -0.13, 0.06]])
    start = len(rig.arrays[at["POSITION"]])
    names = [at["POSITION"], *(t["POSITION"] for t in rig.primitives[0]["targets"])]
    for index in names:
        new = corners if index == at["POSITION"] else 0 * corners
        rig.arrays[index] = np.concatenate([rig.arrays[index], new.astype("<f4")])
    uv = rig.arrays[at["TEXCOORD_0"]]
    rig.arrays[at["TEXCOORD_0"]] = np.concatenate([uv, uv[:3]])
    index = rig.add(np.arange(start, start + 3, dtype="<u2").reshape(-1, 1))
    pbr = {"baseColorFactor": [1, 1, 1, 0.2]}
    glass = {"name": "Glass", "alphaMode": "BLEND", "pbrMetallicRoughness": pbr}
    rig.document["materials"].append(glass)
    lens = {**rig.primitives[0], "indices": index, "material": len(rig.document["materials"]) - 1}
    rig.document["meshes"][0]["primitives"].append(lens)


def lines_in_the_picture(rig: WildRig) -> None:
    """The last ring of each eyeball has the coordinates of the one before: lines hang there."""
    uv = rig.arrays[rig.primitives[0]["attributes"]["TEXCOORD_0"]]
    for eye in rig.primitives[1:3]:
        rings = np.unique(rig.arrays[eye["indices"]]).reshape(10, -1)
        uv[rings[[0, -1]]] = uv[rings[[1, -2]]]


def glossy(rig: WildRig) -> None:
    """The picture where converters of older materials leave it."""
    material = rig.document["materials"][0]
    picture_of = material.pop("pbrMetallicRoughness")["baseColorTexture"]
    gloss = {"diffuseTexture": picture_of, "diffuseFactor": [1, 1, 1, 1]}
    material["extensions"] = {"KHR_materials_pbrSpecularGlossiness": gloss}


def mesh_each(rig: WildRig, name: str) -> None:
    """One mesh for each material, with vertices of its own and shapes called by a format."""
    (mesh,) = rig.document["meshes"]
    shapes, meshes = mesh["extras"]["targetNames"], []
    for primitive in mesh["primitives"]:
        part = rig.document["materials"][primitive["material"]]["name"]
        used, index = np.unique(rig.arrays[primitive["indices"]], return_inverse=True)

        def cut(attributes: dict[str, int], used: Array = used) -> dict[str, int]:
            return {key: rig.add(rig.arrays[at][used]) for key, at in attributes.items()}

        own = {
            "attributes": cut(primitive["attributes"]),
            "targets": [cut(target) for target in primitive["targets"]],
            "indices": rig.add(index.astype("<u2").reshape(-1, 1)),
        }
        names = [name.format(part=part, shape=shape) for shape in shapes]
        if part.startswith("eye"):
            own["targets"], names = [], []
        meshes.append({"primitives": [primitive | own], "extras": {"targetNames": names}})
    (node,) = (node for node in rig.document["nodes"] if "mesh" in node)
    places = [{**node, "mesh": number} for number in range(len(meshes))]
    first = len(rig.document["nodes"])
    roots = rig.document["scenes"][0]["nodes"]
    del node["mesh"]
    rig.document |= {"meshes": meshes, "nodes": rig.document["nodes"] + places}
    rig.document["scenes"] = [{"nodes": [*roots, *range(first, first + len(places))]}]


def rename(rig: WildRig, *changes: tuple[str, str]) -> None:
    names = rig.document["meshes"][0]["extras"]["targetNames"]
    for old, new in changes:
        names[:] = [re.sub(old, new, name) for name in names]


def like_ready_player_me(rig: WildRig) -> None:
    """Skinned, one mesh for each material, ARKit's names."""
    jointed(rig)
    rename(rig, ("_L$", "Left"), ("_R$", "Right"))
    mesh_each(rig, "{shape}")


def like_vroid(rig: WildRig) -> None:
    """Looks along -z; its own names beside empty shapes of ARKit's names, and cards."""
    rename(rig, ("jawOpen", "Face.M_F00_Fcl_MTH_A"), ("eyeBlink", "Face.M_F00_Fcl_EYE_Close"))
    glasses(rig)
    empty = rig.add(np.zeros_like(rig.arrays[rig.primitives[0]["attributes"]["POSITION"]]))
    for primitive in rig.primitives:
        primitive["targets"] = [*primitive["targets"], *[{"POSITION": empty}] * 2]
    rig.document["meshes"][0]["extras"]["targetNames"] += ["jawOpen", "eyeBlinkLeft"]
    rig.document["nodes"].append({"rotation": [0, 1, 0, 0], "children": [0]})
    rig.document["scenes"] = [{"nodes": [1]}]


def named_by_maya(rig: WildRig) -> None:
    """Centimetres, and shapes named after the node of each mesh."""
    rig.document["nodes"][0]["scale"] = [100.0] * 3
    mesh_each(rig, "rig:{part}_blendShape.{part}_{shape}")


def named_by_blender(rig: WildRig) -> None:
    """Sides and numbers behind points; millimetres, and another scene beside it."""
    rig.document["nodes"][0]["scale"] = [1000.0] * 3
    rename(rig, ("_([LR])$", r".\1"), ("$", ".001"))
    rig.document |= {"scene": 1, "scenes": [{"nodes": []}, *rig.document["scenes"]]}


def exported_by_unity(rig: WildRig) -> None:
    """Mirrored in x, which a negative scale undoes."""
    for index, values in enumerate(rig.arrays):
        if values.shape[1] == 3:
            rig.arrays[index] = values * np.array([-1, 1, 1], "<f4")
    for primitive in rig.primitives:
        primitive["indices"] = rig.add(rig.arrays[primitive["indices"]][::-1].copy())
    rig.document["nodes"][0]["scale"] = [-1.0, 1.0, 1.0]
    mesh_each(rig, "blendShape1.{shape}")


FORMS: dict[str, Callable[[WildRig], None]] = {
    form.__name__: form
    for form in (
        repeated, transformed, second_uv, quantized, tinted, named_by_targets,
        open_by_its_node, sparse, lines_in_the_picture, glossy, without_indices,
        like_ready_player_me, like_vroid, named_by_maya, named_by_blender, exported_by_unity,
    )
}  # fmt: skip


def write_beside(folder: Path) -> Path:
    """The head as .gltf, with its buffer and picture beside it under names that need care."""
    rig = wild_rig()
    document, binary = packed(rig.document, rig.arrays)
    (folder / "my head").mkdir()
    (folder / "my head" / "büffer.bin").write_bytes(binary)
    (folder / "skin #1.png").write_bytes(rig.image)
    document["buffers"][0]["uri"] = "my%20head/b%C3%BCffer.bin"
    document["images"] = [{"uri": "skin%20%231.png"}]
    path = folder / "toy.gltf"
    path.write_text(json.dumps(document))
    return path


def render(path: Path) -> tuple[ByteArray, dict[str, Any]]:
    subject = RigSubject(path, bake_size=256, self_shadow=False)
    subject.pose(blend(jawOpen=0.6, eyeBlinkLeft=1.0))
    view = subject.draw(dome_cameras(1, 96, 96)[0])
    subject.release()
    return view.image, subject.about


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> ByteArray:
    return render(wild_rig().save(tmp_path_factory.mktemp("rig") / "plain.glb"))[0]


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

    error = np.abs(render(path)[0].astype(int) - plain).max(-1)

    # Quantisation and another order of packing move edges between blocks by a part of a pixel.
    assert error.mean() < 1.0
    assert (error > 24).mean() < 0.01


@pytest.mark.parametrize("has_other", [True, False])
def test_a_picture_that_avif_alone_holds_is_refused_by_that_name(
    tmp_path: Path, has_other: bool
) -> None:
    rig = wild_rig()
    (texture,) = rig.document["textures"]
    texture["extensions"] = {"EXT_texture_avif": {"source": 9}}
    if not has_other:
        del texture["source"]
    path = rig.save(tmp_path / "avif.glb")
    with nullcontext() if has_other else pytest.raises(CaptureError, match="EXT_texture_avif"):
        read_rig(path)


def test_a_mirrored_half_keeps_its_picture_when_its_islands_are_made_anew(
    plain: ByteArray, tmp_path: Path
) -> None:
    rig = wild_rig()
    at = rig.primitives[0]["attributes"]["TEXCOORD_0"]
    before = rig.arrays[at].copy()
    # Both halves on one place of the image, as many game heads have it.
    rig.move_uv(lambda uv: np.stack([np.abs(uv[:, 0] - 0.5) + 0.5, uv[:, 1]], 1))

    image, about = render(rig.save(tmp_path / "half.glb"))

    assert about["rig"]["triangles_with_new_coordinates"] > 1000
    assert not np.array_equal(before, rig.arrays[at])
    error = np.abs(image.astype(int) - plain)[:, 50:].max(-1)
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


def test_pictures_share_a_number_of_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = wild_rig()
    rig.document["materials"][1] |= {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    path = rig.save(tmp_path / "toy.glb")
    side = len(picture())
    assert read_rig(path).images[0].shape == (side, side, 4)

    monkeypatch.setattr("pica_core.capture.rig.source.MAX_IMAGE_PIXELS", side * side)
    images = (smaller := read_rig(path)).images
    assert smaller.smaller_images == (f"{side}x{side} pixels as {side // 2}x{side // 2}",)
    assert images[0] is images[1]
    assert images[0].shape == (side // 2, side // 2, 4)
    expected = picture().reshape(side // 2, 2, side // 2, 2, 3).mean((1, 3))
    assert np.abs(images[0][..., :3] - expected).max() <= 1


def test_a_file_that_is_named_many_times_counts_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = GltfFile(write_beside(tmp_path))
    size = len(file.resource("skin%20%231.png"))
    monkeypatch.setattr("pica_core.capture.rig.source.MAX_FILE_BYTES", 3 * size)
    for _ in range(2):
        file.resource("skin%20%231.png")
    with pytest.raises(CaptureError, match="files beside it have more than"):
        file.resource("skin%20%231.png")


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
