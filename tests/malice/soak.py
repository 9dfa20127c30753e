"""A long, steady load, and then the end of the relay: is anything growing, and is anything lost?

The rooms send for as long as asked; every minute counts as a measurement of its own. Then the relay
is told to stop (SIGTERM) while a peer whispers to another, and everybody waits for their goodbye.
A control message is lost if the relay passed it on, by its own count, and nobody got it; a whisper
that the relay had not read when it closed its sender is none.
"""

import os
import signal
import sys
import time
from dataclasses import dataclass
from typing import Any, Final

from malice.clients import MisbehavingClient
from pica_client.bench.relay.bench import Load, RelayBenchConfig, start_relay
from pica_client.bench.relay.figures import describe
from pica_client.bench.relay.processes import Workers, memory_bytes
from pica_client.errors import OptionError
from pica_client.local_call.processes import Children
from pica_client.stats import describe_machine
from pica_protocol.codec import decode_message, encode_message
from pica_protocol.limits import MAX_CONTROL_BYTES
from pica_protocol.messages import Bye, Whisper

NUM_WHISPERS: Final = 100
"""Messages sent in one go before the end: fewer than a peer may send at once."""
HEAD_START_S: Final = 0.01
"""Seconds after the first half of them: the relay is to be stopped between two messages."""
DRAIN_TIMEOUT_S: Final = 30.0
"""Seconds that everybody's goodbye may take."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SoakConfig:
    """How long, under what load."""

    load: RelayBenchConfig
    minutes: float = 30.0

    def __post_init__(self) -> None:
        if not 0.05 <= self.minutes <= 24 * 60:
            raise OptionError(f"soak is {self.minutes:g} minutes; 0.05 to 1440 is allowed")
        if self.load.url is not None:
            raise OptionError("soak stops the relay at its end: leave out url")

    @property
    def steps(self) -> tuple[int, float]:
        """How many measurements, and how long each is, seconds."""
        num = max(round(self.minutes), 3)
        return num, self.minutes * 60 / num


def run_soak(config: SoakConfig) -> dict[str, Any]:
    """Load a relay for long, then stop it.

    Raises:
        ClientError: A process did not do its part.
    """
    num_steps, step_s = config.steps
    with Workers() as workers, Children() as children:
        relay, target = start_relay(config.load, children)
        load = Load(config.load, target, workers)
        load.connect(config.load.rooms)
        rows = []
        for step in range(num_steps):
            row = load.measure(config.load.rooms, step_s)
            held = memory_bytes(relay.pid)
            kept = ("delivered_per_s", "forward_ms", "dropped", "missing", "errors")
            rows.append({"relay_bytes": held, **{key: row[key] for key in kept}})
            _say(f"{step + 1} of {num_steps}: {(held or 0) / 1e6:.1f} MB; {describe(row)}")
        drain = _drain(relay.pid, target.url, load)
        relay.wait(time.monotonic() + DRAIN_TIMEOUT_S)
        passed = relay.result()["whispers"]
        load.leave()
    drain["whispers_passed"] = passed
    drain["lost_control"] = passed - drain["whispers_received"] + drain["without_goodbye"]
    _say(
        f"drained {drain['connections']} connections in {drain['seconds']} s: "
        f"closed with {drain['close_codes']}, {drain['lost_control']} control messages lost"
    )
    return {
        "rooms": config.load.rooms,
        "peers": config.load.peers,
        "fps": config.load.fps,
        "minutes": config.minutes,
        "soak": rows,
        "memory_growth": _growth([row["relay_bytes"] for row in rows]),
        "p99_growth": _growth([row["forward_ms"]["p99"] for row in rows]),
        "drain": drain,
        "machine": describe_machine(),
    }


def _drain(pid: int, url: str, load: Load) -> dict[str, Any]:
    """Stop the relay while somebody is being whispered to."""
    listener, speaker = MisbehavingClient(url), MisbehavingClient(url)
    joined = listener.join("soak-witness")
    if joined is None or speaker.join("soak-witness") is None:
        raise OptionError("soak: the witnesses were not let in")
    for number in range(NUM_WHISPERS):
        whisper = Whisper(peer_id=joined.peer_id, data=number.to_bytes(2, "big"))
        if number == NUM_WHISPERS // 2:
            time.sleep(HEAD_START_S)
        speaker.send(encode_message(whisper))
    begin_s = time.monotonic()
    os.kill(pid, signal.SIGTERM)
    load.begin_farewell(DRAIN_TIMEOUT_S)
    heard, goodbyes = 0, 0
    while listener.code is None and time.monotonic() < begin_s + DRAIN_TIMEOUT_S:
        for data in listener.received():
            if data[0] == 1:
                message = decode_message(data, MAX_CONTROL_BYTES)
                heard += isinstance(message, Whisper)
                goodbyes += isinstance(message, Bye)
    listener.sock.close()
    speaker.sock.close()
    live, codes = load.end_farewell(DRAIN_TIMEOUT_S)
    return {
        "seconds": round(time.monotonic() - begin_s, 2),
        "connections": load.num_connections,
        "close_codes": codes,
        "without_goodbye": load.num_connections - codes.get("1001", 0) + (goodbyes == 0),
        "still_open": live,
        "whispers_sent": NUM_WHISPERS,
        "whispers_received": heard,
    }


def _growth(values: list[float | int | None]) -> float | None:
    """The last third's median over the first third's, less one; None where something is missing."""
    known = [value for value in values if value is not None]
    third = len(values) // 3
    if len(known) < len(values) or not third:
        return None
    first, last = sorted(known[:third])[third // 2], sorted(known[-third:])[third // 2]
    return round(last / first - 1, 4)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
