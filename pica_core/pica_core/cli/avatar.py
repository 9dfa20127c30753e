"""`pica avatar info` and `pica avatar verify`."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import avatar_id, load_avatar
from pica_core.avatar.shipped import avatar_file
from pica_core.avatar.spec import decoder_layers
from pica_core.avatar.variants import pixel_codec_cost
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder
from pica_core.errors import AvatarFileError
from pica_core.reference.decoders import count_parameters


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarInfoOptions:
    """Show what an avatar file holds."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AvatarVerifyOptions:
    """Check an avatar file as a receiver would, and its identity."""

    file: Path = field(kw_only=False)
    """Name of a shipped avatar, or a .pica file."""
    sha256: str = ""
    """Expected identity, hexadecimal; empty to accept any."""


def avatar_info(options: AvatarInfoOptions) -> dict[str, Any]:
    """Show what an avatar file holds: who, how large, trained on what."""
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


def avatar_verify(options: AvatarVerifyOptions) -> dict[str, Any]:
    """Check an avatar file: everything a receiver checks, then one trip through the sender's
    half."""
    file = avatar_file(options.file)
    avatar = load_avatar(file)
    identity = avatar_id(file)
    if options.sha256 and options.sha256.lower() != identity:
        raise AvatarFileError(
            f"{file}: sha256 is {identity}; {options.sha256.lower():.64} was expected"
        )
    latents = ExpressionEncoder(avatar).encode(np.eye(NUM_ARKIT, dtype=np.float32))
    if not np.isfinite(latents).all():
        raise AvatarFileError(f"{file}: the expression encoder's output is not finite")
    profile = avatar.stream_profile()
    frame = LatentEncoder(profile).encode(latents[0], np.zeros(3), np.zeros(3), 0)
    assert frame is not None  # the first frame of a stream is always sent
    LatentDecoder(profile).decode(frame.payload)
    print(f"{file}: ok, {identity}", file=sys.stderr)
    return {"file": str(file), "ok": True, "sha256": identity}
