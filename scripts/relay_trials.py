"""Load a relay of one's own beside rivals, beside clients that misbehave, or for long.

    python scripts/relay_trials.py --compare naive,echo --rooms 60 --seconds 6
    python scripts/relay_trials.py --ablate all --rooms 100
    python scripts/relay_trials.py --hostile all --rooms 30 --seconds 10
    python scripts/relay_trials.py --soak 30 --rooms 30

Prints the figures as JSON; with ``--record`` they are appended to docs/results/relay.jsonl, which
the page about the relay is drawn from. What is done is described in ``tests/malice`` and
``tests/rivals``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from record_result import append_result, load_now  # noqa: E402

from malice.beside import HostileConfig, run_hostile_bench  # noqa: E402
from malice.clients import KINDS  # noqa: E402
from malice.soak import SoakConfig, run_soak  # noqa: E402
from pica_client.bench.relay.bench import RelayBenchConfig  # noqa: E402
from pica_client.errors import ClientError  # noqa: E402
from pica_client.signals import terminate_as_interrupt  # noqa: E402
from rivals.comparison import PARTS, RIVALS, run_comparison  # noqa: E402


def _names(words: str, known: Iterable[str]) -> list[str]:
    return list(known) if words == "all" else [word for word in words.split(",") if word]


def main() -> None:
    """Read the command line, run, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compare", default="", help=f"some of {', '.join(RIVALS)}")
    parser.add_argument("--ablate", default="", help=f"all, or some of {', '.join(PARTS)}")
    parser.add_argument("--hostile", default="", help=f"all, or some of {', '.join(KINDS)}")
    parser.add_argument("--soak", type=float, help="minutes; then the relay is stopped")
    parser.add_argument("--rooms", type=int, default=20)
    parser.add_argument("--peers", type=int, default=5, help="in each room")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--record", action="store_true")
    options = parser.parse_args()
    load_before = load_now()
    try:
        with terminate_as_interrupt():
            load = RelayBenchConfig(
                rooms=options.rooms, peers=options.peers, seconds=options.seconds
            )
            if options.soak is not None:
                result = run_soak(SoakConfig(load=load, minutes=options.soak))
            elif options.hostile:
                kinds = tuple(_names(options.hostile, KINDS))
                result = run_hostile_bench(HostileConfig(load=load, kinds=kinds))
            else:
                ablate = _names(options.ablate, PARTS)
                result = run_comparison(load, _names(options.compare, RIVALS), ablate)
    except ClientError as error:
        sys.exit(f"relay_trials: {error}")
    print(json.dumps(result))
    if options.record:
        words = " ".join(word for word in sys.argv[1:] if word != "--record")
        append_result("relay", f"python scripts/relay_trials.py {words}", result, load_before)


if __name__ == "__main__":
    main()
