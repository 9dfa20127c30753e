"""A whole run: targets in turn, each round with a seed of its own, so that any can be repeated."""

from __future__ import annotations

import gc
import random
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Final

from fuzzing import relay_targets, seal_targets, targets, voice_targets
from fuzzing.meter import Meter
from fuzzing.targets import Target

TARGETS: Final[Mapping[str, Target]] = {
    "codec": targets.codec,
    "frames": targets.frames,
    "server session": targets.server_session,
    "client session": targets.client_session,
    "crowded client": targets.crowded_client,
    "tokens": relay_targets.tokens,
    "sealed frames": seal_targets.sealed_frames,
    "key messages": seal_targets.key_messages,
    "guard": seal_targets.guard,
    "voice": voice_targets.voice,
}

WEIGHTS: Final[Mapping[str, int]] = {
    "codec": 16,
    "frames": 8,
    "server session": 64,
    "client session": 64,
    "tokens": 4,
    "guard": 2,
}
"""How often a target has its turn; a session is over after a few messages, so many are needed."""

MOST_BYTES_A_CALL: Final = 2 << 20
"""What one message may make its reader hold for a moment: each of 16 KiB can be a map of its own,
which takes Python 64 bytes."""
MOST_BYTES: Final = 64 << 20
"""What everything together may hold."""


class FuzzFailure(Exception):
    """A round did not end as documented: names the target, the seed and the round."""


def run(
    num_messages: int,
    *,
    seed: int,
    first_round: int = 0,
    only: str = "",
    is_tracing: bool = True,
    tell: Callable[[int, Meter], None] = lambda number, meter: None,
) -> dict[str, Any]:
    """Throw at least so many damaged messages at all targets in turn.

    Args:
        num_messages: In all; the last round is finished.
        seed: Of everything.
        first_round: Where to begin: a round is the same whatever came before it.
        only: Throw them at one target alone.
        is_tracing: Whether to measure memory; it costs two thirds of the speed.
        tell: Called after each round.

    Returns:
        Figures for people and reports.

    Raises:
        FuzzFailure: Something happened that is not documented.
    """
    meter = Meter()
    names = [name for name in TARGETS for _ in range(WEIGHTS.get(name, 1))]
    names = [only] if only else names
    begin_s = time.monotonic()
    if is_tracing:
        gc.collect()
        tracemalloc.start()
    try:
        number = first_round
        while meter.num_damaged < num_messages:
            meter.target = names[number % len(names)]
            try:
                TARGETS[meter.target](random.Random(f"{seed}:{number}"), meter)
            except Exception as error:
                raise FuzzFailure(
                    f"{meter.target}: {type(error).__name__}: {str(error)[:2000]}\n"
                    f"again with --seed {seed} --round {number} --messages 1"
                ) from error
            number += 1
            tell(number, meter)
        held, _ = tracemalloc.get_traced_memory() if is_tracing else (0, 0)
    finally:
        tracemalloc.stop()
    if meter.largest_bytes > MOST_BYTES_A_CALL:
        raise FuzzFailure(f"one call of {meter.largest_where} held {meter.largest_bytes} bytes")
    if held > MOST_BYTES:
        raise FuzzFailure(f"{held} bytes are held at the end")
    kinds: Counter[str] = Counter()
    by_target: dict[str, dict[str, int]] = {}
    for outcome, count in sorted(meter.outcomes.items()):
        target, _, kind = outcome.partition(": ")
        kinds[kind] += count
        by_target.setdefault(target, {})[kind] = count
    return {
        "damaged": meter.num_damaged,
        "whole": meter.num_whole,
        "rounds": number - first_round,
        "seed": seed,
        "first_round": first_round,
        "seconds": round(time.monotonic() - begin_s, 1),
        "outcomes": dict(kinds.most_common()),
        "by_target": by_target,
        "longest_call_ms": round(meter.longest_s * 1000, 2),
        "longest_call_in": meter.longest_where,
        "largest_call_bytes": meter.largest_bytes,
        "largest_call_in": meter.largest_where,
        "held_bytes_at_end": held,
    }
