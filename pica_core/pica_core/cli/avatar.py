"""`pica avatar info`."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.avatar.file import avatar_id, load_avatar
from pica_core.avatar.shipped import avatar_file
from pica_core.avatar.spec import decoder_layers
from pica_core.avatar.variants import pixel_codec_cost
from pica_core.reference.decoders import count_parameters


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarInfoOptions:
    """Check an avatar file as a receiver would, and show what it holds."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""


def avatar_info(options: AvatarInfoOptions) -> dict[str, Any]:
    """Show what an avatar file holds, after everything a receiver checks: who, how large, trained
    on what."""
    path = avatar_file(options.file)
    avatar = load_avatar(path)
    manifest, spec = avatar.manifest, avatar.spec
    found = {
        "name": manifest.name,
        "identity": manifest.identity,
        "sha256": avatar_id(path),
        "bytes": path.stat().st_size,
        "licence": manifest.licence,
        "block": spec.block,
        "geometry": spec.geometry,
        "levels": list(avatar.levels),
        "vertices": len(avatar.tensors["mesh.vertex_uv"]),
        "faces": len(avatar.tensors["mesh.faces"]),
        "level_faces": [len(avatar.level_faces(level)) for level in avatar.levels],
        "pixel_decoder": count_parameters(avatar.tensors, "pixel"),
        "decoders": sum(
            int(np.prod(shape))
            for decoder in spec.decoders
            for layer in decoder_layers(spec, decoder)
            for shape in layer.tensor_shapes().values()
        ),
        "encoding": spec.encoding,
        "encodings": sum(int(np.prod(shape)) for shape in spec.encoding_shapes.values()),
        "decode_mmac": round(pixel_codec_cost(spec).per_object_multiply_adds / 1e6, 2),
        "model_card": dict(manifest.model_card),
    }
    for name, value in found.items():
        print(f"{name:>16}  {value}", file=sys.stderr)
    return found
