"""A relay beside a naive one, which reads a message and broadcasts it with the same library, under
one load in one run.

    python tests/rivals/comparison.py --rooms 60

prints the relay's figures, and under ``compare`` those of the naive relay.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from pica_client.bench.relay.bench import RelayBenchConfig, bench_relay, measure
from pica_client.system import terminate_as_interrupt

NAIVE: Final = Path(__file__).parent / "naive.py"


def run_comparison(config: RelayBenchConfig) -> dict[str, Any]:
    """Measure the relay and the naive one, each on the same core.

    Returns:
        What `pica bench relay` gives, and the same of the naive relay under ``compare``.

    Raises:
        ClientError: A server does not let everybody in.
    """
    result = bench_relay(config)
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, NAIVE], stdin=pipe, stdout=pipe, text=True) as naive:
        assert naive.stdout is not None
        url = naive.stdout.readline().strip()
        compare = {"naive": measure(config, url, naive.pid, "naive")}
        # The end of the block closes its standard input, and so ends it.
    return result | {"compare": compare}


def main() -> None:
    """Compare with the naive relay, and print the figures as one JSON object."""
    parser = argparse.ArgumentParser(description="Load the relay and a naive one, in turns.")
    parser.add_argument("--rooms", type=int, default=60, help="of five")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each measurement")
    options = parser.parse_args()
    load = RelayBenchConfig(rooms=options.rooms, seconds=options.seconds)
    with terminate_as_interrupt():
        print(json.dumps(run_comparison(load)))


if __name__ == "__main__":
    main()
