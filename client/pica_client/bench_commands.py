"""`pica bench codec`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pica_client.avatars import AvatarLibrary
from pica_client.output import check_writable
from pica_client.staging import choose_avatars


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchCodecOptions:
    """Options of ``pica bench codec``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    sources: str = "performance:talk,performance:listen,performance:range_of_motion"
    """What is sent, separated by commas; csv:FILE for a recording, see pica send --help."""
    seconds: float = 60.0
    """Length of each source."""
    moments: int = 40
    """Moments of each source that are drawn."""
    image_size: int = 256
    """Rows and columns of each drawing, pixels."""
    sheet: Path | None = None
    """Draw every profile at the moment of its largest error on the first source into this PNG."""


def bench_codec(options: BenchCodecOptions) -> dict[str, Any]:
    """Measure what the latent stream's bits buy: bitrate against rendered error.

    Compares our qualities, thinned and whole, with plain 8 bit, 16-bit float, zlib and zstd with a
    trained dictionary.
    """
    from pica_client.bench_codec import CodecConfig, parse_sources, run_codec_bench

    config = CodecConfig(
        sources=parse_sources(options.sources),
        seconds=options.seconds,
        moments=options.moments,
        image_size=options.image_size,
        sheet=options.sheet,
    )
    if options.sheet is not None:
        check_writable(options.sheet)
    library = AvatarLibrary()
    try:
        (chosen, *_) = choose_avatars(options.avatar, library)
        avatar = library.load(library.find(chosen))
    finally:
        library.close()
    result = run_codec_bench(config, avatar)
    for row in result["rows"]:
        loss = row["psnr_loss_db"]
        print(
            f"{row['source']:28} {row['profile']:18} {row['payload_bps'] / 1e3:8.2f} kbit/s  "
            f"MSE {row['mse']:6.2f}  change {row['change_mse']:6.2f}"
            + ("" if loss is None else f"  loss {loss:+.3f} dB"),
            file=sys.stderr,
        )
    return result
