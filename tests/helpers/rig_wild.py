"""One toy head in the forms in which glTF files are found: written here, read by the product."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import DracoPy
import meshopt
import numpy as np
from PIL import Image

from helpers.rig_toy import glb_bytes, glb_parts, toy_rig
from pica_core.types import Array

COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 16: "MAT4"}
BLOCKS = 8


def picture(margin: int = 4) -> Array:
    """Random blocks of 4 x 4 pixels; the outermost go on for so many blocks. ``[H, W, 3]``."""
    random = np.random.default_rng(5)
    blocks = random.integers(60, 220, (BLOCKS, BLOCKS, 3), np.uint8)
    blocks = np.pad(blocks, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    return blocks.repeat(4, 0).repeat(4, 1)


def png(pixels: Array) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def ktx2(pixels: Array) -> bytes:
    """A KTX 2 file of UASTC blocks, each of one colour (mode 8: 5 bits, then R, G, B, A)."""
    height, width = pixels.shape[:2]
    blocks = bytearray()
    for red, green, blue in pixels[::4, ::4].reshape(-1, 3).astype(int).tolist():
        bits = 0b10111 | red << 5 | green << 13 | blue << 21 | 255 << 29
        blocks += bits.to_bytes(16, "little")
    sample = struct.pack("<HBBIII", 0, 127, 0, 0, 0, 0xFFFFFFFF)
    block = struct.pack("<IHH", 0, 2, 24 + len(sample))
    block += bytes([166, 1, 2, 0, 3, 3, 0, 0, 16, 0, 0, 0, 0, 0, 0, 0]) + sample
    about = struct.pack("<I", 4 + len(block)) + block
    level_at = 12 + 36 + 32 + 24
    start = -(-(level_at + len(about)) // 16) * 16
    head = b"\xabKTX 20\xbb\r\n\x1a\n" + struct.pack("<9I", 0, 1, width, height, 0, 0, 1, 1, 0)
    head += struct.pack("<IIIIQQ", level_at, len(about), 0, 0, 0, 0)
    head += struct.pack("<QQQ", start, len(blocks), len(blocks)) + about
    return head + b"\0" * (start - len(head)) + bytes(blocks)


@dataclass
class WildRig:
    """A document whose accessors are arrays; `save` makes the rest."""

    document: dict[str, Any]
    arrays: list[Array]
    image: bytes
    normalized: set[int] = field(default_factory=set)
    sparse: set[int] = field(default_factory=set)
    packed: bool = False

    @property
    def primitives(self) -> list[dict[str, Any]]:
        return [p for mesh in self.document["meshes"] for p in mesh["primitives"]]

    def add(self, values: Array) -> int:
        self.arrays.append(values)
        return len(self.arrays) - 1

    def texture(self) -> dict[str, Any]:
        found: dict[str, Any] = self.document["textures"][0]
        return found

    def info(self) -> dict[str, Any]:
        pbr = self.document["materials"][0]["pbrMetallicRoughness"]
        found: dict[str, Any] = pbr["baseColorTexture"]
        return found

    def needs(self, *extensions: str) -> None:
        self.document["extensionsRequired"] = list(extensions)

    def move_uv(self, move: Callable[[Array], Array]) -> None:
        at = self.primitives[0]["attributes"]["TEXCOORD_0"]
        self.arrays[at] = move(self.arrays[at].astype(np.float64)).astype("<f4")

    def parts(self, *, image: bool = True) -> tuple[dict[str, Any], bytes]:
        """The document and its one buffer."""
        document, binary = dict(self.document), b""
        views: list[dict[str, Any]] = []

        def view(data: bytes, **more: Any) -> int:
            nonlocal binary
            binary += b"\0" * (-len(binary) % 4)
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), **more})
            binary += data
            return len(views) - 1

        def stored(values: Array) -> int:
            if not self.packed:
                return view(values.tobytes())
            mode = "TRIANGLES" if values.shape[1] == 1 else "ATTRIBUTES"
            if mode == "ATTRIBUTES":  # rows are whole words
                values = np.pad(values, ((0, 0), (0, -values.shape[1] % 2)))
            stride = values.strides[0]
            index = view(meshopt.encode_gltf_buffer(values, mode))
            about = {**views[index], "byteStride": stride, "count": len(values), "mode": mode}
            views[index] = {
                "buffer": 1, "byteLength": values.nbytes,
                "extensions": {"EXT_meshopt_compression": about},
            } | ({"byteStride": stride} if mode == "ATTRIBUTES" else {})  # fmt: skip
            return index

        accessors = []
        for number, values in enumerate(self.arrays):
            entry = {
                "componentType": COMPONENT[values.dtype.str[1:]], "count": len(values),
                "type": KIND[values.shape[1]], "normalized": number in self.normalized,
            }  # fmt: skip
            if number in self.sparse:
                moved = np.flatnonzero(np.abs(values).max(1) > 0)
                entry["sparse"] = {
                    "count": len(moved),
                    "indices": {"bufferView": view(moved.astype("<u2").tobytes()),
                                "componentType": 5123},
                    "values": {"bufferView": view(values[moved].tobytes())},
                }  # fmt: skip
            else:
                entry["bufferView"] = stored(values)
            accessors.append(entry)
        for primitive in self.primitives:
            draco = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
            if draco and "data" in draco:
                draco["bufferView"] = view(draco.pop("data"))
        if image:
            document["images"] = [{"bufferView": view(self.image)}]
        document |= {"accessors": accessors, "bufferViews": views}
        document["buffers"] = [{"byteLength": len(binary)}] + [
            {"byteLength": 1 << 20}
        ] * self.packed
        return document, binary

    def save(self, path: Path) -> Path:
        path.write_bytes(glb_bytes(*self.parts()))
        return path


def wild_rig() -> WildRig:
    """The toy head with a picture on its skin."""
    document, binary = glb_parts(toy_rig(), image=png(picture()))
    arrays = []
    for entry in document.pop("accessors"):
        kind = next(k for k, v in COMPONENT.items() if v == entry["componentType"])
        width = next(k for k, v in KIND.items() if v == entry["type"])
        start = document["bufferViews"][entry["bufferView"]]["byteOffset"]
        flat = np.frombuffer(binary, f"<{kind}", entry["count"] * width, start)
        arrays.append(flat.reshape(-1, width).copy())
    return WildRig(document, arrays, png(picture()))


def repeated(rig: WildRig) -> None:
    rig.move_uv(lambda uv: uv - np.array([1, -3]))


def mirrored(rig: WildRig) -> None:
    rig.document["samplers"] = [{"wrapS": 33648, "wrapT": 33648}]
    rig.texture()["sampler"] = 0
    rig.move_uv(lambda uv: uv * [-1, 1] + [0, 2])


def clamped(rig: WildRig) -> None:
    rig.document["samplers"] = [{"wrapS": 33071, "wrapT": 33071}]
    rig.texture()["sampler"] = 0
    rig.image = png(picture(0))
    rig.move_uv(lambda uv: 2 * uv - 0.5)


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


def skinned(rig: WildRig) -> None:
    """Quantised under a skin: only the inverse bind matrix knows the size."""
    quantized(rig)
    node = rig.document["nodes"][0]
    scale = node.pop("scale")
    inverse = np.diag([*scale, 1.0])
    node["skin"] = 0
    rig.document["nodes"].append({"rotation": node["rotation"]})
    rig.document["scenes"] = [{"nodes": [0, 1]}]
    matrices = rig.add(inverse.T.reshape(1, 16).astype("<f4"))
    rig.document["skins"] = [{"joints": [1], "inverseBindMatrices": matrices}]


def draco(rig: WildRig) -> None:
    rig.needs("KHR_draco_mesh_compression")
    for primitive in rig.primitives:
        at = primitive["attributes"]
        data = DracoPy.encode(
            rig.arrays[at["POSITION"]],
            rig.arrays[primitive["indices"]].reshape(-1, 3).astype("u4"),
            quantization_bits=14, preserve_order=True,
            tex_coord=rig.arrays[at["TEXCOORD_0"]].astype("f8"),
        )  # fmt: skip
        ids = {a["attribute_type"]: a["unique_id"] for a in DracoPy.decode(data).attributes}
        content = {"data": data, "attributes": {"POSITION": ids[0], "TEXCOORD_0": ids[3]}}
        primitive["extensions"] = {"KHR_draco_mesh_compression": content}


def meshopt_packed(rig: WildRig) -> None:
    rig.needs("EXT_meshopt_compression")
    rig.packed = True


def basis(rig: WildRig) -> None:
    rig.needs("KHR_texture_basisu")
    rig.image = ktx2(picture())
    rig.document["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]


def many_meshes(rig: WildRig) -> None:
    mesh = rig.document["meshes"][0]
    rig.document["meshes"] = [{**mesh, "primitives": [p]} for p in mesh["primitives"]]
    node = rig.document["nodes"][0]
    count = len(rig.document["meshes"])
    rig.document["nodes"] = [{**node, "mesh": k} for k in range(count)]
    rig.document["scenes"] = [{"nodes": list(range(count))}]


def sparse(rig: WildRig) -> None:
    rig.sparse = {t["POSITION"] for t in rig.primitives[0]["targets"]}


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


FORMS: dict[str, Callable[[WildRig], None]] = {
    form.__name__: form
    for form in (
        repeated, mirrored, clamped, transformed, second_uv, quantized, skinned, draco,
        meshopt_packed, basis, many_meshes, sparse, glasses,
    )
}  # fmt: skip


def write_beside(folder: Path) -> Path:
    """The head as .gltf, with its buffer and picture beside it under names that need care."""
    rig = wild_rig()
    document, binary = rig.parts(image=False)
    (folder / "my head").mkdir()
    (folder / "my head" / "büffer.bin").write_bytes(binary)
    (folder / "skin #1.png").write_bytes(rig.image)
    document["buffers"][0]["uri"] = "my%20head/b%C3%BCffer.bin"
    document["images"] = [{"uri": "skin%20%231.png"}]
    path = folder / "toy.gltf"
    path.write_text(json.dumps(document))
    return path
