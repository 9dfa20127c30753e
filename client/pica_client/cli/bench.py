"""`pica bench call`, `pica bench playout` and `pica bench codec`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.network.impairment import Impairment
from pica_client.errors import OptionError
from pica_client.local_call.local_call import LocalCallConfig, choose_avatars
from pica_client.output import check_writable, say
from pica_client.playout.config import PlayoutConfig, playout_with_floor
from pica_client.signals import terminate_as_interrupt
from pica_core.avatar.file import Avatar
from pica_core.codec.latent_stream import DEFAULT_QUALITY


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchCallOptions:
    """Options of ``pica bench call``."""

    peers: int = 5
    """Number of senders, each a process."""
    seconds: float = 20.0
    """Measured time, seconds."""
    source: str | None = None
    """What all senders play, each starting elsewhere in it; by default shipped performances."""
    avatar: str | None = None
    """Names or .pica files of avatars, separated by commas, dealt in turn."""
    fps: float = 30.0
    """Frames a second of each sender."""
    quality: int = DEFAULT_QUALITY
    """Fineness of the coded streams, 0 to 7."""
    plain: bool = False
    """Send 8 bits a value instead of coded streams."""
    playout_floor_ms: float = field(default=PlayoutConfig().floor_s * 1e3)
    """Least playout delay, milliseconds."""
    delay: float = 0.0
    """Worsen the receiver's network: milliseconds added each way."""
    jitter: float = 0.0
    """95th percentile of a further, varying delay, milliseconds."""
    stall: float = 0.0
    """Every few seconds nothing comes for so many milliseconds, then all at once."""
    loss: float = 0.0
    """Share of TCP segments that have to be sent again, which takes 200 ms each time, 0 to 0.9."""
    rate: float = 0.0
    """Bits a second that the receiver's network carries, all headers included; 0 is no limit."""


def bench_call(options: BenchCallOptions) -> dict[str, Any]:
    """Measure a call on this machine without drawing it: relay, senders and a decoding receiver.

    Reports the latency from source sample to decoded avatar, with its parts, rates and bitrates.
    """
    from pica_client.bench.call import BenchConfig, run_bench

    config = BenchConfig(
        stage=LocalCallConfig(
            peers=options.peers,
            source=options.source,
            avatar=options.avatar,
            fps=options.fps,
            quality=options.quality,
            plain=options.plain,
        ),
        seconds=options.seconds,
        playout=playout_with_floor(options.playout_floor_ms),
        impairment=_impairment(options),
    )
    with terminate_as_interrupt():
        result = run_bench(config)
    latency = result["latency_ms"]
    say(
        f"{result['decoded_peers']} of {result['peers']} peers, source sample to decoded avatar: "
        f"p50 {latency['p50']} ms, p95 {latency['p95']} ms, p99 {latency['p99']} ms"
    )
    if rendered := result.get("rendered"):
        say(
            f"on a display behind that network: rendered MSE {rendered['mse_delayed']} against the "
            f"undisturbed stream, concealed {rendered['concealed_ratio']:.1%}, "
            f"age p50 {rendered['age_ms']['p50']} ms, p95 {rendered['age_ms']['p95']} ms"
        )
    return result


def _impairment(options: BenchCallOptions) -> Impairment | None:
    given = (options.delay, options.jitter, options.stall, options.loss, options.rate)
    if not any(given):
        return None
    return Impairment(
        delay_s=options.delay / 1e3,
        jitter_s=options.jitter / 1e3,
        stall_s=options.stall / 1e3,
        loss_ratio=options.loss,
        rate_bps=options.rate or None,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchPlayoutOptions:
    """Options of ``pica bench playout``."""

    source: str = "performance:talk"
    """The face that is sent; see pica send --help."""
    avatar: str | None = None
    """Name of a shipped avatar, or a .pica file; the first shipped one by default."""
    codec: str = "coded"
    """Format of the payloads: coded, or plain for 8 bits a value and every frame alone."""
    scenarios: str = ""
    """Names of troubles, separated by commas; all by default."""
    seconds: float = 30.0
    """Length of each run; the trouble lasts the middle third of it."""
    fps: float = 30.0
    """Frames captured a second."""
    display_hz: float = 60.0
    """Refreshes of the display a second."""
    renders_per_s: float = 10.0
    """Refreshes that are rendered to measure the error, a second."""
    seed: int = 0
    """Of the network."""


def bench_playout(options: BenchPlayoutOptions) -> dict[str, Any]:
    """Measure what the playout makes of troubled networks: rendered error, delay, recovery.

    Runs on a virtual clock and needs no network. Compares the receiver's playout with a fixed
    buffer of 100 ms and with none.
    """
    from pica_client.bench.network.stream_trial import Schedule
    from pica_client.bench.playout import BenchPlayoutConfig, run_bench_playout

    config = BenchPlayoutConfig(
        source=options.source,
        codec=options.codec,
        scenarios=tuple(name for name in options.scenarios.split(",") if name),
        schedule=Schedule(seconds=options.seconds, fps=options.fps, display_hz=options.display_hz),
        renders_per_s=options.renders_per_s,
        seed=options.seed,
    )
    return run_bench_playout(config, load_bench_avatar(options.avatar))


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
    from pica_client.bench.codec import CodecConfig, parse_sources, run_codec_bench

    config = CodecConfig(
        sources=parse_sources(options.sources),
        seconds=options.seconds,
        moments=options.moments,
        image_size=options.image_size,
        sheet=options.sheet,
    )
    if options.sheet is not None:
        check_writable(options.sheet)
    result = run_codec_bench(config, load_bench_avatar(options.avatar))
    for row in result["rows"]:
        loss = row["psnr_loss_db"]
        say(
            f"{row['source']:28} {row['profile']:18} {row['payload_bps'] / 1e3:8.2f} kbit/s  "
            f"MSE {row['mse']:6.2f}  change {row['change_mse']:6.2f}"
            + ("" if loss is None else f"  loss {loss:+.3f} dB")
        )
    return result


def load_bench_avatar(name: str | None) -> Avatar:
    """The avatar of a bench that needs one: by name or file, by default the first that ships."""
    return load_bench_avatars(name)[0]


def load_bench_avatars(names: str | None) -> list[Avatar]:
    """The avatars of a bench: names or files, separated by commas; by default all that ship."""
    library = AvatarLibrary()
    try:
        return [library.load(library.find(name)) for name in choose_avatars(names, library)]
    finally:
        library.close()


def read_numbers(name: str, text: str) -> tuple[float, ...]:
    """Numbers of an option, separated by commas.

    Raises:
        OptionError: Something else; names the option.
    """
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError as error:
        raise OptionError(f"{name} is {text!r}; write numbers with commas") from error
