"""Throw damaged messages at everything that reads what strangers send, in this process.

python scripts/fuzz.py --messages 1000000       some ten minutes; --record keeps the figures
python scripts/fuzz.py --seed 7 --round 1234 --messages 1     one round again

Everything is either accepted or refused with a documented error; anything else ends the run with
the line that repeats it. `--round` also continues a run that was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "scripts")]

from record_result import append_result, load_now  # noqa: E402

from fuzzing.campaign import FuzzFailure, run  # noqa: E402
from fuzzing.meter import Meter  # noqa: E402


def main() -> None:
    """Read the command line, run, print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=1_000_000, help="damaged ones, at least")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--round", type=int, default=0, help="where to begin")
    parser.add_argument("--only", default="", help="one target, as voice")
    parser.add_argument("--no-memory", action="store_true", help="measure no memory: faster")
    parser.add_argument("--record", action="store_true", help="append to docs/results/fuzz.jsonl")
    options = parser.parse_args()

    def tell(number: int, meter: Meter) -> None:
        if number % 500 == 0:
            print(f"round {number}: {meter.num_damaged} damaged messages", file=sys.stderr)

    load_before = load_now()
    try:
        figures = run(
            options.messages,
            seed=options.seed,
            first_round=options.round,
            only=options.only,
            is_tracing=not options.no_memory,
            tell=tell,
        )
    except FuzzFailure as error:
        print(error, file=sys.stderr)
        sys.exit(1)
    print(json.dumps(figures))
    if options.record:
        command = " ".join(["scripts/fuzz.py", *sys.argv[1:]])
        append_result("fuzz", command, figures, load_before)


if __name__ == "__main__":
    main()
