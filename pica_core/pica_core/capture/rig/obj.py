"""Read a rig from a folder of OBJ files: a neutral face and one file per shape, one topology."""

from pathlib import Path

import numpy as np

from pica_core.capture.dataset.obj import read_obj
from pica_core.capture.rig.source import RigSource, check_counts, check_source
from pica_core.errors import CaptureError
from pica_core.types import FloatArray

NEUTRAL_WORDS = ("neutral", "basis", "rest", "base")
"""What the name of the neutral face's file contains, the first that is found."""


def read_obj_folder(folder: Path) -> RigSource:
    """Read a rig: one neutral OBJ (neutral, basis, rest or base in its name), and one per shape."""
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".obj")
    if not paths:
        raise CaptureError(f"{folder}: no OBJ files")
    neutral_path = next(
        (p for word in NEUTRAL_WORDS for p in paths if word in p.stem.lower()), None
    )
    if neutral_path is None:
        raise CaptureError(
            f"{folder}: which of {len(paths)} OBJ files is the neutral face? "
            f"Its name must contain one of {', '.join(NEUTRAL_WORDS)}"
        )
    neutral = read_obj(neutral_path)
    check_counts(
        str(neutral_path),
        vertices=len(neutral.vertices),
        faces=len(neutral.faces),
        shapes=len(paths) - 1,
    )
    positions = neutral.positions()
    faces, uv_faces, material, names = neutral.triangles()
    uv = None
    if neutral.texture and (uv_faces >= 0).all():
        uv = neutral.uv()
        uv[:, 1] = 1 - uv[:, 1]
    face_text = [rest.split() for _, rest in neutral.faces]
    shapes: dict[str, FloatArray] = {}
    for path in paths:
        if path == neutral_path:
            continue
        shape = read_obj(path)
        if len(shape.vertices) != len(positions):
            raise CaptureError(
                f"{path}: {len(shape.vertices)} vertices; {neutral_path.name} has "
                f"{len(positions)}, and all OBJ files must share one topology"
            )
        if [rest.split() for _, rest in shape.faces] != face_text:
            other = shape.triangles()[0]
            if other.shape != faces.shape or (other != faces).any():
                raise CaptureError(
                    f"{path}: its faces differ from those of {neutral_path.name}; all OBJ files "
                    "must share one topology"
                )
        posed = shape.positions()
        if not np.isfinite(posed).all():
            row = int(np.flatnonzero(~np.isfinite(posed).all(1))[0])
            raise CaptureError(f"{path}: vertex {row + 1} is not finite")
        shapes[path.stem] = (posed - positions).astype(np.float32)
    return check_source(
        RigSource(
            path=folder,
            positions=positions,
            faces=faces,
            uv=uv,
            uv_faces=uv_faces if uv is not None else None,
            materials=names,
            face_material=material,
            shapes=shapes,
        )
    )
