"""What the appearance shader needs to know of each vertex of a rig, and the images it brings.

Where a material has no image, `shaders/appearance.frag` paints it: skin with pores, brows,
lips, lids and cropped hair, eyes, teeth, gums and tongue, from what `features` found.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pica_core.capture.dataset.files import read_bytes
from pica_core.capture.dataset.multiface import MATERIALS
from pica_core.capture.rig.drawn import DrawnRig
from pica_core.capture.rig.images import open_image
from pica_core.capture.rig.source import RigSource
from pica_core.capture.rig.zones import hair_coverage
from pica_core.errors import CaptureError
from pica_core.types import ByteArray, FloatArray, IntArray

IRIS_RADIUS_M = 0.0060
"""11.7 mm across (Rüfer et al. 2005), a little more for eyeballs that are larger than life."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Growth:
    """Hair of a head by welded vertex.

    Attributes:
        hairs: Coverage of the scalp (0 at the hairline, 1 is 14 mm above), direction of strands,
            density of the beard. float32 ``[P, 5]``.
        strand: On hair: along 0 to 1, across -1 to 1, number, length in metres. On teeth: 0, or 1
            where an arch ends in the dark. float32 ``[P, 4]``.
    """

    hairs: FloatArray
    strand: FloatArray


def split_parts(head: DrawnRig) -> IntArray:
    """Part of each split vertex: that of its triangles. ``[V]``."""
    part = np.zeros(len(head.chart.source), np.int32)
    of_face = head.features.part[head.chart.face_source]
    # Where parts share an island, the later part of the table wins.
    np.maximum.at(part, head.chart.faces, of_face[:, None])
    return part


def surface(head: DrawnRig, growth: Growth | None) -> FloatArray:
    """Four numbers for every split vertex; their meaning depends on the part. ``[V, 4]``."""
    f, mesh, source = head.features, head.mesh, head.chart.source
    rest = mesh.rest_m
    part = split_parts(head)
    local = np.zeros((len(source), 4), np.float32)
    skin = part == MATERIALS.index("skin")
    coverage = hair_coverage(rest)
    if f.regions["hair"].any():
        coverage = np.full(len(rest), -1.0)
    if growth is not None:
        coverage = growth.hairs[:, 0].astype(np.float64)
        locks = np.isin(part, [MATERIALS.index("hair"), MATERIALS.index("teeth")])
        local[locks] = growth.strand[source[locks]]
    columns = np.stack([f.lips, 1000 * f.eye_gap_m, coverage, f.above_eye], 1)
    local[skin] = columns[source[skin]]
    for eye in mesh.eyes:
        mine = np.isin(source, eye.vertices)
        local[mine, :3] = (rest[source[mine]] - eye.centre_m) / eye.radius_m
        local[mine, 3] = eye.side
    tongue = part == MATERIALS.index("tongue")
    if tongue.any():
        z = rest[source[tongue], 2]
        local[tongue, 0] = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    lining = part == MATERIALS.index("mouth_bag")
    if lining.any():
        z = rest[source[lining], 2]
        front = f.mouth.z.max() if f.mouth is not None else z.max()
        local[lining, 0] = 1000 * (front - z)
    return local


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Albedo:
    """A base colour image: sRGB uint8 ``[H, W, 3]``, row 0 on top, and how it goes on beyond."""

    pixels: ByteArray
    wrap: tuple[str, str] = ("repeat", "repeat")


def open_albedo(where: str, data: bytes) -> ByteArray:
    """An image as sRGB, row 0 on top. uint8 ``[H, W, 3]``."""
    return np.ascontiguousarray(open_image(where, data)[..., :3])


def read_albedos(source: RigSource, choices: tuple[str, ...]) -> dict[int, Albedo]:
    """Base colour images by material: those inside the rig's file, then the user's.

    A choice of the user is ``FILE`` for the material with most triangles, or ``MATERIAL=FILE``.
    """
    found = {
        index: Albedo(
            pixels=open_albedo(
                f"{source.path}: image of material {source.materials[index]!r}", image.data
            ),
            wrap=image.wrap,
        )
        for index, image in source.images.items()
        if source.uv is not None
    }
    for choice in choices:
        name, separator, path = choice.partition("=")
        path = path if separator else choice
        if source.uv is None:
            raise CaptureError(
                f"albedo {path}: {source.path} has no texture coordinates to put it on"
            )
        if separator and name not in source.materials:
            raise CaptureError(
                f"albedo: no material {name!r}; there are {', '.join(source.materials)}"
            )
        largest = int(np.argmax(np.bincount(source.face_material)))
        index = source.materials.index(name) if separator else largest
        found[index] = Albedo(pixels=open_albedo(path, read_bytes(Path(path))))
    return found
