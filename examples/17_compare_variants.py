"""Compare what the paper's models cost a receiver: trained numbers, and multiply-adds.

You learn that a variant is data: each row of `VARIANTS` is the full model with one part
replaced, so the difference between two rows is the ablation. The sizes are the paper's.
"""

from dataclasses import replace

from pica_core.avatar.spec import FULL, VARIANTS, AvatarSpec, pixel_codec_cost

SPEC = AvatarSpec(block="H2")

print("variant   differs in              parameters  per frame  per pixel")
for name, row in VARIANTS.items():
    parts = [
        f"{part}={getattr(row, part)}"
        for part in ("network", "encoding", "topology", "geometry")
        if getattr(row, part) != getattr(FULL, part)
    ]
    if row.network != FULL.network:
        print(f"{name:9} {', '.join(parts)}: a network of its own, see docs/training.md")
        continue
    cost = pixel_codec_cost(replace(SPEC, encoding=row.encoding, geometry=row.geometry))
    print(
        f"{name:9} {', '.join(parts) or 'nothing':22} {cost.parameters / 1e6:8.3f} M "
        f"{cost.per_object_multiply_adds / 1e6:8.1f} M {cost.per_pixel_multiply_adds:10d}"
    )
