"""Let people call each other on a relay, or beside members of the room, who mean harm.

    PYTHONPATH=tests python -m malice --who relay --runs 10000             some fifteen minutes
    PYTHONPATH=tests python -m malice --who members --seed 1234 --runs 1   one run again

Each run is a seed; what must not happen is listed in `malice.relay` and `malice.members`. Prints
what was tried as JSON, or the seeds that broke a promise, and then exits with 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter

from malice import members, relay
from malice.people import BrokenPromiseError


def main() -> None:
    """Read the command line, run, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--who", choices=("relay", "members"), default="relay")
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first run; the others count up")
    options = parser.parse_args()
    run = {"relay": relay.run, "members": members.run}[options.who]
    began_s = time.monotonic()
    counts, broken = Counter[str](), list[str]()
    done = 0
    try:
        for done in range(1, options.runs + 1):
            try:
                counts += run(options.seed + done - 1)
            except BrokenPromiseError as error:
                broken.append(str(error))
                print(error, file=sys.stderr)
            if done % 500 == 0:
                print(f"{done} runs, {len(broken)} broken", file=sys.stderr)
    except KeyboardInterrupt:
        done -= 1
    seconds = round(time.monotonic() - began_s, 1)
    print(json.dumps({"runs": done, "broken": broken, "seconds": seconds, **counts}))
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
