"""Throw damaged messages at everything that reads what strangers send, in this process.

PYTHONPATH=tests python -m fuzzing --messages 1000000                     some ten minutes
PYTHONPATH=tests python -m fuzzing --seed 7 --round 1234 --messages 1     one round again

Every message is accepted or refused with a documented error. Anything else ends the run with the
options that repeat it. ``--round`` also continues a run that was stopped.
"""

import argparse
import json
import sys

from fuzzing.campaign import TARGETS, FuzzFailure, run
from fuzzing.meter import Meter


def tell(number: int, meter: Meter) -> None:
    """Report progress now and then."""
    if number % 500 == 0:
        print(f"round {number}: {meter.num_damaged} damaged messages", file=sys.stderr)


def main() -> None:
    """Read the command line, run, and print the figures as JSON."""
    parser = argparse.ArgumentParser(prog="python -m fuzzing", description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=100_000, help="damaged ones, at least")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--round", type=int, default=0, help="the first round")
    parser.add_argument("--only", default="", choices=["", *TARGETS], help="one target alone")
    parser.add_argument("--no-memory", action="store_true", help="measure no memory: faster")
    options = parser.parse_args()
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
        sys.exit(str(error))
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
