"""`pica bench codec`."""

from typing import Any

from pica_client.bench.codec import CodecConfig, run_codec_bench
from pica_client.cli.bench.avatars import AvatarBenchOptions
from pica_client.output import check_writable, say


def bench_codec(options: AvatarBenchOptions[CodecConfig]) -> dict[str, Any]:
    """Measure what the latent stream's bits buy: bitrate against rendered error.

    Compares our qualities, thinned and whole, with plain 8 bit, 16-bit float, zlib and zstd with a
    trained dictionary.
    """
    if options.config.sheet is not None:
        check_writable(options.config.sheet, ".png")
    result = run_codec_bench(options.config, options.load())
    for row in result["rows"]:
        loss = row["psnr_loss_db"]
        say(
            f"{row['source']:28} {row['profile']:18} {row['payload_bps'] / 1e3:8.2f} kbit/s  "
            f"MSE {row['mse']:6.2f}  change {row['change_mse']:6.2f}"
            + ("" if loss is None else f"  loss {loss:+.3f} dB")
        )
    return result
