"""Write the built-in heads as data: what `capture.procedural` makes of formulas, as one archive.

python scripts/export_heads.py OUT.npz
"""

import json
import sys
from typing import Any

import numpy as np

from pica_core.capture.procedural.features import grown_hair, look, source_uv
from pica_core.capture.procedural.heads import ProceduralHead, make_head
from pica_core.capture.procedural.identity import IDENTITIES
from pica_core.types import Array, Float64Array

REST_MM, MOTION_MM, SHARE, UV_M = 0.002, 0.005, 1 / 4095, 1e-5
"""Steps of places, of motion, of weights and of coordinates along weaves."""
SHIFTS_MM = np.arange(-18.0, 9.0, 0.5)
"""How far a lid's margin may go from rest, at each step of the table of depths."""


def steps(values: Float64Array, step: float) -> Array:
    """Differences of rounded values along the last axis."""
    rounded = np.rint(np.asarray(values) / step).astype(np.int64)
    change = np.diff(rounded, axis=-1, prepend=0)
    return change.astype(np.int16 if np.abs(change).max() < 2**15 else np.int32)


def lids(head: ProceduralHead) -> dict[str, Array]:
    """How the lids of both eyes move: the left one's numbers, and both ones' vertices."""
    left, chart = head._lids[0], head.charts["skin"]
    row, column = np.divmod(left.index, chart.shape[1])
    mirrored = row * chart.shape[1] + chart.shape[1] - 1 - column
    y = head._rest[left.index, 1][:, None] + SHIFTS_MM * left._slide[:, None]
    depth = left._surface.depth(left._u[:, None], y, left._thickness[:, None])
    numbers = [left._upper, left._lower, left._slide, left._at_edge * left._is_upper]
    return {
        "lid_index": np.stack([left.index, mirrored]).astype(np.uint16),
        "lid_upper": left._is_upper,
        "lid_numbers": np.stack([left.weight, *numbers]).astype(np.float32),
        "lid_depth": steps(depth, REST_MM),
    }


def of_head(name: str) -> tuple[dict[str, Array], dict[str, Any]]:
    """Arrays and numbers of one head."""
    head = make_head(name)
    features, mouth = head.features, head.features.mouth
    assert mouth is not None
    growth = grown_hair(head.identity, head.charts, head.rest_m, features)
    fields = head._fields.reshape(52, *head.charts["skin"].shape, 3).transpose(0, 3, 1, 2)
    motion = np.diff(steps(fields, MOTION_MM), axis=-2, prepend=0)
    uv = source_uv(head.identity, head.charts, head.vertex_uv)
    arrays = {
        "rest": steps(head._rest.T, REST_MM),
        "motion": motion.astype(np.int16),
        "jaw": steps(np.stack([head._jaw, head._jaw_closed]), SHARE),
        "uv": steps(uv.T, UV_M),
        "hairs": growth.hairs.T.astype(np.float16),
        "strand": growth.strand.T.astype(np.float16),
        "lips": features.lips.astype(np.float16),
        "eye_gap_m": features.eye_gap_m.astype(np.float16),
        "mouth": np.stack([mouth.x, mouth.y, mouth.z]),
        "regions": np.packbits(np.stack(list(features.regions.values())), axis=1),
        **lids(head),
    }
    about = {
        "look": look(head.identity), "landmarks": head.landmarks, "mouth_half_m": mouth.half_m,
        "brow_y": features.brow_y, "nose_tip": features.nose_tip.tolist(),
        "eye_mm": head._eye_centre.tolist(), "lip_z": float(head._lip_z),
    }  # fmt: skip
    return {f"{name}.{key}": value for key, value in arrays.items()}, about


def main(out: str) -> None:
    """Write all heads."""
    head = make_head("S1")
    weld = np.arange(head.num_vertices)
    for first, last in head._weld:
        weld[last] = first
    charts = {
        name: {"rows": chart.rows.tolist(), "columns": chart.columns.tolist()}
        for name, chart in head.charts.items()
    }
    arrays: dict[str, Array] = {
        "faces": steps(head.faces.T, 1),
        "part": head.features.part.astype(np.uint8),
        "above_eye": head.features.above_eye,
        "weld": steps(weld, 1),
        "turns": head._eye_turns,
    }
    about: dict[str, Any] = {"charts": charts, "regions": list(head.regions)}
    for name in IDENTITIES:
        mine, about[name] = of_head(name)
        assert list(make_head(name).regions) == about["regions"]
        arrays |= mine
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez_compressed(out, **arrays)


if __name__ == "__main__":
    main(sys.argv[1])
