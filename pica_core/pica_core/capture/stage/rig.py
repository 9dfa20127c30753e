"""A rig on the stage, and what `capture.json` says of it."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.capture.rig.chart import map_error_m
from pica_core.capture.rig.head import RigHead, make_rig, read_rig
from pica_core.capture.rig.names import read_names
from pica_core.capture.rig.skin import Albedo, read_albedos
from pica_core.capture.rig.source import RigSource
from pica_core.capture.stage.expressions import sample_takes
from pica_core.capture.stage.subject import BAKE_SIZE, Subject

ERROR_POSES = 8
"""Expressions over which the error that the position map leaves is measured."""
ERROR_REGIONS = ("face", "lips", "lids", "eyeballs", "teeth", "tongue", "mouth_interior")


def chart_error_mm(head: RigHead, poses: int = ERROR_POSES) -> dict[str, dict[str, float]]:
    """What the best position map leaves, by region: mean and 99th percentile, millimetres.

    Measured over `poses` expressions, evenly from a performance made with seed 0.
    """
    arkit = np.concatenate([take.arkit for take in sample_takes(8 * poses, 0)])[::8]
    meshes = np.stack([head.vertices(values) for values in arkit])
    error = 1000 * map_error_m(head.chart.vertex_uv, meshes)
    regions = head.topology.regions
    masks = {"all": np.ones(error.shape[1], np.bool_)}
    masks |= {name: regions[name] for name in ERROR_REGIONS if regions[name].any()}
    return {
        name: {
            "mean": round(float(error[:, mask].mean()), 4),
            "p99": round(float(np.quantile(error[:, mask], 0.99)), 4),
        }
        for name, mask in masks.items()
    }


class RigSubject(Subject):
    """A rig on the stage, from a .glb file or a folder of OBJ files.

    `table` is the user's table of names; `albedo` are choices as `skin.read_albedos` takes them.

    Raises:
        CaptureError: Anything that is wrong with the files.
    """

    def __init__(
        self,
        path: Path,
        table: Path | None = None,
        albedo: tuple[str, ...] = (),
        *,
        bake_size: int = BAKE_SIZE,
        self_shadow: bool = True,
    ) -> None:
        names = read_names(table) if table is not None else None
        source = read_rig(path)
        images = read_albedos(source, albedo)
        self.head: RigHead = make_rig(source, names)
        super().__init__(
            self.head,
            describe_rig(path, source, self.head, images),
            albedo=images,
            bake_size=bake_size,
            self_shadow=self_shadow,
        )


def describe_rig(
    path: Path, source: RigSource, head: RigHead, images: dict[int, Albedo]
) -> dict[str, Any]:
    """Source, rights, names, units, parts, and the error that the position map leaves."""
    mesh = head.mesh
    digest = hashlib.sha256(source.positions.tobytes())
    digest.update(source.faces.tobytes())
    for name, delta in source.shapes.items():
        digest.update(name.encode())
        digest.update(delta.tobytes())
    for index, image in sorted(images.items()):
        digest.update(bytes([index & 255]))
        digest.update(image.pixels.tobytes())
    painted = [
        name for k, name in enumerate(source.materials)
        if k not in images and (mesh.material == k).any()
    ]  # fmt: skip
    return {
        "source": f"rendered from the rig {path.name}",
        "licence": source.copyright or "that of the rig; its file does not say",
        "rig": {
            "sha256": digest.hexdigest(),
            "unit": mesh.frame.unit,
            "axes": mesh.frame.describe(),
            "guessed": list(mesh.frame.guessed),
            "mapped": list(head.names.mapped),
            "missing": list(head.names.missing),
            "ignored": list(head.names.ignored),
            "left_out_materials": list(mesh.dropped),
            "painted_materials": painted,
            "eyeballs": len(mesh.eyes),
            "eyeballs_turned_by_importer": head.eyes_turned_here,
            "mouth_close_is_corrective": head.corrective_close,
            "islands": head.chart.islands,
            "triangles_with_new_coordinates": head.mended,
            "position_map_error_mm": chart_error_mm(head),
        },
    }
