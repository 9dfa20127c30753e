"""A relay beside other servers under one load in one run.

naive, naive-uvloop   read a message and broadcast it, with the same library
echo                  what the load generator can do at most

    python tests/rivals/comparison.py --rooms 60

prints the relay's figures beside those of the naive relay.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from pica_client.bench.harness import check_names
from pica_client.bench.relay.bench import RelayBenchConfig, Target, measure, relay_target
from pica_client.bench.relay.processes import START_TIMEOUT_S, Workers, share_cores
from pica_client.local_call.processes import Children
from pica_client.stats import describe_machine
from pica_client.system import terminate_as_interrupt

RIVALS: Final = ("naive", "naive-uvloop", "echo")
HERE: Final = Path(__file__).parent


def run_comparison(config: RelayBenchConfig, compare: Sequence[str] = ()) -> dict[str, Any]:
    """Measure the relay and other servers.

    Args:
        config: The load.
        compare: Some of `RIVALS`.

    Returns:
        What `pica bench relay` gives, and the same by name under ``compare``.

    Raises:
        ClientError: A name is unknown, or a server does not let everybody in.
    """
    check_names("compare", compare, RIVALS)
    with Workers() as workers, Children() as children:
        with relay_target(config, children) as target:
            result = measure(config, target, workers, "relay")
        result["compare"] = {}
        for name in compare:
            with _rival(name, result, config, workers) as target:
                result["compare"][name] = measure(config, target, workers, name)
    return result | {"machine": describe_machine()}


@contextmanager
def _rival(
    name: str, result: dict[str, Any], config: RelayBenchConfig, workers: Workers
) -> Iterator[Target]:
    """A server to compare with, on the relay's core."""
    core, _ = share_cores()
    if name == "echo":
        copies = config.peers - 1
        per_message = result["frames_per_message"] or 1
        # As many in a message as the relay puts there, rounded down to what divides.
        fitting = [n for n in range(1, copies + 1) if copies % n == 0 and n <= per_message + 0.25]
        worker = workers.start(HERE / "echo.py", str(copies), str(fitting[-1]), core=core)
    else:
        words = name.split("-")[1:]
        worker = workers.start(HERE / "naive.py", *words, core=core)
    yield Target(url=worker.line(START_TIMEOUT_S), pid=worker.pid)
    workers.stop([worker])


def main() -> None:
    """Compare with the naive relay, and print the figures as one JSON object."""
    parser = argparse.ArgumentParser(description="Load the relay and a naive one, in turns.")
    parser.add_argument("--rooms", type=int, default=60, help="of five")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each measurement")
    options = parser.parse_args()
    load = RelayBenchConfig(rooms=options.rooms, seconds=options.seconds)
    with terminate_as_interrupt():
        print(json.dumps(run_comparison(load, ("naive",))))


if __name__ == "__main__":
    main()
