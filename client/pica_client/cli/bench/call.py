"""`pica bench call`."""

from dataclasses import dataclass
from typing import Any

from tyro.conf import OmitArgPrefixes

from pica_client.bench.call import BenchConfig, run_bench
from pica_client.bench.network.impairment import Impairment
from pica_client.local_call.local_call import LocalCallConfig
from pica_client.output import say
from pica_client.playout.config import PlayoutConfig, playout_with_floor
from pica_client.signals import terminate_as_interrupt


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkOptions:
    """How to worsen the receiver's network."""

    delay: float = 0.0
    """Milliseconds added each way."""
    jitter: float = 0.0
    """95th percentile of a further, varying delay, milliseconds."""
    stall: float = 0.0
    """Every few seconds nothing comes for so many milliseconds, then all at once."""
    loss: float = 0.0
    """Share of TCP segments that have to be sent again, which takes 200 ms each time, 0 to 0.9."""
    rate: float = 0.0
    """Bits a second that the receiver's network carries, all headers included; 0 is no limit."""

    def impairment(self) -> Impairment | None:
        """What they make of the way to the receiver; None leaves it as it is."""
        if self == NetworkOptions():
            return None
        return Impairment(
            delay_s=self.delay / 1e3,
            jitter_s=self.jitter / 1e3,
            stall_s=self.stall / 1e3,
            loss_ratio=self.loss,
            rate_bps=self.rate or None,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchCallOptions:
    """Options of `pica bench call`."""

    call: OmitArgPrefixes[LocalCallConfig]
    seconds: float = 20.0
    """Measured time, seconds."""
    playout_floor_ms: float = PlayoutConfig().floor_s * 1e3
    """Least playout delay, milliseconds."""
    network: OmitArgPrefixes[NetworkOptions]


def bench_call(options: BenchCallOptions) -> dict[str, Any]:
    """Measure a call on this machine without drawing it: relay, senders and a decoding receiver.

    Reports the latency from source sample to decoded avatar, with its parts, rates and bitrates.
    """
    config = BenchConfig(
        call=options.call,
        seconds=options.seconds,
        playout=playout_with_floor(options.playout_floor_ms),
        impairment=options.network.impairment(),
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
