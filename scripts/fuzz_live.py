"""Let strangers loose on a live relay: broken messages, websockets and HTTP, on many connections.

python scripts/fuzz_live.py --messages 50000      some five minutes; --record keeps the figures

It starts a relay on this machine, keeps up a call through it, and ends with figures, or with what
the relay did that is not documented, or did to the call.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "scripts")]

from record_result import append_result, load_now  # noqa: E402

from fuzzing.live import LiveFailure, besiege  # noqa: E402


def main() -> None:
    """Read the command line, run, print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=50_000, help="damaged ones, at least")
    parser.add_argument("--strangers", type=int, default=8, help="at the same time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--record", action="store_true", help="append to docs/results/fuzz.jsonl")
    options = parser.parse_args()
    load_before = load_now()
    try:
        figures = besiege(options.messages, seed=options.seed, num_workers=options.strangers)
    except LiveFailure as error:
        print(error, file=sys.stderr)
        sys.exit(1)
    print(json.dumps(figures))
    if options.record:
        command = " ".join(["scripts/fuzz_live.py", *sys.argv[1:]])
        append_result("fuzz", command, figures, load_before)


if __name__ == "__main__":
    main()
