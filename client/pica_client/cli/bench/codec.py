"""`pica bench codec`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tyro.conf import OmitArgPrefixes

from pica_client.bench.codec import CodecConfig, run_codec_bench
from pica_client.cli.bench.avatars import load_bench_avatar
from pica_client.output import check_writable, say


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchCodecOptions:
    """Options of ``pica bench codec``."""

    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    config: OmitArgPrefixes[CodecConfig] = field(default_factory=CodecConfig)


def bench_codec(options: BenchCodecOptions) -> dict[str, Any]:
    """Measure what the latent stream's bits buy: bitrate against rendered error.

    Compares our qualities, thinned and whole, with plain 8 bit, 16-bit float, zlib and zstd with a
    trained dictionary.
    """
    if options.config.sheet is not None:
        check_writable(options.config.sheet)
    result = run_codec_bench(options.config, load_bench_avatar(options.avatar))
    for row in result["rows"]:
        loss = row["psnr_loss_db"]
        say(
            f"{row['source']:28} {row['profile']:18} {row['payload_bps'] / 1e3:8.2f} kbit/s  "
            f"MSE {row['mse']:6.2f}  change {row['change_mse']:6.2f}"
            + ("" if loss is None else f"  loss {loss:+.3f} dB")
        )
    return result
